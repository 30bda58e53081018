//! A comparison as the first line of its rows, and back: everything that its results depend on beside the seeds.

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::{ArmChange, Changes, ComparedLearner, Comparison, learner, name_of};
use crate::scenario::Scenario;
use crate::study::{StudyError, StudyHead, StudyPlace};

/// A learner.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum LearnerRow {
    /// A rule of this package, by name.
    Rule(String),
    /// A scenario of one's own: its text.
    Scenario(String),
}

#[derive(Debug, Serialize, Deserialize)]
struct Definition {
    learners: Vec<LearnerRow>,
    ticks: Option<u64>,
    /// `usual`, `none`, or the changes as on the command line, separated by spaces.
    changes: String,
    settings: Vec<String>,
    starts: usize,
    test_seed: u64,
}

/// The definition of a comparison.
pub(super) fn of(comparison: &Comparison) -> Value {
    let row = |learner: &ComparedLearner| match learner {
        ComparedLearner::Rule(rule) => LearnerRow::Rule(name_of(*rule)),
        ComparedLearner::Scenario(scenario) => LearnerRow::Scenario(scenario.to_toml()),
    };
    let definition = Definition {
        learners: comparison.learners.iter().map(row).collect(),
        ticks: comparison.ticks,
        changes: match &comparison.changes {
            Changes::Usual => "usual".to_owned(),
            Changes::None => "none".to_owned(),
            Changes::These(changes) => changes.iter().map(ArmChange::form).collect::<Vec<_>>().join(" "),
        },
        settings: comparison.settings.clone(),
        starts: comparison.starts,
        test_seed: comparison.test_seed,
    };
    serde_json::to_value(definition).unwrap_or_default()
}

/// The files of the learners that are scenarios of one's own.
pub(super) fn origin(comparison: &Comparison) -> Value {
    let file = |learner: &ComparedLearner| match learner {
        ComparedLearner::Rule(_) => None,
        ComparedLearner::Scenario(scenario) => std::path::absolute(scenario.source.name()).ok(),
    };
    serde_json::to_value(comparison.learners.iter().map(file).collect::<Vec<_>>()).unwrap_or_default()
}

impl Comparison {
    /// The comparison whose rows have the first line `head`.
    ///
    /// # Errors
    /// When the line cannot be read, or a scenario's file has changed since.
    pub fn of_head(head: &StudyHead, place: StudyPlace) -> Result<Self, StudyError> {
        let unread = |why: String| StudyError::Asked(format!("the study's first line cannot be read: {why}"));
        let definition: Definition =
            serde_json::from_value(head.definition.clone()).map_err(|error| unread(error.to_string()))?;
        let runs = !matches!(place, StudyPlace::Merge(_));
        let files: Vec<Option<String>> = serde_json::from_value(head.origin.clone()).unwrap_or_default();
        let compared = |(i, row): (usize, &LearnerRow)| match row {
            LearnerRow::Rule(name) => learner(name),
            LearnerRow::Scenario(text) => {
                let file = files.get(i).cloned().flatten().unwrap_or_default();
                same_scenario(text, &file, runs)
            }
        };
        Ok(Self {
            learners: definition.learners.iter().enumerate().map(compared).collect::<Result<_, _>>()?,
            seeds: head.seeds,
            ticks: definition.ticks,
            changes: match &definition.changes[..] {
                "usual" => Changes::Usual,
                "none" => Changes::None,
                changes => {
                    Changes::These(changes.split(' ').map(str::parse).collect::<Result<_, _>>().map_err(unread)?)
                }
            },
            settings: definition.settings,
            starts: definition.starts,
            test_seed: definition.test_seed,
            out: None,
            place,
            progress: true,
        })
    }
}

/// The scenario of that text. Where runs are to be made, it is read from its file again, beside which its programs are.
fn same_scenario(text: &str, file: &str, runs: bool) -> Result<ComparedLearner, StudyError> {
    if !runs {
        return Ok(ComparedLearner::Scenario(Box::new(Scenario::parse(text, file)?)));
    }
    let scenario = Scenario::load(file.as_ref())?;
    if scenario.to_toml() != text {
        return Err(StudyError::Asked(format!("{file} has changed since the study began; begin it anew")));
    }
    Ok(ComparedLearner::Scenario(Box::new(scenario)))
}
