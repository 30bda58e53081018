//! Statistics of many values: percentiles of durations, the spread over seeds, quartiles, straight lines, and means
//! over windows of ticks.
//!
//! A leaf: it knows nothing of ticks, logs or runs, so that every module may use it.

mod percentiles;
mod quartiles;
mod spread;
mod window;

pub use percentiles::LONGEST;
pub use percentiles::{Percentiles, histogram};
pub use quartiles::{Fit, Quartiles};
pub use spread::Spread;
pub use window::Window;
pub use window::number_or_nan;
