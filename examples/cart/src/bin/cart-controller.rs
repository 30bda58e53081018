//! The controller's process.

use std::process::ExitCode;

use cart::ProportionalDerivative;
use tectum::process::controller_main;

fn main() -> ExitCode {
    controller_main(&[("proportional-derivative", |plan| {
        let period = (plan.scenario.period_ms / 1000.0) as f32;
        Ok(Box::new(ProportionalDerivative::new(period)))
    })])
}
