//! `tectum bench encoder`: the cost of encoding the arm's 320 features by every version and on every path, and
//! of lines and planes of 32 to 32,768 features.

use super::BenchError;
use super::costs::{CallsSettings, CostsBench, CostsOutcome, POWERS};
use crate::timing::{InputRing, TimingError};

/// Measures the encoder.
///
/// # Errors
/// When the folder cannot be used, or a signal ends the bench.
pub fn encoder(settings: &CallsSettings) -> Result<CostsOutcome, BenchError> {
    let mut bench = CostsBench::start("encoder", settings)?;
    let ring = InputRing::default();
    bench.show("versions");
    bench.measure(ring.versions().map_err(TimingError::from)?)?;
    bench.show("growth");
    bench.finish(POWERS.flat_map(|power| ring.growth(power)).collect())
}
