//! The processes of a run: starts them, detects how each ended, and kills those that do not end by themselves.

use std::io::ErrorKind;
use std::os::fd::BorrowedFd;
use std::os::unix::process::{CommandExt as _, ExitStatusExt as _};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::Arc;

use super::error_output::{CollectedOutput, ErrorOutput, show};
use super::{Launch, LaunchError, StandIn, service_notifier};
use crate::channel::{DomainName, RunServices, WatchFiles, is_member};
use crate::clock::{ProcessHandle, monotonic_ns};
use crate::runtime::exit;
use crate::scenario::Plan;
use crate::wire::{ProcessState, Role, Status};

/// How long the end of a killed child may take, ns.
const KILL_LIMIT_NS: u64 = 1_000_000_000;
/// At the end of a run: how long what processes have left running may take to say its last words, ns.
const LAST_WORDS_NS: u64 = 300_000_000;
/// Number of standard errors of ended processes that are still read.
const MAX_LEFT: usize = 8;

/// The process that currently fills a role.
#[derive(Debug)]
enum ChildSlot {
    /// A child of the launcher, with what it writes to its standard error.
    Child { child: Child, process: Option<ProcessHandle>, stderr: ErrorOutput },
    /// Started by the user (`--by-hand`). Its process id is known once it has written its status board.
    ByHand { process: Option<ProcessHandle> },
    /// No process: it has ended, and was not started again or not yet.
    Empty,
}

/// How a process failed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ProcessFailure {
    /// Which process.
    pub role: Role,
    /// The exit code that the run ends with because of it.
    pub code: u8,
    /// What happened, one sentence.
    pub message: String,
    /// The beginning of what the process wrote to its standard error.
    pub stderr: String,
}

impl ProcessFailure {
    /// A failure with the exit code [`exit::PROCESS`] and without standard error.
    pub fn new(role: Role, message: String) -> Self {
        Self { role, code: exit::PROCESS, message, stderr: String::new() }
    }
}

/// A process that ended before it had finished its part of the run.
#[derive(Debug)]
pub struct ProcessDeath {
    /// The failure of the run, unless the process is restarted.
    pub failure: ProcessFailure,
    /// Which restart policies apply to it.
    pub kind: DeathKind,
}

/// Why a process ended, as far as its restart depends on it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DeathKind {
    /// It will not do better the next time, had already finished, or is not the launcher's child. No policy
    /// restarts it.
    Final,
    /// It failed. The policies `on-failure` and `always` restart it.
    Failure,
    /// It exited in good order, but too early. Only the policy `always` restarts it.
    EarlyExit,
}

/// How to start a process.
#[derive(Debug)]
struct SpawnCommand {
    program: PathBuf,
    arguments: Vec<String>,
}

/// All processes of a run, by [`Role`].
#[derive(Debug)]
pub(super) struct ChildProcesses {
    folder: PathBuf,
    /// How to start each process; `None` for one that the user starts.
    commands: Vec<Option<SpawnCommand>>,
    slots: Vec<ChildSlot>,
    /// The standard errors of processes that have ended, as long as a program that they started has them open: the
    /// guard of a killed bridge says what it did.
    left: Vec<ErrorOutput>,
    /// Where watchers find what the processes say.
    watch_files: Arc<WatchFiles>,
    /// The process whose place a program takes that waits for another machine, and says so.
    stand_in: Option<Role>,
    /// Whether all processes were still there when the last wait ended, and none had said anything.
    undisturbed: bool,
}

impl ChildProcesses {
    /// Starts all processes except those that the user starts by hand.
    pub fn start(launch: &Launch, folder: &Path, watch_files: Arc<WatchFiles>) -> Result<Self, LaunchError> {
        let Launch { plan, by_hand, stand_in, .. } = launch;
        // All programs are located before the first one starts, so that a missing one leaves no process behind.
        let mut commands = Vec::new();
        for role in Role::ALL {
            commands.push(match stand_in.as_ref().filter(|stand_in| stand_in.role == role) {
                _ if by_hand.contains(&role) => None,
                Some(StandIn { program, arguments, .. }) => {
                    Some(SpawnCommand { program: program.clone(), arguments: arguments.clone() })
                }
                None => Some(SpawnCommand::locate(plan, role)?),
            });
        }
        let (slots, left) = (Vec::new(), Vec::new());
        let stand_in = stand_in.as_ref().map(|stand_in| stand_in.role);
        let folder = folder.to_owned();
        let mut children = Self { folder, commands, slots, left, watch_files, stand_in, undisturbed: false };
        for role in Role::ALL {
            let slot = match children.commands[role as usize] {
                Some(_) => children.spawn(role)?,
                None => ChildSlot::ByHand { process: None },
            };
            children.slots.push(slot);
        }
        Ok(children)
    }

    fn spawn(&self, role: Role) -> Result<ChildSlot, LaunchError> {
        let failed = |program: &Path, cause: &str| LaunchError::Start {
            role: role.name(),
            program: program.display().to_string(),
            cause: cause.to_owned(),
        };
        let Some(SpawnCommand { program, arguments }) = &self.commands[role as usize] else {
            return Err(failed(Path::new("?"), "it is started by hand"));
        };
        let mut command = Command::new(program);
        // With a process group of its own, Ctrl-C at the terminal reaches only the launcher, which ends the run
        // in order.
        command.args(arguments).arg("--run").arg(&self.folder).process_group(0);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
        // The service manager hears the launcher alone.
        for variable in service_notifier::VARIABLES {
            command.env_remove(variable);
        }
        let mut child = command.spawn().map_err(|cause| match cause.kind() {
            // Nobody would look for the cause behind `Resource temporarily unavailable`.
            ErrorKind::WouldBlock => {
                failed(program, "the limit on this user's processes and threads is reached; raise it (ulimit -u)")
            }
            _ => failed(program, &cause.to_string()),
        })?;
        let shown = self.shows(role);
        let stderr = ErrorOutput::of(child.stderr.take(), role, shown, Arc::clone(&self.watch_files));
        let process = ProcessHandle::of(child.id());
        Ok(ChildSlot::Child { child, process, stderr })
    }

    /// Whether what the process in `role` says is shown on the launcher's standard error while it lives.
    fn shows(&self, role: Role) -> bool {
        role == Role::Plant || self.stand_in == Some(role)
    }

    /// Starts the process of an empty slot again.
    pub fn start_again(&mut self, role: Role) -> Result<(), LaunchError> {
        self.slots[role as usize] = self.spawn(role)?;
        Ok(())
    }

    /// Empties the slots of processes that have ended. Returns those that ended before they had finished. Reads what
    /// the others have written to their standard error.
    pub fn reap(&mut self, services: &RunServices) -> Vec<ProcessDeath> {
        let mut deaths = Vec::new();
        if std::mem::take(&mut self.undisturbed) {
            return deaths;
        }
        for (role, slot) in Role::ALL.into_iter().zip(&mut self.slots) {
            let stand_in = self.stand_in == Some(role);
            if let Some(ended) = slot.poll_end(role, &|| services.status(role), services.domain(), stand_in) {
                if let ChildSlot::Child { stderr, .. } = std::mem::replace(slot, ChildSlot::Empty) {
                    self.left.push(stderr);
                }
                deaths.extend(ended);
            }
        }
        self.read_left();
        deaths
    }

    fn read_left(&mut self) {
        self.left.iter_mut().for_each(ErrorOutput::read);
        self.left.retain(|stderr| stderr.pipe().is_some());
        self.left.drain(..self.left.len().saturating_sub(MAX_LEFT));
    }

    /// Waits for what the processes, which have ended, have left running, until it has closed their standard errors;
    /// not for long.
    pub fn await_last_words(&mut self) {
        let began = monotonic_ns();
        while !self.left.is_empty() && monotonic_ns() - began < LAST_WORDS_NS {
            self.await_end(LAST_WORDS_NS / 10, None);
            self.read_left();
        }
    }

    /// Waits until a process has ended or written to its standard error, `signals` can be read, or for `ns`
    /// nanoseconds. Returns false if the time is over, and nothing of that has happened.
    pub fn await_end(&mut self, ns: u64, signals: Option<BorrowedFd<'_>>) -> bool {
        let pipes = self.slots.iter().filter_map(|slot| match slot {
            ChildSlot::Child { stderr, .. } => stderr.pipe(),
            _ => None,
        });
        let pipes = pipes.chain(self.left.iter().filter_map(ErrorOutput::pipe)).chain(signals);
        let happened = ProcessHandle::await_any_or(self.slots.iter().filter_map(ChildSlot::process), pipes, ns);
        self.undisturbed = !happened && self.slots.iter().all(ChildSlot::is_awaited);
        happened
    }

    /// Whether there is no process in this role: it has ended, and has not been started again.
    pub fn is_empty(&self, role: Role) -> bool {
        matches!(self.slots[role as usize], ChildSlot::Empty)
    }

    /// A handle on the launcher's child in this role, if it has not ended.
    pub fn child(&self, role: Role) -> Option<&ProcessHandle> {
        match &self.slots[role as usize] {
            ChildSlot::Child { process, .. } => process.as_ref(),
            _ => None,
        }
    }

    /// Whether all processes have ended. One that the user should have started and never did counts as ended.
    pub fn all_ended(&self) -> bool {
        self.slots.iter().all(|slot| matches!(slot, ChildSlot::Empty | ChildSlot::ByHand { process: None }))
    }

    /// Kills all remaining processes and what they have started, and waits for the launcher's children among them.
    /// A child that the kernel cannot end right now, because it waits for a disk, is left behind.
    pub fn kill(&mut self) {
        for slot in &mut self.slots {
            match slot {
                ChildSlot::Child { child, process, .. } => {
                    let _ = child.kill();
                    if let Some(process) = process {
                        process.kill_group();
                        ProcessHandle::await_any(std::iter::once(&*process), KILL_LIMIT_NS);
                    }
                    let _ = child.try_wait();
                }
                ChildSlot::ByHand { process: Some(process) } => process.kill(),
                _ => {}
            }
            *slot = ChildSlot::Empty;
        }
    }
}

impl Drop for ChildProcesses {
    fn drop(&mut self) {
        self.kill();
    }
}

impl ChildSlot {
    fn process(&self) -> Option<&ProcessHandle> {
        match self {
            Self::Child { process, .. } | Self::ByHand { process } => process.as_ref(),
            Self::Empty => None,
        }
    }

    /// Whether a wait ends with the process, and with whatever else the launcher has to do about it.
    fn is_awaited(&self) -> bool {
        match self {
            Self::Child { process, stderr, .. } => process.is_some() && !stderr.holds_line(),
            Self::ByHand { process } => process.is_some(),
            Self::Empty => true,
        }
    }

    /// `None` while the process runs or the slot is empty; once it has ended, `Some` with its death, if it had not
    /// finished its part of the run. Until its end it can say that it has finished, so its end is looked at first,
    /// and `board`, which reads what it says, after it.
    fn poll_end(
        &mut self,
        role: Role,
        board: &dyn Fn() -> Status,
        domain: &DomainName,
        stand_in: bool,
    ) -> Option<Option<ProcessDeath>> {
        let finished = || board().state() == ProcessState::Finished;
        match self {
            Self::Empty => None,
            Self::Child { child, process, stderr } => {
                stderr.read();
                if let Some(process) = process {
                    if !process.ended() {
                        return None;
                    }
                    // What it has started ends with it, before it is collected: a successor needs the same devices.
                    if !finished() {
                        process.kill_group();
                    }
                }
                match child.try_wait() {
                    Ok(None) => None,
                    Ok(Some(status)) => {
                        Some(death_of(role, status, stderr.take(), board().ticks, finished(), stand_in))
                    }
                    Err(_) => Some(Some(ended_early(role, board().ticks, DeathKind::Failure))),
                }
            }
            Self::ByHand { process } => {
                let mut ended = process.as_ref().is_some_and(ProcessHandle::ended);
                let pid = board().pid;
                if process.is_none() && pid != 0 {
                    // The id comes from shared memory. Whatever process has it now, it may be killed only if it is
                    // a process of this run.
                    *process = ProcessHandle::of(pid).filter(|_| is_member(domain, pid));
                    ended = process.is_none();
                }
                ended.then(|| (!finished()).then(|| ended_early(role, board().ticks, DeathKind::Final)))
            }
        }
    }
}

impl SpawnCommand {
    fn locate(plan: &Plan, role: Role) -> Result<Self, LaunchError> {
        let (name, arguments): (&str, &[String]) = match role {
            Role::Plant => (&plan.scenario.plant.program, &plan.scenario.plant.args),
            Role::Controller => (&plan.scenario.controller.program, &plan.scenario.controller.args),
            Role::Logger => (crate::scenario::programs::LOGGER, &[]),
        };
        let scenario = &plan.scenario;
        let missing = |cause| LaunchError::Start { role: role.name(), program: name.to_owned(), cause };
        let program = scenario.find_program(name).map_err(missing)?;
        Ok(Self { program, arguments: scenario.resolve_arguments(arguments) })
    }
}

/// The last line of what a process wrote to its standard error, without the program's name, which the launcher's
/// message states already. To an exception that Python itself printed (a module that is missing, an error of syntax),
/// adds where it was raised.
fn last_words(stderr: &str, role: &str) -> Option<String> {
    let last = stderr.trim().lines().last()?;
    let (before, rest) = last.split_once(": ").unwrap_or(("", last));
    let raised = stderr.lines().rev().find_map(|line| line.trim_start().strip_prefix("File \""));
    if let (true, Some(frame)) = (before.ends_with("Error") || before.ends_with("Exception"), raised) {
        let (file, line) = frame.split_once("\", line ").unwrap_or((frame, ""));
        let line = line.split(',').next().unwrap_or_default();
        return Some(format!("{last}, at {file}:{line}; the traceback is in {role}.stderr in the run's folder"));
    }
    Some(rest.to_owned())
}

fn ended_early(role: Role, tick: u64, kind: DeathKind) -> ProcessDeath {
    let message = format!("the {} ended before the run was over, at tick {tick}", role.name());
    ProcessDeath { failure: ProcessFailure::new(role, message), kind }
}

/// The signal that nobody can catch.
const SIGKILL: i32 = 9;

/// The death of a child that ended with `status`; `None` for one that had finished, and then succeeded or was killed:
/// a process says that it has finished when all that it leaves is in its place.
fn death_of(
    role: Role,
    status: ExitStatus,
    output: CollectedOutput,
    tick: u64,
    finished: bool,
    stand_in: bool,
) -> Option<ProcessDeath> {
    if status.success() || status.signal().is_some() {
        show(output.held, role == Role::Plant);
    }
    if status.success() {
        return (!finished).then(|| ended_early(role, tick, DeathKind::EarlyExit));
    }
    if finished && status.signal() == Some(SIGKILL) {
        return None;
    }
    let stderr = output.text;
    let name = role.name();
    let last = last_words(&stderr, name);
    let message = match (status.signal(), last) {
        (Some(signal), _) => format!("the {name} was killed by signal {signal} at tick {tick}"),
        (None, Some(line)) => format!("the {name} ended: {line}"),
        (None, None) => format!("the {name} ended at tick {tick} with exit code {}", status.code().unwrap_or(-1)),
    };
    let is = |code: u8| status.code() == Some(i32::from(code));
    // The run takes over the exit codes that tell the user what to do. All others become "a process failed".
    let code = [exit::INPUT, exit::MISMATCH].into_iter().find(|&code| is(code)).unwrap_or(exit::PROCESS);
    let kind = match code {
        // Bad input and a mismatch are the same at the next start.
        exit::INPUT | exit::MISMATCH => DeathKind::Final,
        // It has finished its part of the run, and reports what went wrong in it.
        _ if finished => DeathKind::Final,
        // The run on the other machine is over.
        _ if stand_in && is(exit::PROCESS) => DeathKind::Final,
        // It ended as a signal asked it to.
        _ if [exit::TERMINATED, exit::INTERRUPTED, exit::HUNG_UP, exit::QUIT].into_iter().any(is) => {
            DeathKind::EarlyExit
        }
        _ => DeathKind::Failure,
    };
    Some(ProcessDeath { failure: ProcessFailure { role, code, message, stderr }, kind })
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;

    use super::*;

    #[test]
    fn a_process_that_is_killed_when_it_has_finished_is_no_failure() {
        let death = |wait_status: i32, finished| {
            let status = ExitStatus::from_raw(wait_status);
            let output = CollectedOutput::default();
            death_of(Role::Plant, status, output, 7, finished, false).map(|death| death.kind)
        };
        const SEGV: i32 = 11;
        assert_eq!(death(SIGKILL, true), None);
        assert_eq!(death(SIGKILL, false), Some(DeathKind::Failure));
        assert_eq!(death(SEGV, true), Some(DeathKind::Final));
        assert_eq!((death(0, true), death(0, false)), (None, Some(DeathKind::EarlyExit)));
    }

    /// The launcher reads that it has not finished; before the next line it finishes and ends.
    #[test]
    fn a_process_that_ends_while_it_is_looked_at_has_finished() {
        let mut child = Command::new("cat").stdin(Stdio::piped()).stdout(Stdio::null()).spawn().unwrap();
        let (input, process) = (RefCell::new(child.stdin.take()), ProcessHandle::of(child.id()).unwrap());
        let state = |state| Status { state: state as u32, ..Status::default() };
        let board = || {
            if input.take().is_none() {
                return state(ProcessState::Finished);
            }
            ProcessHandle::await_any([&process].into_iter(), u64::MAX);
            state(ProcessState::Running)
        };
        let domain = DomainName::of(0);
        let watch_files = Arc::new(WatchFiles::create(&domain, Path::new("nowhere")));
        let stderr = ErrorOutput::of(None, Role::Plant, false, watch_files);
        let mut slot = ChildSlot::Child { process: ProcessHandle::of(child.id()), child, stderr };
        let mut look = || slot.poll_end(Role::Plant, &board, &domain, false).map(|death| death.is_some());
        assert_eq!(look(), None, "it runs");
        board();
        assert_eq!(look(), Some(false), "it has finished");
    }
}
