//! Serial-bus servos: the plant on servos, the tools for servos, and emulated servos in real time.
//!
//! [`bridge`] is a plant whose joints are servos. [`tools`] find, calibrate, move and show the servos of an arm
//! that is not part of a run. [`guard`] turns torque off when the process that drives them has died or fallen
//! silent. [`follower`] is the controller of an arm that follows another. [`pseudo_terminal`] offers an emulated chain
//! as a serial port in real time.
//!
//! The crate `tectum_servo` has the register models ([`model`]), the packets ([`packet`]), the bus with deadlines
//! ([`bus`]) and the emulated chain ([`emulator`]).

pub mod bridge;
pub mod follower;
pub mod guard;
pub mod pseudo_terminal;
pub mod tools;

pub use tectum_servo::{bus, emulator, model, packet};
