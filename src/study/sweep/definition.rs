//! A sweep as the first line of its rows, and back.

use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::{Sweep, SweepSetting};
use crate::scenario::Scenario;
use crate::study::{StudyError, StudyHead, StudyPlace};

#[derive(Debug, Serialize, Deserialize)]
struct Definition {
    /// The scenario, every default written out: a sweep of another one is another study.
    resolved: String,
    /// Its text as it stands.
    text: String,
    settings: Vec<String>,
    ticks: Option<u64>,
}

/// The definition of a sweep. The seeds are no part of it.
pub(super) fn of(sweep: &Sweep) -> Value {
    let Sweep { scenario, settings, ticks, .. } = sweep;
    let resolved = Scenario { seed: 1, ..scenario.clone() }.to_toml();
    let settings: Vec<String> = settings.iter().map(SweepSetting::text).collect();
    let text = match scenario.source.text() {
        "" => scenario.text().unwrap_or_default(),
        text => text.to_owned(),
    };
    serde_json::json!({ "resolved": resolved, "text": text, "settings": settings, "ticks": ticks })
}

/// Where the scenario stands: its file, and the folder at which its paths begin.
pub(super) fn origin(sweep: &Sweep) -> Value {
    let source = &sweep.scenario.source;
    serde_json::json!({ "file": source.name(), "folder": source.folder() })
}

impl Sweep {
    /// The sweep whose rows have the first line `head`.
    ///
    /// # Errors
    /// When the line cannot be read.
    pub fn of_head(head: &StudyHead, place: StudyPlace) -> Result<Self, StudyError> {
        let unread = |why: String| StudyError::Asked(format!("the study's first line cannot be read: {why}"));
        let definition: Definition =
            serde_json::from_value(head.definition.clone()).map_err(|error| unread(error.to_string()))?;
        let mut scenario = Scenario::parse(&definition.text, head.origin["file"].as_str().unwrap_or("scenario"))?;
        scenario.source = scenario.source.in_folder(head.origin["folder"].as_str().map(Path::new));
        let settings = definition.settings.iter().map(|text| text.parse()).collect::<Result<_, _>>().map_err(unread)?;
        let (seeds, ticks) = (head.seeds, definition.ticks);
        Ok(Self { scenario, settings, seeds, ticks, out: None, place, progress: true })
    }
}
