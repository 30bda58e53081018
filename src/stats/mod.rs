//! Statistics of many values: percentiles of durations, the spread over seeds, quartiles and straight lines.
//!
//! A leaf: it knows nothing of ticks, logs or runs, so that every room may use it.

mod percentiles;
mod quartiles;
mod spread;

pub(crate) use percentiles::LONGEST;
pub use percentiles::{Percentiles, histogram};
pub use quartiles::{Fit, Quartiles};
pub use spread::Spread;
