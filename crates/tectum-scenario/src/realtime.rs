//! `[realtime]`: the settings that each process requests from the operating system in a real-time run, and
//! their checks.
//!
//! By default a process requests only a timer slack of 1 ns. Whether the machine grants a request is checked
//! when the run starts (`clock::realtime`). So nothing here depends on the machine: a core that one machine
//! lacks is refused at the start of the run, and the same file is valid on another machine.

use serde::{Deserialize, Serialize};

use super::error::Violation;
use super::limits;
use crate::Role;

/// `[realtime]`: one table per process.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RealtimeConfig {
    /// Requests of the plant.
    #[serde(skip_serializing_if = "RealtimeProcess::is_nothing")]
    pub plant: RealtimeProcess,
    /// Requests of the controller.
    #[serde(skip_serializing_if = "RealtimeProcess::is_nothing")]
    pub controller: RealtimeProcess,
    /// Requests of the logger.
    #[serde(skip_serializing_if = "RealtimeProcess::is_nothing")]
    pub logger: RealtimeProcess,
}

/// `[realtime.plant]`, `[realtime.controller]`, `[realtime.logger]`: the requests of one process.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RealtimeProcess {
    /// Priority under SCHED_FIFO, 1 to 99. Default: the system's ordinary scheduler.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub priority: Option<u32>,
    /// The cores on which the process may run, counted from 0. Default: all.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub cores: Vec<u32>,
    /// Locks all memory in RAM, current and future (`mlockall`).
    pub lock_memory: bool,
    /// Stack that is touched before the first tick, KiB; 0 to 4096.
    pub prefault_stack_kib: u32,
}

impl RealtimeConfig {
    /// The requests of the process with this role.
    pub fn of(&self, role: Role) -> &RealtimeProcess {
        match role {
            Role::Plant => &self.plant,
            Role::Controller => &self.controller,
            Role::Logger => &self.logger,
        }
    }

    pub(super) fn is_nothing(&self) -> bool {
        Role::ALL.iter().all(|&role| self.of(role).is_nothing())
    }
}

impl RealtimeProcess {
    /// Whether the table requests nothing.
    pub fn is_nothing(&self) -> bool {
        *self == Self::default()
    }
}

/// Checks ranges, and that no core is listed twice.
pub(super) fn check(realtime: &RealtimeConfig) -> Result<(), Violation> {
    for role in Role::ALL {
        let process = realtime.of(role);
        let key = |key: &str| format!("realtime.{}.{key}", role.name());
        if let Some(priority) = process.priority
            && !limits::PRIORITY.contains(&priority)
        {
            let remedy = "give 1 to 99, or leave it out for the ordinary scheduler";
            return Err(Violation::value(key("priority"), priority, remedy));
        }
        for (i, core) in process.cores.iter().enumerate() {
            let key = key(&format!("cores[{i}]"));
            if *core > limits::MAX_CORE {
                return Err(Violation::value(key, core, "give 0 to 1023; cores are counted from 0"));
            }
            if process.cores[..i].contains(core) {
                let remedy = "this core is in the list already, and each may occur once";
                return Err(Violation::value(key, core, remedy));
            }
        }
        if process.prefault_stack_kib > limits::MAX_STACK_KIB {
            let remedy = "give 0 to 4096 KiB, so that it fits into the usual stack of 8 MiB";
            return Err(Violation::value(key("prefault_stack_kib"), process.prefault_stack_kib, remedy));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::Scenario;

    /// The resolved TOML of a scenario with `lines` appended, or the message.
    fn plan_with(lines: &str) -> Result<String, String> {
        let text = Scenario::find(std::path::Path::new("paper")).unwrap().to_toml() + lines;
        let scenario = Scenario::parse(&text, "x.toml").map_err(|e| e.to_string())?;
        scenario.plan().map(|plan| plan.scenario.to_toml()).map_err(|e| e.to_string())
    }

    #[test]
    fn nothing_is_requested_by_default() {
        assert!(!plan_with("").unwrap().contains("realtime"), "a file without the table keeps its hash");
        assert_eq!(plan_with("\n[realtime]\n"), plan_with(""));
        assert_eq!(plan_with("\n[realtime.plant]\ncores = []\nlock_memory = false\n"), plan_with(""));
        let requests =
            "\n[realtime.plant]\npriority = 80\ncores = [1, 0]\nlock_memory = true\nprefault_stack_kib = 512\n";
        let written = plan_with(requests).unwrap();
        assert!(written.ends_with(&requests[1..]), "{written}");
        assert!(
            plan_with("\n[realtime.logger]\npriority = 99\ncores = [1023]\n").is_ok(),
            "valid whatever cores this machine has"
        );
    }

    #[test]
    fn requests_that_no_machine_could_grant_are_refused() {
        for (lines, expected) in [
            ("plant]\npriority = 0", "realtime.plant.priority is 0; give 1 to 99, or leave it out"),
            ("controller]\npriority = 100", "realtime.controller.priority is 100; give 1 to 99"),
            ("plant]\npriority = -1", "realtime.plant.priority is -1; give a whole number from 0"),
            ("logger]\ncores = [0, 1024]", "realtime.logger.cores[1] is 1024; give 0 to 1023"),
            ("logger]\ncores = [1, 1]", "realtime.logger.cores[1] is 1; this core is in the list already"),
            ("plant]\ncores = [\"a\"]", "realtime.plant.cores[0] is \"a\"; give a whole number from 0"),
            ("plant]\ncores = 1", "realtime.plant.cores is 1; give a list, in [ ]"),
            ("plant]\nlock_memory = 1", "realtime.plant.lock_memory is 1; give true or false"),
            ("plant]\nprefault_stack_kib = 4097", "realtime.plant.prefault_stack_kib is 4097; give 0 to 4096 KiB"),
            ("plant]\nprio = 3", "realtime.plant.prio"),
            ("launcher]", "realtime.launcher"),
        ] {
            let message = plan_with(&format!("\n[realtime.{lines}\n")).unwrap_err();
            let place = message.split_once(": ").unwrap();
            assert!(place.0.starts_with("x.toml:") && place.1.contains(expected), "{message}\n{expected}");
        }
    }
}
