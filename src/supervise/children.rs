//! The run's processes: starting them, knowing how they ended, and, if nothing else helps, killing them.

use std::io::Read;
use std::os::unix::process::{CommandExt as _, ExitStatusExt as _};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::thread::JoinHandle;

use super::LaunchError;
use crate::channel::RunServices;
use crate::clock::ProcessHandle;
use crate::programs;
use crate::runtime::exit;
use crate::scenario::{Plan, RestartPolicy};
use crate::wire::{ProcessState, Role};

/// What stands in one process's place.
#[derive(Debug)]
enum ChildSlot {
    /// A child of the launcher.
    Child { child: Child, process: Option<ProcessHandle>, said: Option<JoinHandle<String>> },
    /// Started by somebody else; known from its board once it is there.
    ByHand { process: Option<ProcessHandle> },
    /// Nobody, any more or for now.
    Gone,
}

/// How a process failed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct ProcessFailure {
    /// The exit code that the run takes over.
    pub code: u8,
    /// One sentence.
    pub message: String,
    /// The process, and all that it wrote to its standard error.
    pub said: (Role, String),
}

/// A process that ended before it had finished.
#[derive(Debug)]
pub(super) struct ProcessDeath {
    /// Its place.
    pub role: Role,
    /// What that means for the run, if it is not started again.
    pub failure: ProcessFailure,
    /// The last policy under which it is not started again.
    pub unless: Option<RestartPolicy>,
}

/// How to start a process.
#[derive(Debug)]
struct SpawnCommand {
    program: PathBuf,
    arguments: Vec<String>,
}

/// All processes, by [`Role`].
#[derive(Debug)]
pub(super) struct ChildProcesses {
    folder: PathBuf,
    /// How to start each; `None` for one that somebody else starts.
    starts: Vec<Option<SpawnCommand>>,
    members: Vec<ChildSlot>,
}

impl ChildProcesses {
    /// Starts all processes but those in `by_hand`.
    pub fn start(plan: &Plan, folder: &Path, by_hand: &[Role]) -> Result<Self, LaunchError> {
        // All programs are found before any is started.
        let mut starts = Vec::new();
        for role in Role::ALL {
            let (name, arguments): (&str, &[String]) = match role {
                Role::Plant => (&plan.scenario.plant.program, &plan.scenario.plant.args),
                Role::Controller => (programs::CONTROLLER, &[]),
                Role::Logger => (programs::LOGGER, &[]),
            };
            if by_hand.contains(&role) {
                starts.push(None);
                continue;
            }
            let program = find(name).ok_or_else(|| LaunchError::Start {
                role: role.name(),
                program: name.to_owned(),
                cause: "no such program beside `tectum` or in PATH; build all of them with `cargo build --release`, \
                        or name the plant's program by its path"
                    .to_owned(),
            })?;
            starts.push(Some(SpawnCommand { program, arguments: arguments.to_owned() }));
        }
        let mut children = Self { folder: folder.to_owned(), starts, members: Vec::new() };
        for role in Role::ALL {
            let member = match children.starts[role as usize] {
                Some(_) => children.spawn(role)?,
                None => ChildSlot::ByHand { process: None },
            };
            children.members.push(member);
        }
        Ok(children)
    }

    fn spawn(&self, role: Role) -> Result<ChildSlot, LaunchError> {
        let failed = |program: &Path, cause: &str| LaunchError::Start {
            role: role.name(),
            program: program.display().to_string(),
            cause: cause.to_owned(),
        };
        let Some(SpawnCommand { program, arguments }) = &self.starts[role as usize] else {
            return Err(failed(Path::new("?"), "it is started by hand"));
        };
        let mut command = Command::new(program);
        // A process group of its own: a Ctrl-C at the terminal reaches the launcher alone, which ends the run in order.
        command.args(arguments).arg("--run").arg(&self.folder).process_group(0);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
        let mut child = command.spawn().map_err(|cause| failed(program, &cause.to_string()))?;
        let said = child.stderr.take().map(|pipe| std::thread::spawn(move || listen(pipe)));
        let process = ProcessHandle::of(child.id());
        Ok(ChildSlot::Child { child, process, said })
    }

    /// Starts a process anew whose place is empty.
    pub fn start_again(&mut self, role: Role) -> Result<(), LaunchError> {
        self.members[role as usize] = self.spawn(role)?;
        Ok(())
    }

    /// Notices who has ended, and says who did so before having finished.
    pub fn reap(&mut self, services: &RunServices) -> Vec<ProcessDeath> {
        let mut deaths = Vec::new();
        for (role, member) in Role::ALL.into_iter().zip(&mut self.members) {
            let board = services.status(role);
            let finished = board.state() == ProcessState::Finished;
            let death = match member {
                ChildSlot::Gone => continue,
                ChildSlot::Child { child, said, .. } => match child.try_wait() {
                    Ok(None) => continue,
                    Ok(Some(status)) => death_of(role, status, said.take(), board.ticks, finished),
                    Err(_) => Some(ended_early(role, board.ticks, Some(RestartPolicy::Never))),
                },
                ChildSlot::ByHand { process } => {
                    let mut ended = process.as_ref().is_some_and(ProcessHandle::ended);
                    if process.is_none() && board.pid != 0 {
                        *process = ProcessHandle::of(board.pid);
                        ended = process.is_none();
                    }
                    match (ended, finished) {
                        (false, _) => continue,
                        (true, true) => None,
                        (true, false) => Some(ended_early(role, board.ticks, None)),
                    }
                }
            };
            *member = ChildSlot::Gone;
            deaths.extend(death);
        }
        deaths
    }

    /// Waits until a child has ended, or for `ns` nanoseconds.
    pub fn await_end(&self, ns: u64) {
        ProcessHandle::await_any(self.members.iter().filter_map(ChildSlot::process), ns);
    }

    /// A handle on a process that the launcher has started and that lives.
    pub fn child(&self, role: Role) -> Option<&ProcessHandle> {
        match &self.members[role as usize] {
            ChildSlot::Child { process, .. } => process.as_ref(),
            _ => None,
        }
    }

    /// Whether all processes have ended. One that is started by hand and never came counts as ended.
    pub fn gone(&self) -> bool {
        self.members.iter().all(|member| matches!(member, ChildSlot::Gone | ChildSlot::ByHand { process: None }))
    }

    /// Kills whoever is left, and waits for those that are ours.
    pub fn kill(&mut self) {
        for member in &mut self.members {
            match member {
                ChildSlot::Child { child, .. } => {
                    let _ = child.kill();
                    let _ = child.wait();
                }
                ChildSlot::ByHand { process: Some(process) } => process.kill(),
                _ => {}
            }
            *member = ChildSlot::Gone;
        }
    }
}

impl ChildSlot {
    fn process(&self) -> Option<&ProcessHandle> {
        match self {
            Self::Child { process, .. } | Self::ByHand { process } => process.as_ref(),
            Self::Gone => None,
        }
    }
}

impl Drop for ChildProcesses {
    fn drop(&mut self) {
        self.kill();
    }
}

/// Reads all that a process says, so that it never waits for a reader, and keeps the beginning.
fn listen(mut pipe: impl Read) -> String {
    const KEPT: u64 = 64 << 10;
    let mut said = Vec::new();
    let _ = pipe.by_ref().take(KEPT).read_to_end(&mut said);
    let _ = std::io::copy(&mut pipe, &mut std::io::sink());
    String::from_utf8_lossy(&said).into_owned()
}

/// A program given by path, beside this one, or in `PATH`.
fn find(name: &str) -> Option<PathBuf> {
    if name.contains('/') {
        return Some(PathBuf::from(name)).filter(|p| p.is_file());
    }
    let beside = std::env::current_exe().ok().and_then(|exe| Some(exe.parent()?.join(name)));
    let path = std::env::var_os("PATH").unwrap_or_default();
    beside.into_iter().chain(std::env::split_paths(&path).map(|folder| folder.join(name))).find(|p| p.is_file())
}

fn ended_early(role: Role, tick: u64, unless: Option<RestartPolicy>) -> ProcessDeath {
    let message = format!("the {} ended before the run was over, at tick {tick}", role.name());
    ProcessDeath { role, failure: ProcessFailure { code: exit::PROCESS, message, said: (role, String::new()) }, unless }
}

fn death_of(
    role: Role,
    status: ExitStatus,
    said: Option<JoinHandle<String>>,
    tick: u64,
    finished: bool,
) -> Option<ProcessDeath> {
    if status.success() {
        return (!finished).then(|| ended_early(role, tick, Some(RestartPolicy::OnFailure)));
    }
    let said = said.and_then(|listener| listener.join().ok()).unwrap_or_default();
    let name = role.name();
    // A program's message opens with its own name, which here says nothing new.
    let last = said.trim().lines().last().map(|line| line.split_once(": ").map_or(line, |(_, rest)| rest));
    let message = match (status.signal(), last) {
        (Some(signal), _) => format!("the {name} was killed by signal {signal} at tick {tick}"),
        (None, Some(line)) => format!("the {name} ended: {line}"),
        (None, None) => format!("the {name} ended at tick {tick} with exit code {}", status.code().unwrap_or(-1)),
    };
    let is = |code: u8| status.code() == Some(i32::from(code));
    // Codes that say what the user can do are taken over; all others say that a process failed.
    let code = [exit::INPUT, exit::MISMATCH].into_iter().find(|&code| is(code)).unwrap_or(exit::PROCESS);
    let unless = match code {
        // What does not fit will not fit the next time.
        exit::INPUT | exit::MISMATCH => None,
        // It has finished its part of the run, and tells what went wrong in it.
        _ if finished => None,
        // Somebody has asked it to end, and it did.
        _ if is(exit::TERMINATED) || is(exit::INTERRUPTED) => Some(RestartPolicy::OnFailure),
        _ => Some(RestartPolicy::Never),
    };
    Some(ProcessDeath { role, failure: ProcessFailure { code, message, said: (role, said) }, unless })
}
