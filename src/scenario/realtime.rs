//! `[realtime]`: what each process asks of the operating system for itself when a run follows the real clock, and the
//! checks of it.
//!
//! Nothing is asked unless a file says so; only the timers' slack of 1 ns always is. What is asked is checked after the
//! request (`clock::realtime`), so that nothing here depends on the machine: a core that a machine lacks is a refusal
//! when the run starts, and the same file is good on another.

use serde::{Deserialize, Serialize};

use super::error::Violation;
use super::limits;
use crate::wire::Role;

/// `[realtime]`: a table for each process.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RealtimeConfig {
    /// What the plant asks for.
    #[serde(skip_serializing_if = "RealtimeProcess::is_nothing")]
    pub plant: RealtimeProcess,
    /// What the controller asks for.
    #[serde(skip_serializing_if = "RealtimeProcess::is_nothing")]
    pub controller: RealtimeProcess,
    /// What the logger asks for.
    #[serde(skip_serializing_if = "RealtimeProcess::is_nothing")]
    pub logger: RealtimeProcess,
}

/// `[realtime.plant]`, `[realtime.controller]`, `[realtime.logger]`: what the process asks for.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RealtimeProcess {
    /// Priority under SCHED_FIFO, 1 to 99; left out, the system's ordinary scheduler.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub priority: Option<u32>,
    /// The cores on which the process may run, from 0; left out, all.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub cores: Vec<u32>,
    /// Keep all memory in RAM, what is there and what will come.
    pub lock_memory: bool,
    /// Stack to be touched before the first tick, KiB; 0 to 4096.
    pub prefault_stack_kib: u32,
}

impl RealtimeConfig {
    /// What the process in the place of `role` asks for.
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
    /// Whether nothing is asked for.
    pub fn is_nothing(&self) -> bool {
        *self == Self::default()
    }
}

/// Checks what the types cannot say.
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

    /// What comes of `lines` at the end of a scenario: its plan's TOML, or the message.
    fn planned(lines: &str) -> Result<String, String> {
        let text = Scenario::find(std::path::Path::new("paper")).unwrap().to_toml() + lines;
        let scenario = Scenario::parse(&text, "x.toml").map_err(|e| e.to_string())?;
        scenario.plan().map(|plan| plan.scenario.to_toml()).map_err(|e| e.to_string())
    }

    #[test]
    fn nothing_is_asked_unless_the_file_says_so() {
        assert!(!planned("").unwrap().contains("realtime"), "and the hash of a file without it stays what it was");
        assert_eq!(planned("\n[realtime]\n"), planned(""));
        assert_eq!(planned("\n[realtime.plant]\ncores = []\nlock_memory = false\n"), planned(""));
        let asked = "\n[realtime.plant]\npriority = 80\ncores = [1, 0]\nlock_memory = true\nprefault_stack_kib = 512\n";
        let written = planned(asked).unwrap();
        assert!(written.ends_with(&asked[1..]), "{written}");
        assert!(planned("\n[realtime.logger]\npriority = 99\ncores = [1023]\n").is_ok(), "whatever this machine has");
    }

    #[test]
    fn what_no_machine_could_grant_is_refused() {
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
            let message = planned(&format!("\n[realtime.{lines}\n")).unwrap_err();
            let place = message.split_once(": ").unwrap();
            assert!(place.0.starts_with("x.toml:") && place.1.contains(expected), "{message}\n{expected}");
        }
    }
}
