//! `tectum bench encoder` and `tectum bench learner`: nanoseconds a call, by version and path, and how they grow with the
//! number of features.

use std::fmt::Write as _;
use std::path::{Path as File, PathBuf};

use serde::Serialize;

use super::calls::CallTimes;
use super::{BenchError, Machine};
use crate::report::thousands;

/// What to measure.
#[derive(Debug, Clone)]
pub struct CallsSettings {
    /// Batches of each case.
    pub batches: u64,
    /// The folder; `runs/bench-<what>-<n>` if there is none.
    pub out: Option<PathBuf>,
    /// Show a progress line on standard error.
    pub progress: bool,
}

impl CallsSettings {
    pub(super) fn check(&self) -> Result<(), BenchError> {
        match self.batches {
            0 => Err(BenchError::Asked("--batches is 0; give at least 1".to_owned())),
            _ => Ok(()),
        }
    }
}

/// What a version of something costs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CallCost {
    /// What is called.
    pub what: String,
    /// Which version, and with which instructions.
    pub version: String,
    /// What a call took.
    pub ns: CallTimes,
}

/// The same for a number of features.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Growth {
    /// What is called.
    pub what: String,
    /// With which instructions.
    pub path: String,
    /// Features.
    pub features: u64,
    /// Outputs; 1 where there are none.
    pub outputs: u64,
    /// What a call took.
    pub ns: CallTimes,
    /// Median for each feature and output.
    pub ns_each: f64,
}

/// Everything that was measured: the object of `--json`.
#[derive(Debug, Clone, Serialize)]
pub struct CostsOutcome {
    /// `encoder` or `learner`.
    pub what: &'static str,
    /// Each version.
    pub costs: Vec<CallCost>,
    /// Growth with the number of features.
    pub growth: Vec<Growth>,
    /// What it ran on.
    pub machine: Machine,
    /// Seconds that it took.
    pub seconds: f64,
    /// The folder with the files.
    pub folder: PathBuf,
}

impl CostsOutcome {
    /// One JSON object.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    /// Leaves the object and the growth in the folder.
    pub(super) fn write(&self) -> Result<(), BenchError> {
        let put = |name: &str, text: &str| {
            let path = self.folder.join(name);
            std::fs::write(&path, text).map_err(BenchError::write(&path))
        };
        put(&format!("{}.json", self.what), &self.to_json())?;
        put(&format!("{}.csv", self.what), &self.to_csv())
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

    /// What a reader of tables needs to know.
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

    /// Where its files are.
    pub fn folder(&self) -> &File {
        &self.folder
    }
}
