//! Restart policy: which processes are restarted, after what delay, and when a missing heartbeat counts as a hang.
//!
//! The delay doubles with every restart in a row, so that a process that dies at once does not take the
//! machine's time. After a process has run for a while without failing, its delay is short again. This is pure
//! bookkeeping: the launcher passes the time in.

use std::time::Duration;

use serde::Serialize;

use super::children::{DeathKind, ProcessDeath};
use crate::scenario::{RestartConfig, RestartPolicy};
use crate::wire::Role;

/// The longest time that a single check may add to a process's silence, ns. If the launcher itself did not run
/// for a while, neither may have the process.
const LONGEST_CHECK_NS: u64 = 200_000_000;

/// A process that died or hung and was restarted.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RestartIncident {
    /// Which process.
    pub process: &'static str,
    /// What happened to it, one sentence.
    pub what: String,
    /// The incarnation that replaced it.
    pub incarnation: u32,
    /// Seconds between its death and its next start.
    pub away_s: f64,
}

/// A process that has died and waits for its restart.
#[derive(Debug, Clone)]
struct PendingRestart {
    /// When it died, ns.
    died_ns: u64,
    /// When it is to be started, ns.
    due_ns: u64,
    /// What happened to it.
    what: String,
}

/// What the launcher knows of one process.
#[derive(Debug, Clone, Default)]
struct ProcessRecord {
    /// When it was last started, ns.
    started_ns: u64,
    /// Restarts in a row, without `healthy_s` of running between them.
    restarts_in_a_row: u32,
    pending: Option<PendingRestart>,
    incarnation: u32,
    /// Its last heartbeat.
    heartbeat: u64,
    /// When the heartbeat was last checked, ns.
    checked_ns: u64,
    /// For how long the heartbeat has not changed, ns.
    silent_ns: u64,
}

/// Tracks the starts, deaths and heartbeats of a run's processes.
#[derive(Debug)]
pub(super) struct RestartTracker {
    config: RestartConfig,
    records: [ProcessRecord; 3],
    /// All restarts so far, in order.
    pub incidents: Vec<RestartIncident>,
}

impl RestartTracker {
    /// A tracker under the rules of `config`. All processes have been started at `now`.
    pub fn new(config: &RestartConfig, now: u64) -> Self {
        let record = ProcessRecord { started_ns: now, checked_ns: now, ..ProcessRecord::default() };
        Self { config: config.clone(), records: [(); 3].map(|()| record.clone()), incidents: Vec::new() }
    }

    /// Ticks begin at `now`: what the set-up of the run took, by hand perhaps minutes, is no process's own time.
    pub fn ticks_begin(&mut self, now: u64) {
        for record in &mut self.records {
            (record.started_ns, record.checked_ns) = (now, now);
        }
    }

    /// Schedules the restart of a process, if its policy allows one. True if it does. `requested` is for a
    /// process that was asked to end so that it restarts: it restarts whatever the policy, and without a delay.
    pub fn schedule(&mut self, death: &ProcessDeath, now: u64, requested: bool) -> bool {
        let role = death.failure.role;
        let record = &mut self.records[role as usize];
        let policy = self.config.of(role);
        let allowed = match death.kind {
            DeathKind::Final => false,
            DeathKind::Failure => policy != RestartPolicy::Never,
            DeathKind::EarlyExit => policy == RestartPolicy::Always,
        };
        // The time in which it did not show any sign of life was no healthy time.
        let healthy_ns = now.saturating_sub(record.started_ns).saturating_sub(record.silent_ns);
        if healthy_ns as f64 > self.config.healthy_s * 1e9 {
            record.restarts_in_a_row = 0;
        }
        let given_up = record.restarts_in_a_row >= self.config.give_up_after;
        if !requested && (!allowed || given_up) {
            return false;
        }
        let doubled = self.config.backoff_ms * 2_f64.powi(record.restarts_in_a_row.min(64) as i32);
        let delay_ms = if requested { 0.0 } else { doubled.min(self.config.backoff_cap_ms) };
        record.restarts_in_a_row += 1;
        let what = death.failure.message.clone();
        record.pending = Some(PendingRestart { died_ns: now, due_ns: now + (delay_ms * 1e6) as u64, what });
        true
    }

    /// How long the launcher may leave the processes alone, ns: not longer than `longest`, nor than a small part of the
    /// time after which one counts as hung. `None` while a process waits for its restart, or gave no sign of life since
    /// the last look.
    pub fn longest_look_away(&self, longest: u64) -> Option<u64> {
        let calm = self.records.iter().all(|record| record.pending.is_none() && record.silent_ns == 0);
        let part = (self.config.hang_s * 1e8) as u64;
        calm.then(|| if part == 0 { longest } else { longest.min(part) })
    }

    /// A process whose restart is due.
    pub fn due(&self, now: u64) -> Option<Role> {
        let due = |role: &Role| self.records[*role as usize].pending.as_ref().is_some_and(|p| p.due_ns <= now);
        Role::ALL.into_iter().find(due)
    }

    /// Records that the process is started again. Returns its new incarnation.
    pub fn record_restart(&mut self, role: Role, now: u64) -> u32 {
        let record = &mut self.records[role as usize];
        record.incarnation += 1;
        (record.started_ns, record.checked_ns, record.heartbeat, record.silent_ns) = (now, now, 0, 0);
        if let Some(PendingRestart { died_ns, what, .. }) = record.pending.take() {
            let away_s = now.saturating_sub(died_ns) as f64 / 1e9;
            self.incidents.push(RestartIncident {
                process: role.name(),
                what,
                incarnation: record.incarnation,
                away_s,
            });
        }
        record.incarnation
    }

    /// Records the heartbeat of a process. True if it has not changed for longer than the limit: the process hangs.
    pub fn hangs(&mut self, role: Role, heartbeat: u64, now: u64) -> bool {
        let silent_ns = self.silence(role, heartbeat, now);
        self.config.hang_s > 0.0 && silent_ns as f64 > self.config.hang_s * 1e9
    }

    /// The same for a process that closes its files: true if it has not changed its heartbeat for longer than
    /// `limit`.
    pub fn closes_too_long(&mut self, role: Role, heartbeat: u64, now: u64, limit: Duration) -> bool {
        self.silence(role, heartbeat, now) as u128 > limit.as_nanos()
    }

    /// For how long the heartbeat has not changed, ns.
    fn silence(&mut self, role: Role, heartbeat: u64, now: u64) -> u64 {
        let record = &mut self.records[role as usize];
        let since_check = now.saturating_sub(record.checked_ns).min(LONGEST_CHECK_NS);
        record.checked_ns = now;
        record.silent_ns = if heartbeat == record.heartbeat { record.silent_ns + since_check } else { 0 };
        record.heartbeat = heartbeat;
        record.silent_ns
    }

    /// The time since the process was started, ns.
    pub fn since_start(&self, role: Role, now: u64) -> u64 {
        now.saturating_sub(self.records[role as usize].started_ns)
    }
}

#[cfg(test)]
mod tests {
    use super::super::children::ProcessFailure;
    use super::*;

    const MS: u64 = 1_000_000;

    fn death(role: Role, kind: DeathKind) -> ProcessDeath {
        let message = "the logger was killed by signal 9 at tick 7".to_owned();
        ProcessDeath { failure: ProcessFailure::new(role, message), kind }
    }

    #[test]
    fn the_delay_doubles_up_to_its_cap_and_is_short_again_after_a_healthy_period() {
        let config = RestartConfig { backoff_cap_ms: 300.0, give_up_after: 6, ..RestartConfig::default() };
        let mut restarts = RestartTracker::new(&config, 0);
        let died = death(Role::Logger, DeathKind::Failure);
        let mut now = 0;
        for delay in [100, 200, 300, 300] {
            assert!(restarts.schedule(&died, now, false));
            assert_eq!(restarts.due(now + delay * MS - 1), None);
            now += delay * MS;
            assert_eq!(restarts.due(now), Some(Role::Logger));
            restarts.record_restart(Role::Logger, now);
            assert_eq!(restarts.due(now), None);
        }
        now += 10_001 * MS;
        assert!(restarts.schedule(&died, now, false));
        assert_eq!(restarts.due(now + 100 * MS), Some(Role::Logger));
        assert_eq!(restarts.record_restart(Role::Logger, now + 100 * MS), 5);
        assert_eq!(restarts.incidents.len(), 5);
        assert!((restarts.incidents[1].away_s - 0.2).abs() < 1e-9);
    }

    #[test]
    fn a_process_that_dies_repeatedly_is_given_up() {
        let config = RestartConfig { give_up_after: 3, ..RestartConfig::default() };
        let mut restarts = RestartTracker::new(&config, 0);
        let died = death(Role::Plant, DeathKind::Failure);
        for _ in 0..3 {
            assert!(restarts.schedule(&died, 5, false));
            restarts.record_restart(Role::Plant, 6);
        }
        assert!(!restarts.schedule(&died, 7, false));
        assert!(restarts.schedule(&died, 20_000 * MS, false), "unless it has run for a while");
    }

    #[test]
    fn a_policy_restarts_the_deaths_it_names() {
        let kinds = [DeathKind::Final, DeathKind::Failure, DeathKind::EarlyExit];
        for (policy, expected) in [
            (RestartPolicy::Never, [false, false, false]),
            (RestartPolicy::OnFailure, [false, true, false]),
            (RestartPolicy::Always, [false, true, true]),
        ] {
            let config = RestartConfig { controller: policy, ..RestartConfig::default() };
            let restarted =
                kinds.map(|kind| RestartTracker::new(&config, 0).schedule(&death(Role::Controller, kind), 1, false));
            assert_eq!(restarted, expected, "{policy:?}");
        }
    }

    #[test]
    fn only_a_silence_that_was_checked_counts() {
        let mut restarts = RestartTracker::new(&RestartConfig { hang_s: 1.0, ..RestartConfig::default() }, 0);
        assert!(!restarts.hangs(Role::Plant, 1, 100 * MS));
        assert!(!restarts.hangs(Role::Plant, 1, 60_000 * MS), "the launcher itself was not running");
        for check in 1..=8 {
            let now = (60_000 + 100 * check) * MS;
            assert!(!restarts.hangs(Role::Plant, 1, now), "{check}");
        }
        assert!(restarts.hangs(Role::Plant, 1, 60_901 * MS));
        assert!(!restarts.hangs(Role::Plant, 2, 60_950 * MS));
    }

    /// A process that hangs at every start is given up. Its silence is longer than `healthy_s`, and still not healthy.
    #[test]
    fn hangs_count_as_failures() {
        let config = RestartConfig { give_up_after: 3, hang_s: 20.0, healthy_s: 10.0, ..RestartConfig::default() };
        let mut restarts = RestartTracker::new(&config, 0);
        let (died, mut now) = (death(Role::Logger, DeathKind::Failure), 0);
        for start in 0..4 {
            while !restarts.hangs(Role::Logger, 1, now) {
                now += 100 * MS;
            }
            assert_eq!(restarts.schedule(&died, now, false), start < 3, "{start}");
            if start < 3 {
                restarts.record_restart(Role::Logger, now);
            }
        }
    }
}
