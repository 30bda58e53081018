//! Serial-bus servos: register models, a bus in which every instruction has a deadline, and an emulated chain.
//!
//! - [`model`]: Dynamixel X (protocol 2.0) and Feetech STS (protocol 1.0) series: registers, units, signs, limits.
//! - [`bus`]: the host's end. Every instruction ends by its deadline, even if the bus fails.
//! - [`packet`]: the packets of both protocols, for both ends.
//! - [`emulator`]: the servos' end, without hardware: control tables, motion and faults, in stepped or
//!   real time.
//!
//! Reading positions over a bus of two emulated servos, in virtual time:
//!
//! ```
//! use std::sync::{Arc, Mutex};
//!
//! use tectum_servo::bus::{Bus, BusBudget};
//! use tectum_servo::emulator::{EmulatedChain, EmulatedPort, EmulatorConfig, SteppedClock};
//! use tectum_servo::model::Protocol;
//!
//! let protocol = Protocol::Feetech;
//! let chain = EmulatedChain::new(protocol, &[1, 2], 1_000_000, &EmulatorConfig::default(), 1);
//! let clock = SteppedClock::default();
//! let port = EmulatedPort::new(Arc::new(Mutex::new(chain)), clock.clone(), 1_000_000);
//! let budget = BusBudget::of(50_000_000);
//! let mut bus = Bus::over(Box::new(port), protocol, budget, Box::new(move || clock.now()));
//!
//! let series = protocol.series();
//! let (answers, took_ns) = bus.sync_read(&[1, 2], series.state);
//! for answer in answers.unwrap() {
//!     assert_eq!(series.state.decode(series.position, &answer.bytes), Some(2048));
//! }
//! assert!(took_ns < budget.read_ns);
//! ```

#![warn(missing_docs)]

pub mod bus;
pub mod emulator;
pub mod model;
pub mod packet;
