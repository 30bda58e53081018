//! `[restart]`: what the launcher does when a process of the run dies or hangs.

use serde::{Deserialize, Serialize};

use super::check::{number, show};
use super::error::Violation;
use crate::wire::Role;

/// When a process that has ended is started again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RestartPolicy {
    /// Never: its end is the end of the run.
    Never,
    /// When it was killed, hung, or ended with an error that another start may not meet.
    OnFailure,
    /// Whenever it ended before the run was over.
    Always,
}

/// `[restart]`: policies, and how patient the launcher is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RestartConfig {
    /// For the plant.
    pub plant: RestartPolicy,
    /// For the controller.
    pub controller: RestartPolicy,
    /// For the logger.
    pub logger: RestartPolicy,
    /// Wait before the first start after a healthy while, ms; it doubles with each further one,
    pub backoff_ms: f64,
    /// up to this, ms.
    pub backoff_cap_ms: f64,
    /// A process that has lived for so long is healthy, s: the wait is short again.
    pub healthy_s: f64,
    /// After so many starts in a row without a healthy while between them the run ends.
    pub give_up_after: u32,
    /// A process that gives no sign of life for so long hangs, s, and is killed; 0: it is waited for.
    pub hang_s: f64,
}

impl Default for RestartConfig {
    fn default() -> Self {
        Self {
            plant: RestartPolicy::OnFailure,
            controller: RestartPolicy::OnFailure,
            logger: RestartPolicy::OnFailure,
            backoff_ms: 100.0,
            backoff_cap_ms: 5000.0,
            healthy_s: 10.0,
            give_up_after: 10,
            hang_s: 10.0,
        }
    }
}

impl RestartConfig {
    /// The policy for the process in the place of `role`.
    pub fn of(&self, role: Role) -> RestartPolicy {
        match role {
            Role::Plant => self.plant,
            Role::Controller => self.controller,
            Role::Logger => self.logger,
        }
    }

    pub(super) fn is_usual(&self) -> bool {
        *self == Self::default()
    }
}

/// Checks what the types cannot say.
pub(super) fn check(table: &RestartConfig) -> Result<(), Violation> {
    number("restart.backoff_ms", table.backoff_ms, 0.0..=3.6e6, "give 0 to 3600000 ms")?;
    if !(table.backoff_ms..=3.6e6).contains(&table.backoff_cap_ms) {
        let remedy = format!("give restart.backoff_ms, which is {}, or more, up to 3600000 ms", show(table.backoff_ms));
        return Err(Violation::value("restart.backoff_cap_ms", show(table.backoff_cap_ms), remedy));
    }
    number("restart.healthy_s", table.healthy_s, 0.0..=86400.0, "give 0 to 86400 s")?;
    if table.give_up_after > 255 {
        return Err(Violation::value("restart.give_up_after", table.give_up_after, "give 0 to 255 starts"));
    }
    if table.hang_s != 0.0 {
        number("restart.hang_s", table.hang_s, 0.5..=86400.0, "give 0.5 to 86400 s, or 0 to wait for ever")?;
    }
    Ok(())
}
