//! What a page shows of one run, from the files in its folder.

use std::path::Path;

use serde_json::{Value, json};

use super::ReportPageError;
use super::log_digest::LogDigest;
use crate::log::{self, RunLog};
use crate::runtime::RunManifest;
use crate::scenario::{Plan, Scenario};
use crate::supervise::body_changes;

/// Collects it. What is missing or damaged is said in `notes`, and the rest is shown.
///
/// # Errors
/// [`ReportPageError::NoRun`] if there is nothing at all; [`ReportPageError::Log`] if its first segment is no log.
pub(super) fn collect(folder: &Path) -> Result<Value, ReportPageError> {
    let text = |path: &Path| std::fs::read_to_string(path).ok();
    let object = |path: &Path| text(path).and_then(|text| serde_json::from_str::<Value>(&text).ok());
    let summary = object(&folder.join("summary.json"));
    let segments = log::segments(folder);
    if summary.is_none() && segments.is_empty() {
        return Err(ReportPageError::NoRun { path: folder.to_owned() });
    }
    let mut notes = Vec::new();
    if summary.is_none() {
        notes.push("There is no summary: the run is still going on, or its launcher was killed.".to_owned());
    }
    let scenario_file = RunManifest::scenario_path(folder);
    let plan = Scenario::load(&scenario_file).and_then(Scenario::plan);
    if let Err(error) = &plan {
        notes.push(format!("The scenario cannot be read, so its arm and its changes are not shown: {error}"));
    }
    let plan = plan.ok();
    let ticks = summary.as_ref().and_then(|summary| summary["ticks"].as_u64());
    let digest = if segments.is_empty() {
        notes.push("The run left no log, so there are no curves and no movements.".to_owned());
        None
    } else {
        let log = RunLog::open(&segments)?;
        Some(LogDigest::of(log, plan.as_ref(), ticks, &mut notes))
    };
    let manifest = object(&RunManifest::path(folder)).unwrap_or_default();
    Ok(json!({
        "name": name(folder),
        "folder": folder.display().to_string(),
        "summary": summary,
        "notes": notes,
        "figure": text(&folder.join("figure.svg")),
        "settings": text(&scenario_file),
        "facts": facts(&manifest, digest.as_ref()),
        "marks": plan.as_ref().map(marks),
        "error_unit": plan.as_ref().map_or("", Plan::error_unit),
        "log": digest.as_ref().map(LogDigest::to_json),
    }))
}

fn name(folder: &Path) -> String {
    let whole = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    whole.file_name().map_or_else(|| folder.display().to_string(), |name| name.to_string_lossy().into_owned())
}

/// Versions and machine, as rows of a table.
fn facts(manifest: &Value, digest: Option<&LogDigest>) -> Vec<[String; 2]> {
    let mut rows = Vec::new();
    let mut row = |label: &str, value: Option<&str>| {
        if let Some(value) = value.filter(|value| !value.is_empty()) {
            rows.push([label.to_owned(), value.to_owned()]);
        }
    };
    row("run", manifest["run"].as_str());
    row("scenario file", manifest["source"].as_str());
    if let Some(digest) = digest {
        row("build", digest.description.get("build").map(String::as_str));
        row("scenario hash", digest.description.get("scenario_hash").map(String::as_str));
        row("clock", digest.description.get("clock").map(String::as_str));
        for (key, value) in &digest.description {
            if let Some(label) = key.strip_prefix("machine.") {
                row(label, Some(value));
            }
        }
    } else {
        row("build", manifest["wire"]["build"].as_str());
    }
    rows
}

/// The changes of the arm that the scenario announces: seconds from tick 0, and what they are.
fn marks(plan: &Plan) -> Vec<(f64, String)> {
    let arm = plan.scenario.plant.arm.as_ref();
    let seconds = |tick: u64| tick as f64 * plan.period_ns as f64 / 1e9;
    arm.map_or_else(Vec::new, body_changes).into_iter().map(|change| (seconds(change.tick), change.label)).collect()
}
