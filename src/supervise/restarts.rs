//! Who is started again, and when: restart policies, back-off, and how long a silence may be.
//!
//! A wait that doubles keeps a process that dies at once from taking the machine; a healthy while makes it short again. Pure
//! bookkeeping: the launcher hands in the time.

use serde::Serialize;

use super::children::ProcessDeath;
use crate::channel::INCARNATIONS;
use crate::scenario::{RestartConfig, RestartPolicy};
use crate::wire::Role;

/// Of a silence no more than this counts at a look, ns: if the launcher itself was not looking, others may have been as little to
/// blame.
const LONGEST_LOOK_NS: u64 = 200_000_000;

/// A process that died or hung, and came back.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RestartIncident {
    /// Which process.
    pub process: &'static str,
    /// What happened to it, one sentence.
    pub what: String,
    /// The start number under which it came back.
    pub incarnation: u32,
    /// Seconds between its death and its next start.
    pub away_s: f64,
}

/// What is known of one process.
#[derive(Debug, Clone, Default)]
struct ProcessRecord {
    /// When it was started last, ns.
    started: u64,
    /// Starts in a row without a healthy while between them.
    in_a_row: u32,
    /// When it died and when it is to be started again, ns, and what happened.
    due: Option<(u64, u64, String)>,
    incarnation: u32,
    /// Its last sign of life, when that was last looked at, and how long it has been the same, ns.
    beat: u64,
    looked: u64,
    silent: u64,
}

/// The launcher's book of its processes.
#[derive(Debug)]
pub(super) struct RestartTracker {
    table: RestartConfig,
    records: [ProcessRecord; 3],
    /// All that came back.
    pub incidents: Vec<RestartIncident>,
}

impl RestartTracker {
    /// A book under the rules of `table`; all processes have been started at `now`.
    pub fn new(table: &RestartConfig, now: u64) -> Self {
        let record = ProcessRecord { started: now, looked: now, ..ProcessRecord::default() };
        Self { table: table.clone(), records: [(); 3].map(|()| record.clone()), incidents: Vec::new() }
    }

    /// Whether the process is to be started again; then it is due after its wait. `at_once` is for one that was ended in
    /// order to be started again.
    pub fn take(&mut self, death: &ProcessDeath, now: u64, at_once: bool) -> bool {
        let record = &mut self.records[death.role as usize];
        let policy = self.table.of(death.role);
        let wanted = match death.unless {
            None => false,
            Some(RestartPolicy::Never) => policy != RestartPolicy::Never,
            Some(RestartPolicy::OnFailure | RestartPolicy::Always) => policy == RestartPolicy::Always,
        };
        if now.saturating_sub(record.started) as f64 > self.table.healthy_s * 1e9 {
            record.in_a_row = 0;
        }
        let left = record.in_a_row < self.table.give_up_after && record.incarnation + 1 < INCARNATIONS;
        if !(wanted && left || at_once && record.incarnation + 1 < INCARNATIONS) {
            return false;
        }
        let doubled = self.table.backoff_ms * 2_f64.powi(record.in_a_row.min(64) as i32);
        let listen = if at_once { 0.0 } else { doubled.min(self.table.backoff_cap_ms) };
        record.in_a_row += 1;
        record.due = Some((now, now + (listen * 1e6) as u64, death.failure.message.clone()));
        true
    }

    /// A process whose wait is over.
    pub fn due(&self, now: u64) -> Option<Role> {
        Role::ALL.into_iter().find(|&role| self.records[role as usize].due.as_ref().is_some_and(|due| due.1 <= now))
    }

    /// The process is started again, under the start number that is returned.
    pub fn started(&mut self, role: Role, now: u64) -> u32 {
        let record = &mut self.records[role as usize];
        record.incarnation += 1;
        (record.started, record.looked, record.beat, record.silent) = (now, now, 0, 0);
        if let Some((died, _, what)) = record.due.take() {
            let away_s = now.saturating_sub(died) as f64 / 1e9;
            self.incidents.push(RestartIncident {
                process: role.name(),
                what,
                incarnation: record.incarnation,
                away_s,
            });
        }
        record.incarnation
    }

    /// Takes note of a process's sign of life. True if it has been silent for too long.
    pub fn silent(&mut self, role: Role, beat: u64, now: u64) -> bool {
        let record = &mut self.records[role as usize];
        let since = now.saturating_sub(record.looked).min(LONGEST_LOOK_NS);
        record.looked = now;
        record.silent = if beat == record.beat { record.silent + since } else { 0 };
        record.beat = beat;
        self.table.hang_s > 0.0 && record.silent as f64 > self.table.hang_s * 1e9
    }

    /// How long since the process was started, ns.
    pub fn age(&self, role: Role, now: u64) -> u64 {
        now.saturating_sub(self.records[role as usize].started)
    }
}

#[cfg(test)]
mod tests {
    use super::super::children::ProcessFailure;
    use super::*;

    const MS: u64 = 1_000_000;

    fn death(role: Role, unless: Option<RestartPolicy>) -> ProcessDeath {
        let message = "the logger was killed by signal 9 at tick 7".to_owned();
        ProcessDeath { role, failure: ProcessFailure { code: 4, message, said: (role, String::new()) }, unless }
    }

    #[test]
    fn the_wait_doubles_up_to_its_cap_and_is_short_again_after_a_healthy_while() {
        let table = RestartConfig { backoff_cap_ms: 300.0, give_up_after: 6, ..RestartConfig::default() };
        let mut restarts = RestartTracker::new(&table, 0);
        let died = death(Role::Logger, Some(RestartPolicy::Never));
        let mut now = 0;
        for listen in [100, 200, 300, 300] {
            assert!(restarts.take(&died, now, false));
            assert_eq!(restarts.due(now + listen * MS - 1), None);
            now += listen * MS;
            assert_eq!(restarts.due(now), Some(Role::Logger));
            restarts.started(Role::Logger, now);
            assert_eq!(restarts.due(now), None);
        }
        now += 10_001 * MS;
        assert!(restarts.take(&died, now, false));
        assert_eq!(restarts.due(now + 100 * MS), Some(Role::Logger));
        assert_eq!(restarts.started(Role::Logger, now + 100 * MS), 5);
        assert_eq!(restarts.incidents.len(), 5);
        assert!((restarts.incidents[1].away_s - 0.2).abs() < 1e-9);
    }

    #[test]
    fn who_dies_again_and_again_is_given_up() {
        let mut restarts = RestartTracker::new(&RestartConfig { give_up_after: 3, ..RestartConfig::default() }, 0);
        let died = death(Role::Plant, Some(RestartPolicy::Never));
        for _ in 0..3 {
            assert!(restarts.take(&died, 5, false));
            restarts.started(Role::Plant, 6);
        }
        assert!(!restarts.take(&died, 7, false));
        assert!(restarts.take(&died, 20_000 * MS, false), "unless it has lived for a while");
    }

    #[test]
    fn policies() {
        let all = [None, Some(RestartPolicy::Never), Some(RestartPolicy::OnFailure)];
        for (policy, expected) in [
            (RestartPolicy::Never, [false, false, false]),
            (RestartPolicy::OnFailure, [false, true, false]),
            (RestartPolicy::Always, [false, true, true]),
        ] {
            let table = RestartConfig { controller: policy, ..RestartConfig::default() };
            let taken =
                all.map(|unless| RestartTracker::new(&table, 0).take(&death(Role::Controller, unless), 1, false));
            assert_eq!(taken, expected, "{policy:?}");
        }
    }

    #[test]
    fn only_a_silence_that_was_listened_to_counts() {
        let mut restarts = RestartTracker::new(&RestartConfig { hang_s: 1.0, ..RestartConfig::default() }, 0);
        assert!(!restarts.silent(Role::Plant, 1, 100 * MS));
        assert!(!restarts.silent(Role::Plant, 1, 60_000 * MS), "the launcher itself was away");
        for look in 1..=8 {
            let now = (60_000 + 100 * look) * MS;
            assert!(!restarts.silent(Role::Plant, 1, now), "{look}");
        }
        assert!(restarts.silent(Role::Plant, 1, 60_901 * MS));
        assert!(!restarts.silent(Role::Plant, 2, 60_950 * MS));
    }
}
