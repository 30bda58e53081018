//! `[restart]`: which processes the launcher restarts, after what delay, and when a missing heartbeat counts as
//! a hang.

use serde::{Deserialize, Serialize};

use super::check::{number, show};
use super::error::Violation;
use crate::Role;

/// When the launcher restarts a process that has ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RestartPolicy {
    /// Never: when the process ends, the run ends.
    Never,
    /// After it was killed, after it hung, and after an error that may not occur again.
    OnFailure,
    /// Whenever it ends before the run does.
    Always,
}

/// `[restart]`: restart policies, delays and the limits at which the launcher gives up.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RestartConfig {
    /// Policy for the plant.
    pub plant: RestartPolicy,
    /// Policy for the controller.
    pub controller: RestartPolicy,
    /// Policy for the logger.
    pub logger: RestartPolicy,
    /// Delay before the first restart, ms. It doubles with each further restart.
    pub backoff_ms: f64,
    /// Upper limit of the delay, ms.
    pub backoff_cap_ms: f64,
    /// After running for this long, s, a process counts as healthy: delay and count of restarts begin anew.
    pub healthy_s: f64,
    /// The run ends when a process would need more restarts in a row than this without being healthy between
    /// them.
    pub give_up_after: u32,
    /// A process without a heartbeat for this long, s, counts as hanging and is killed. 0: never.
    pub hang_s: f64,
    /// How long a process may take to get ready, and then to connect, s: homing takes longer than setting up channels.
    #[serde(skip_serializing_if = "is_usual_set_up")]
    pub set_up_s: f64,
}

/// The usual limit of `set_up_s`, s.
const SET_UP_S: f64 = 20.0;

#[allow(clippy::trivially_copy_pass_by_ref)] // as serde calls it
fn is_usual_set_up(seconds: &f64) -> bool {
    *seconds == SET_UP_S
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
            set_up_s: SET_UP_S,
        }
    }
}

impl RestartConfig {
    /// The policy for the process with this role.
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

/// Checks ranges.
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
    number("restart.set_up_s", table.set_up_s, 1.0..=86400.0, "give 1 to 86400 s")?;
    if table.hang_s != 0.0 {
        number("restart.hang_s", table.hang_s, 0.5..=86400.0, "give 0.5 to 86400 s, or 0 to wait for ever")?;
    }
    Ok(())
}
