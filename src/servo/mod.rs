//! Serial-bus servos: what a series is like, and a chain of such servos that is emulated from the devices' end.
//!
//! [`model`] says where the registers are and in which units they count; [`emulator`] is the servos' end of the wire, bytes in at
//! an instant and bytes out at an instant, with no clock and no files.

pub mod bus;
pub mod emulator;
pub mod model;
pub mod pty;
pub mod tools;
