//! The run's processes: starting them, knowing how they ended, and, if nothing else helps, killing them.

use std::io::Read;
use std::os::unix::process::{CommandExt as _, ExitStatusExt as _};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::thread::JoinHandle;

use super::LaunchError;
use crate::channel::Hub;
use crate::clock::Life;
use crate::runtime::exit;
use crate::scenario::Plan;
use crate::wire::{Role, State};

/// One process of the run.
#[derive(Debug)]
enum Member {
    /// Started by the launcher.
    Child { child: Child, status: Option<ExitStatus>, said: Option<JoinHandle<String>> },
    /// Started by somebody else; known from its board once it is there.
    ByHand { life: Option<Life>, ended: bool, finished: bool },
}

/// How a process failed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Failure {
    /// The exit code that the run takes over.
    pub code: u8,
    /// One sentence.
    pub message: String,
    /// The process, and all that it wrote to its standard error.
    pub said: (Role, String),
}

/// All processes, by [`Role`].
#[derive(Debug)]
pub(super) struct Crew {
    members: Vec<(Role, Member)>,
    /// The first that failed.
    failure: Option<Failure>,
}

impl Crew {
    /// Starts all processes but those in `by_hand`.
    pub fn start(plan: &Plan, folder: &Path, by_hand: &[Role]) -> Result<Self, LaunchError> {
        let mut crew = Self { members: Vec::new(), failure: None };
        // All programs are found before any is started.
        let mut commands = Vec::new();
        for role in Role::ALL {
            let (name, arguments): (&str, &[String]) = match role {
                Role::Plant => (&plan.scenario.plant.program, &plan.scenario.plant.args),
                Role::Controller => ("tectum-controller", &[]),
                Role::Logger => ("tectum-logger", &[]),
            };
            if by_hand.contains(&role) {
                commands.push((role, None));
                continue;
            }
            let program = find(name).ok_or_else(|| LaunchError::Start {
                role: role.name(),
                program: name.to_owned(),
                cause: "no such program beside `tectum` or in PATH; build all of them with `cargo build --release`, \
                        or name the plant's program by its path"
                    .to_owned(),
            })?;
            let mut command = Command::new(program);
            command.args(arguments).arg("--run").arg(folder);
            commands.push((role, Some(command)));
        }
        for (role, command) in commands {
            let member = match command {
                Some(command) => start(role, command)?,
                None => Member::ByHand { life: None, ended: false, finished: false },
            };
            crew.members.push((role, member));
        }
        Ok(crew)
    }

    /// Notices who has ended.
    pub fn reap(&mut self, hub: &Hub) {
        for (role, member) in &mut self.members {
            let board = hub.status(*role);
            let failure = match member {
                Member::Child { status: Some(_), .. } | Member::ByHand { ended: true, .. } => continue,
                Member::Child { child, status, said } => {
                    *status = child.try_wait().ok().flatten();
                    status.and_then(|status| failure_of(*role, status, said.take(), board.ticks))
                }
                Member::ByHand { life, ended, finished } => {
                    *finished = board.state() == State::Finished;
                    if life.is_none() && board.pid != 0 {
                        *life = Life::of(board.pid);
                        *ended = life.is_none();
                    }
                    *ended |= life.as_ref().is_some_and(Life::ended);
                    (*ended && !*finished).then(|| Failure {
                        code: exit::PROCESS,
                        message: format!("the {} ended before the run was over, at tick {}", role.name(), board.ticks),
                        said: (*role, String::new()),
                    })
                }
            };
            if self.failure.is_none() {
                self.failure = failure;
            }
        }
    }

    /// Whether a process has failed.
    pub fn failed(&self) -> bool {
        self.failure.is_some()
    }

    /// How the first process that failed did so.
    pub fn failure(&self) -> Option<Failure> {
        self.failure.clone()
    }

    /// Whether all processes have ended. One that is started by hand and never came counts as ended.
    pub fn gone(&self) -> bool {
        self.members.iter().all(|(_, member)| match member {
            Member::Child { status, .. } => status.is_some(),
            Member::ByHand { life, ended, .. } => *ended || life.is_none(),
        })
    }

    /// Kills whoever is left, and waits for those that are ours.
    pub fn kill(&mut self) {
        for (_, member) in &mut self.members {
            match member {
                Member::Child { child, status, .. } if status.is_none() => {
                    let _ = child.kill();
                    *status = child.wait().ok();
                }
                Member::ByHand { life: Some(life), ended: false, .. } => life.kill(),
                _ => {}
            }
        }
    }
}

impl Drop for Crew {
    fn drop(&mut self) {
        self.kill();
    }
}

fn start(role: Role, mut command: Command) -> Result<Member, LaunchError> {
    let program = command.get_program().to_string_lossy().into_owned();
    // A process group of its own: a Ctrl-C at the terminal reaches the launcher alone, which ends the run in order.
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).process_group(0);
    let mut child =
        command.spawn().map_err(|cause| LaunchError::Start { role: role.name(), program, cause: cause.to_string() })?;
    let said = child.stderr.take().map(|pipe| std::thread::spawn(move || listen(pipe)));
    Ok(Member::Child { child, status: None, said })
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

fn failure_of(role: Role, status: ExitStatus, said: Option<JoinHandle<String>>, tick: u64) -> Option<Failure> {
    if status.success() {
        return None;
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
    // Codes that say what the user can do are taken over; all others say that a process failed.
    let code = match status.code() {
        Some(code) if code == i32::from(exit::INPUT) => exit::INPUT,
        Some(code) if code == i32::from(exit::MISMATCH) => exit::MISMATCH,
        _ => exit::PROCESS,
    };
    Some(Failure { code, message, said: (role, said) })
}
