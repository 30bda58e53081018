//! Serial-bus servos: what a series is like, the host's end of the bus, and a chain of such servos that is emulated from the devices' end.
//!
//! [`model`] says where the registers are and in which units they count; [`bus`] speaks to servos within an instant, [`bridge`] is the plant
//! that lives on it, and [`tools`] are for an arm that is no plant yet; [`emulator`] is the servos' end of the wire, bytes in at an instant and
//! bytes out at an instant, with no clock and no files; [`pseudo_terminal`] puts it behind a terminal in real time.

pub mod bridge;
pub mod pseudo_terminal;
pub mod tools;

pub use tectum_servo::{bus, emulator, model};
