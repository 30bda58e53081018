//! `tectum bench learner`: the cost of the paper's rule by version and path, of the controller's whole tick
//! (encode, act, learn) with every rule, and how learning grows with features and outputs.

use super::BenchError;
use super::costs::{CallsSettings, CostsBench, CostsOutcome, POWERS};
use crate::study::compare::name_of;
use crate::timing::{rule_growth, rule_versions, tick_cases};

/// Measures the learning rules.
///
/// # Errors
/// When the folder cannot be used, or a signal ends the bench.
pub fn learner(settings: &CallsSettings) -> Result<CostsOutcome, BenchError> {
    let mut bench = CostsBench::start("learner", settings)?;
    bench.show("versions and rules");
    bench.measure(rule_versions())?;
    bench.measure(tick_cases(&name_of)?)?;
    bench.show("growth");
    let sizes = [4, 8].into_iter().flat_map(|outputs| POWERS.map(move |power| (outputs, power)));
    bench.finish(sizes.flat_map(|(outputs, power)| rule_growth(outputs, power)).collect())
}
