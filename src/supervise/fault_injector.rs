//! Injects the process faults of a scenario (`[[faults.process]]`): the launcher kills, stops or restarts a
//! process at its first poll at which the plant has reached the fault's tick.

use super::world::{ProcessAction, SupervisedWorld};
use crate::scenario::{FaultsConfig, ProcessFaultKind};
use crate::wire::Role;

/// How often the launcher polls while a fault is pending, ns.
const POLL_NS: u64 = 200_000;

/// One fault.
#[derive(Debug, Clone, Copy)]
struct PlannedFault {
    tick: u64,
    role: Role,
    kind: ProcessFaultKind,
    /// For how long a process is stopped, ns.
    duration_ns: u64,
}

/// The pending faults, and those in effect.
#[derive(Debug)]
pub(super) struct ProcessFaultInjector {
    /// Pending faults. The last element is the next in time.
    pending: Vec<PlannedFault>,
    /// Processes that are stopped, and until when, ns.
    stopped: Vec<(Role, u64)>,
    /// Processes that were asked to end so that they restart.
    restarting: Vec<Role>,
}

impl ProcessFaultInjector {
    /// The faults of a scenario.
    pub fn new(config: &FaultsConfig) -> Self {
        let faults = config.process.iter().flat_map(|fault| {
            let duration_ns = (fault.for_ms.unwrap_or(0.0) * 1e6) as u64;
            let (role, kind) = (fault.process.role(), fault.act);
            fault.at.iter().map(move |&tick| PlannedFault { tick, role, kind, duration_ns })
        });
        let mut pending: Vec<_> = faults.collect();
        // The sort is stable: faults of equal ticks keep the order of the file.
        pending.sort_by_key(|fault| fault.tick);
        pending.reverse();
        Self { pending, stopped: Vec::new(), restarting: Vec::new() }
    }

    /// Injects what is due at the plant's `tick`, and lets stopped processes continue whose time is over. A
    /// fault of a process that is not running waits until it runs again.
    pub fn inject(&mut self, tick: u64, now: u64, world: &mut impl SupervisedWorld) {
        self.stopped.retain(|&(role, until)| {
            let over = now >= until;
            if over {
                world.act(role, ProcessAction::Continue);
            }
            !over
        });
        while let Some(&fault) = self.pending.last()
            && fault.tick <= tick
        {
            if !world.has_child(fault.role) {
                return;
            }
            match fault.kind {
                ProcessFaultKind::Kill => world.act(fault.role, ProcessAction::Kill),
                ProcessFaultKind::Stop => {
                    world.act(fault.role, ProcessAction::Stop);
                    self.stopped.push((fault.role, now + fault.duration_ns));
                }
                ProcessFaultKind::Restart => {
                    world.act(fault.role, ProcessAction::Terminate);
                    self.restarting.push(fault.role);
                }
            }
            self.pending.pop();
        }
    }

    /// Whether a process that has ended was asked to end so that it restarts. Forgets the request.
    pub fn take_restart(&mut self, role: Role) -> bool {
        let before = self.restarting.len();
        self.restarting.retain(|&restarting| restarting != role);
        self.restarting.len() < before
    }

    /// Whether a process is stopped by a fault. Its missing heartbeat is then no hang.
    pub fn is_stopped(&self, role: Role) -> bool {
        self.stopped.iter().any(|&(stopped, _)| stopped == role)
    }

    /// The launcher's poll interval: `ns`, or less while a fault is pending or in effect.
    pub fn poll_interval(&self, ns: u64) -> u64 {
        if self.pending.is_empty() && self.stopped.is_empty() { ns } else { ns.min(POLL_NS) }
    }
}
