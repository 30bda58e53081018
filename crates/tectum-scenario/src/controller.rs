//! `[controller]`: the controller's program.

use std::fmt::Display;

use serde::{Deserialize, Serialize, de::DeserializeOwned};

use super::check::program;
use super::error::{Violation, read_table};
use super::{FilePosition, ScenarioError, ScenarioSource, limits};
use crate::programs::{CONTROLLER, is_shipped_controller};

/// `[controller]`: the program that fills the controller's role.
///
/// Without this table it is `tectum-controller`: encoder, linear policy and learning rule of this package. Any
/// other program may leave out `[encoder]`, `[policy]` and `[learner]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ControllerConfig {
    /// The program. A name is looked up beside `tectum` and then in `PATH`; a path is used unchanged.
    pub program: String,
    /// Arguments for the program, before those that the launcher adds.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub args: Vec<String>,
    /// Updates of the learner after each command (`Agent::improve`).
    #[serde(skip_serializing_if = "is_one")]
    pub updates: u32,
}

fn is_one(updates: &u32) -> bool {
    *updates == 1
}

impl Default for ControllerConfig {
    fn default() -> Self {
        Self { program: CONTROLLER.to_owned(), args: Vec::new(), updates: 1 }
    }
}

impl ControllerConfig {
    /// Whether the controller is this package's own: encoder, linear policy and one of its learning rules.
    pub fn is_shipped(&self) -> bool {
        is_shipped_controller(&self.program)
    }

    pub(super) fn is_usual(&self) -> bool {
        *self == Self::default()
    }
}

pub(super) fn check(controller: &ControllerConfig) -> Result<(), Violation> {
    program("controller", &controller.program, &controller.args)?;
    if !limits::UPDATES.contains(&controller.updates) {
        return Err(Violation::value("controller.updates", controller.updates, "give 1 to 1000 updates a tick"));
    }
    Ok(())
}

/// `[learner]` of a controller's program of your own. The program reads it and checks it by itself.
#[derive(Debug, Clone, Copy)]
pub struct LearnerTable<'a> {
    table: &'a toml::Table,
    source: &'a ScenarioSource,
}

impl<'a> LearnerTable<'a> {
    pub(super) fn new(table: &'a toml::Table, source: &'a ScenarioSource) -> Self {
        Self { table, source }
    }

    /// The key `rule`, which names one of the program's learners.
    pub fn rule(&self) -> Option<&'a str> {
        self.table.get("rule")?.as_str()
    }

    /// The whole table.
    pub fn table(&self) -> &'a toml::Table {
        self.table
    }

    /// The table without `rule` as settings of type `T`. Keys that `T` does not know are refused if it has serde's
    /// `deny_unknown_fields`.
    ///
    /// # Errors
    ///
    /// For an unknown or missing key, or a value of the wrong type: with file, line, key and remedy.
    pub fn read<T: DeserializeOwned>(&self) -> Result<T, ScenarioError> {
        let mut table = self.table.clone();
        table.remove("rule");
        read_table(table, "learner", self.source)
    }

    /// The error for the value of `key`, such as `gain` or `table.list[2]`; `problem` says what is wrong and what to
    /// do: `is -1; give more than 0`.
    pub fn invalid(&self, key: &str, problem: impl Display) -> ScenarioError {
        let key = if key.is_empty() { "learner".to_owned() } else { format!("learner.{key}") };
        let place = FilePosition { file: self.source.name().to_owned(), line: self.source.line_of(&key) };
        ScenarioError::Invalid { place, key, problem: problem.to_string() }
    }
}
