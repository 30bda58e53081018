//! The frame of `tectum bench encoder` and `tectum bench learner`: nanoseconds per call, by version and SIMD
//! path, and how they grow with the number of features.

use std::fmt::Write as _;
use std::path::PathBuf;

use serde::Serialize;

use super::context::{BenchContext, write_file};
use super::{BenchError, Machine};
use crate::text::thousands;
use crate::timing::{CallCase, CallTimes, GrowthKey, in_turns};

/// Numbers of features whose costs are compared, as powers of two.
pub(super) const POWERS: std::ops::RangeInclusive<u32> = 5..=15;

/// What to measure.
#[derive(Debug, Clone)]
pub struct CallsSettings {
    /// Batches of each case.
    pub batches: u64,
    /// The folder for the results; without one, `runs/bench-<what>-<n>`.
    pub out: Option<PathBuf>,
    /// Show a progress line on standard error.
    pub progress: bool,
}

impl CallsSettings {
    fn check(&self) -> Result<(), BenchError> {
        match self.batches {
            0 => Err(BenchError::Asked("--batches is 0; give at least 1".to_owned())),
            _ => Ok(()),
        }
    }
}

/// The cost of one version of a computation.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct CallCost {
    /// What is called.
    pub what: String,
    /// Which version, and on which SIMD path.
    pub version: String,
    /// The time of a call.
    pub ns: CallTimes,
}

/// The cost of a computation for one number of features.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Growth {
    /// What is called.
    pub what: String,
    /// On which SIMD path.
    pub path: String,
    /// Number of features.
    pub features: u64,
    /// Number of outputs; 1 where there are none.
    pub outputs: u64,
    /// The time of a call.
    pub ns: CallTimes,
    /// Its median divided by features and outputs.
    pub ns_each: f64,
}

/// All results: the object of `--json`.
#[derive(Debug, Clone, Serialize)]
pub struct CostsOutcome {
    /// `encoder` or `learner`.
    what: &'static str,
    /// Each version.
    pub(super) costs: Vec<CallCost>,
    /// Growth with the number of features.
    pub(super) growth: Vec<Growth>,
    /// The machine.
    machine: Machine,
    /// Duration of the bench, s.
    seconds: f64,
    /// The folder with the files.
    folder: PathBuf,
}

/// A bench of calls in progress.
pub(super) struct CostsBench {
    what: &'static str,
    batches: u64,
    context: BenchContext,
    costs: Vec<CallCost>,
}

impl CostsBench {
    /// Begins the bench of `what`.
    pub fn start(what: &'static str, settings: &CallsSettings) -> Result<Self, BenchError> {
        settings.check()?;
        let context = BenchContext::start(settings.out.as_deref(), &format!("bench-{what}"), settings.progress)?;
        Ok(Self { what, batches: settings.batches, context, costs: Vec::new() })
    }

    /// Shows the part that is measured now.
    pub fn show(&mut self, part: &str) {
        self.context.progress.show(&format!("{}: {part}", self.what));
    }

    /// Measures versions; their keys are (what is called, version).
    pub fn measure(&mut self, cases: Vec<CallCase<(String, String)>>) -> Result<(), BenchError> {
        let times = in_turns(cases, self.batches, &self.context.signals)?;
        self.costs.extend(times.into_iter().map(|((what, version), ns)| CallCost { what, version, ns }));
        Ok(())
    }

    /// Measures the growth with the number of features, and ends the bench.
    pub fn finish(self, growth_cases: Vec<CallCase<GrowthKey>>) -> Result<CostsOutcome, BenchError> {
        let each = |(key, ns): (GrowthKey, CallTimes)| Growth {
            what: key.what,
            path: key.path.to_string(),
            features: key.features,
            outputs: key.outputs,
            ns,
            ns_each: ns.median / (key.outputs as f64 * key.features as f64),
        };
        let times = in_turns(growth_cases, self.batches, &self.context.signals)?;
        let mut growth: Vec<Growth> = times.into_iter().map(each).collect();
        growth.sort_by(|a, b| (&a.what, &a.path, a.features).cmp(&(&b.what, &b.path, b.features)));
        let outcome = CostsOutcome {
            what: self.what,
            costs: self.costs,
            growth,
            seconds: self.context.seconds(),
            machine: self.context.machine,
            folder: self.context.folder.path().to_owned(),
        };
        self.context.folder.keep();
        outcome.write()?;
        Ok(outcome)
    }
}

impl CostsOutcome {
    /// One JSON object.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    fn write(&self) -> Result<(), BenchError> {
        write_file(&self.folder.join(format!("{}.json", self.what)), &self.to_json())?;
        write_file(&self.folder.join(format!("{}.csv", self.what)), &self.to_csv())
    }

    fn to_csv(&self) -> String {
        let mut text = "what,version,features,outputs,median_ns,min_ns,max_ns\n".to_owned();
        for CallCost { what, version, ns } in &self.costs {
            let _ = writeln!(text, "\"{what}\",\"{version}\",,,{},{},{}", ns.median, ns.min, ns.max);
        }
        for g in &self.growth {
            let ns = &g.ns;
            let _ = writeln!(
                text,
                "\"{}\",{},{},{},{},{},{}",
                g.what, g.path, g.features, g.outputs, ns.median, ns.min, ns.max
            );
        }
        text
    }

    /// The tables for people.
    pub fn to_text(&self) -> String {
        let batches = self.costs.first().map_or(0, |cost| cost.ns.batches);
        let mut text = format!(
            "{}: {batches} batches of each case, in turns; ns a call\n{}\n{:<38} {:<22} {:>11} {:>11}\n",
            self.what,
            self.machine.to_text(),
            "",
            "version",
            "median",
            "least"
        );
        for CallCost { what, version, ns } in &self.costs {
            let _ = writeln!(text, "{what:<38} {version:<22} {:>11.1} {:>11.1}", ns.median, ns.min);
        }
        let _ = writeln!(
            text,
            "\n{:<38} {:<9} {:>8} {:>11} {:>11} {:>9}",
            "by number of features", "path", "features", "median", "least", "ns each"
        );
        for g in &self.growth {
            let _ = writeln!(
                text,
                "{:<38} {:<9} {:>8} {:>11.1} {:>11.1} {:>9.3}",
                g.what,
                g.path,
                thousands(g.features),
                g.ns.median,
                g.ns.min,
                g.ns_each
            );
        }
        let _ = writeln!(text, "files   {}", self.folder.display());
        text
    }
}
