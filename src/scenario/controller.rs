//! `[controller]`: the controller's program.

use serde::{Deserialize, Serialize};

use super::check::program;
use super::error::Violation;
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
}

impl Default for ControllerConfig {
    fn default() -> Self {
        Self { program: CONTROLLER.to_owned(), args: Vec::new() }
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
    program("controller", &controller.program, &controller.args)
}
