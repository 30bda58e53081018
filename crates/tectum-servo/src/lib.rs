//! Serial-bus servos: what their registers mean, a bus whose instructions end in time, and an emulated chain.
//!
//! - [`model`]: Dynamixel X (protocol 2.0) and Feetech STS (protocol 1.0) series: registers, units, signs, limits.
//! - [`bus`]: the host's end. Every instruction has an instant by which it ends, whatever the wire does.
//! - [`emulator`]: the servos' end, without hardware: codec, control tables, motion and faults, in stepped or
//!   real time.
//!
//! ```
//! use tectum_servo::model::{MODELS, Protocol};
//!
//! let feetech: Vec<_> = MODELS.iter().filter(|model| model.protocol == Protocol::Feetech).collect();
//! assert!(feetech.iter().any(|model| model.name == "STS3215"));
//! ```

#![warn(missing_docs)]

pub mod bus;
pub mod emulator;
pub mod model;
