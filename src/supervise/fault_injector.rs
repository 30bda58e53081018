//! What a scenario wants to happen to processes (`[[faults.process]]`): the launcher does it, at the first look at which the
//! plant has come to the tick.

use super::children::ChildProcesses;
use crate::scenario::{FaultsConfig, ProcessFaultKind};
use crate::wire::Role;

/// How often the launcher looks while something is still to happen, ns.
const LOOK_NS: u64 = 200_000;

/// What is still to happen.
#[derive(Debug)]
pub(super) struct ProcessFaultInjector {
    /// Tick, process, act, and for how long, ns; the last comes first in time.
    acts: Vec<(u64, Role, ProcessFaultKind, u64)>,
    /// Processes that stand still, and until when, ns.
    stopped: Vec<(Role, u64)>,
    /// Processes that were asked to end in order to be started again.
    asked: Vec<Role>,
}

impl ProcessFaultInjector {
    /// What the table wants.
    pub fn of(table: &FaultsConfig) -> Self {
        let each = table.process.iter().flat_map(|fault| {
            let ns = (fault.for_ms.unwrap_or(0.0) * 1e6) as u64;
            fault.at.iter().map(move |&tick| (tick, fault.process.role(), fault.act, ns))
        });
        let mut acts: Vec<_> = each.collect();
        // Equal ticks keep the order of the file.
        acts.sort_by_key(|act| act.0);
        acts.reverse();
        Self { acts, stopped: Vec::new(), asked: Vec::new() }
    }

    /// Does what is due at the plant's `tick`. A process that is away at the time is struck when it is back.
    pub fn act(&mut self, tick: u64, now: u64, children: &ChildProcesses) {
        self.stopped.retain(|&(role, until)| {
            let over = now >= until;
            if let (true, Some(process)) = (over, children.child(role)) {
                process.stop(false);
            }
            !over
        });
        while let Some(&(at, role, act, ns)) = self.acts.last()
            && at <= tick
        {
            let Some(process) = children.child(role) else { return };
            match act {
                ProcessFaultKind::Kill => process.kill(),
                ProcessFaultKind::Stop => {
                    process.stop(true);
                    self.stopped.push((role, now + ns));
                }
                ProcessFaultKind::Restart => {
                    process.terminate();
                    self.asked.push(role);
                }
            }
            self.acts.pop();
        }
    }

    /// Whether a process that ended was asked to, in order to be started again.
    pub fn wanted(&mut self, role: Role) -> bool {
        let before = self.asked.len();
        self.asked.retain(|&asked| asked != role);
        self.asked.len() < before
    }

    /// Whether a process stands still because it was made to.
    pub fn stands(&self, role: Role) -> bool {
        self.stopped.iter().any(|&(stopped, _)| stopped == role)
    }

    /// How long the launcher may wait until its next look, if it would wait `ns` otherwise.
    pub fn patience(&self, ns: u64) -> u64 {
        if self.acts.is_empty() && self.stopped.is_empty() { ns } else { ns.min(LOOK_NS) }
    }
}
