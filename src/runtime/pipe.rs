//! A controller's program at the other end of a pipe: a run in one process, a replay or a study starts it as a child,
//! hands it observations on its standard input, and reads its commands and learning records from its standard output.
//!
//! There is no shared memory and no clock. Parent and child take turns, so that the numbers are those of lockstep.
//! `docs/wire.md` has the protocol, for programs in other languages. The watchdog is that of a run: a child that ends
//! is noticed at once, and one that gives no answer for `hang_s` under `[restart]` is killed. It is not started again:
//! whatever made it fail would fail in the same way.

use std::io::{BufReader, BufWriter, Read, Write};
use std::os::fd::AsFd as _;
use std::os::unix::process::{CommandExt as _, ExitStatusExt as _};
use std::path::PathBuf;
use std::process::{Child, ChildStdin, ChildStdout, Command as Process, Stdio};
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use super::{Controller, ControllerReport, RuntimeError, exit, wire_manifest};
use crate::agent::Agent;
use crate::scenario::{Plan, Scenario, ScenarioError};
use crate::wire::{Command, Learning, Observation, schema_hash};

/// The option with which a controller's program is started.
pub const PIPE_OPTION: &str = "--pipe";
/// Version of the protocol.
const VERSION: u32 = 1;
/// Longest frame, bytes.
const MAX_FRAME: u32 = 16 << 20;

/// The first number of a frame.
mod kind {
    pub const START: u32 = 1;
    pub const READY: u32 = 2;
    pub const OBSERVATION: u32 = 3;
    pub const COMMAND: u32 = 4;
    pub const LEARNING: u32 = 5;
    pub const REPORT: u32 = 6;
    pub const FAILED: u32 = 7;
}

/// The parent's first frame.
#[derive(Debug, Serialize, Deserialize)]
struct Start {
    version: u32,
    /// Hash of the layout of all samples, hexadecimal.
    schema: String,
    /// The scenario as TOML, every default filled in.
    scenario: String,
    /// Where the scenario comes from, for messages.
    source: String,
    /// The folder at which the scenario's paths begin.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    folder: Option<PathBuf>,
    /// For controllers in other languages: the scenario as JSON, names and ranges ([`wire_manifest::facts`]).
    #[serde(default)]
    run: serde_json::Value,
}

/// The child's answer to it.
#[derive(Debug, Serialize, Deserialize)]
struct Ready {
    version: u32,
    schema: String,
    /// Names of the agent's own columns in the learning record.
    #[serde(default)]
    columns: Vec<String>,
}

/// The child's last frame, if it cannot go on.
#[derive(Debug, Serialize, Deserialize)]
struct Failed {
    /// The exit code that fits.
    code: u8,
    message: String,
}

/// Why a controller at the other end of a pipe cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum PipeError {
    /// The program does not exist or cannot be started.
    #[error("the controller cannot be started: {program}: {cause}")]
    Start {
        /// The program.
        program: String,
        /// What is wrong, and the remedy.
        cause: String,
    },
    /// The program refused the scenario, or failed and said why.
    #[error("{message}")]
    Refused {
        /// The exit code to end with.
        code: u8,
        /// Its message.
        message: String,
    },
    /// The program ended.
    #[error("the controller {program} {how} at tick {tick}, before the run was over")]
    Ended {
        /// The program.
        program: String,
        /// How it ended.
        how: String,
        /// The tick that it should have answered.
        tick: u64,
    },
    /// The program gave no answer.
    #[error(
        "the controller {program} gave no answer to tick {tick} for {seconds} s and was killed; \
         `hang_s` under [restart] sets how long it may take"
    )]
    Silent {
        /// The program.
        program: String,
        /// The tick that it should have answered.
        tick: u64,
        /// How long it had, s.
        seconds: f64,
    },
    /// What the program wrote is not the protocol.
    #[error(
        "the controller {program} does not speak the protocol of a pipe: {what}; a controller writes nothing else to \
         its standard output (docs/wire.md)"
    )]
    Protocol {
        /// The program.
        program: String,
        /// What is wrong.
        what: String,
    },
}

impl PipeError {
    /// The exit code for this error.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Start { .. } => exit::INPUT,
            Self::Refused { code, .. } => *code,
            Self::Ended { .. } | Self::Silent { .. } | Self::Protocol { .. } => exit::PROCESS,
        }
    }
}

/// A controller's program, started as a child. Dropped, it is killed.
#[derive(Debug)]
pub struct PipedController {
    child: Child,
    to: Option<BufWriter<ChildStdin>>,
    from: ChildStdout,
    program: String,
    /// How long it may take for an answer; `None`: for ever.
    limit: Option<Duration>,
    columns: Vec<String>,
    /// The tick that it answers next.
    tick: u64,
}

impl PipedController {
    /// Starts the controller's program of `plan`, and hands it the scenario.
    ///
    /// # Errors
    /// When it cannot be started, or refuses the scenario.
    pub fn start(plan: &Plan) -> Result<Self, PipeError> {
        let (config, hang_s) = (&plan.scenario.controller, plan.scenario.restart.hang_s);
        let failed = |cause: String| PipeError::Start { program: config.program.clone(), cause };
        let path = plan.scenario.find_program(&config.program).map_err(failed)?;
        let mut process = Process::new(path);
        // With a process group of its own, Ctrl-C at the terminal reaches only the parent, which ends the child.
        process.args(plan.scenario.resolve_arguments(&config.args)).arg(PIPE_OPTION).process_group(0);
        process.stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = process.spawn().map_err(|cause| failed(cause.to_string()))?;
        let (to, from) = (child.stdin.take(), child.stdout.take());
        let (Some(to), Some(from)) = (to, from) else { return Err(failed("it has no pipes".to_owned())) };
        let mut controller = Self {
            child,
            to: Some(BufWriter::new(to)),
            from,
            program: config.program.clone(),
            limit: (hang_s > 0.0).then(|| Duration::from_secs_f64(hang_s)),
            columns: Vec::new(),
            tick: 0,
        };
        let start = Start {
            version: VERSION,
            schema: schema_text(),
            scenario: plan.scenario.to_toml(),
            source: plan.scenario.source.name().to_owned(),
            folder: plan.scenario.source.folder().map(Into::into),
            run: wire_manifest::facts(plan),
        };
        controller.send(kind::START, &json(&start))?;
        let ready: Ready = controller.receive_json(kind::READY)?;
        if (ready.version, &ready.schema) != (VERSION, &start.schema) {
            let what = format!(
                "it was built for version {} and samples {}, and this is version {VERSION} and {}; build it again",
                ready.version, ready.schema, start.schema
            );
            return Err(controller.protocol(what));
        }
        controller.columns = ready.columns;
        Ok(controller)
    }

    /// Names of the agent's own columns in the learning record.
    pub fn columns(&self) -> &[String] {
        &self.columns
    }

    /// One tick: hands over an observation, and receives the command and the learning record.
    ///
    /// # Errors
    /// When the program has ended, hangs, or writes something else.
    pub fn exchange(
        &mut self,
        observation: &Observation,
        command: &mut Command,
        learning: &mut Learning,
    ) -> Result<(), PipeError> {
        self.tick = observation.header.tick;
        self.send(kind::OBSERVATION, bytemuck::bytes_of(observation))?;
        self.receive_sample(kind::COMMAND, bytemuck::bytes_of_mut(command))?;
        self.receive_sample(kind::LEARNING, bytemuck::bytes_of_mut(learning))
    }

    /// Ends the run, and receives the controller's report.
    ///
    /// # Errors
    /// As for [`exchange`](Self::exchange).
    pub fn finish(mut self) -> Result<ControllerReport, PipeError> {
        // The end of its standard input tells the program that the run is over.
        self.to = None;
        self.receive_json(kind::REPORT)
    }

    fn send(&mut self, kind: u32, bytes: &[u8]) -> Result<(), PipeError> {
        let Some(to) = &mut self.to else { return Err(self.protocol("its pipe is closed".to_owned())) };
        match write_frame(to, kind, bytes) {
            Ok(()) => Ok(()),
            // It may have said why before it ended.
            Err(_) => Err(self.receive(None).err().unwrap_or_else(|| self.ended())),
        }
    }

    fn receive_json<T: DeserializeOwned>(&mut self, kind: u32) -> Result<T, PipeError> {
        let bytes = self.receive(Some(kind))?;
        serde_json::from_slice(&bytes).map_err(|error| self.protocol(format!("frame {kind} is no such JSON: {error}")))
    }

    fn receive_sample(&mut self, kind: u32, to: &mut [u8]) -> Result<(), PipeError> {
        let bytes = self.receive(Some(kind))?;
        if bytes.len() != to.len() {
            let what = format!("frame {kind} has {} bytes instead of {}", bytes.len(), to.len());
            return Err(self.protocol(what));
        }
        to.copy_from_slice(&bytes);
        Ok(())
    }

    /// The next frame, which must be of the kind `wanted`; its error, if it is [`kind::FAILED`].
    fn receive(&mut self, wanted: Option<u32>) -> Result<Vec<u8>, PipeError> {
        let limit = self.limit.map(|limit| Instant::now() + limit);
        let mut head = [0; 8];
        self.read(&mut head, limit)?;
        let [kind, len] = [&head[..4], &head[4..]].map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        let expected = kind == kind::FAILED || wanted.is_none_or(|wanted| wanted == kind);
        if !expected || len > MAX_FRAME {
            let what = format!("it wrote {head:02x?} where frame {} was due", wanted.unwrap_or(kind::FAILED));
            return Err(self.protocol(what));
        }
        let mut bytes = vec![0; len as usize];
        self.read(&mut bytes, limit)?;
        if kind != kind::FAILED {
            return Ok(bytes);
        }
        let Failed { code, message } = serde_json::from_slice(&bytes)
            .map_err(|error| self.protocol(format!("its last frame is no such JSON: {error}")))?;
        Err(PipeError::Refused { code: if code == exit::OK { exit::PROCESS } else { code }, message })
    }

    /// Fills `to`, at the latest at `until`.
    fn read(&mut self, to: &mut [u8], until: Option<Instant>) -> Result<(), PipeError> {
        let mut filled = 0;
        while filled < to.len() {
            if !self.readable(until) {
                let seconds = self.limit.unwrap_or_default().as_secs_f64();
                let _ = self.child.kill();
                return Err(PipeError::Silent { program: self.program.clone(), tick: self.tick, seconds });
            }
            match self.from.read(&mut to[filled..]) {
                Ok(0) => return Err(self.ended()),
                Ok(more) => filled += more,
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                Err(_) => return Err(self.ended()),
            }
        }
        Ok(())
    }

    /// Waits until something can be read, at the latest until `until`. False if that instant has come.
    fn readable(&self, until: Option<Instant>) -> bool {
        loop {
            let left = until.map(|until| until.saturating_duration_since(Instant::now()));
            let limit =
                left.map(|left| Timespec { tv_sec: left.as_secs() as i64, tv_nsec: i64::from(left.subsec_nanos()) });
            let mut fds = [PollFd::from_borrowed_fd(self.from.as_fd(), PollFlags::IN)];
            match poll(&mut fds, limit.as_ref()) {
                Ok(0) if left.is_some_and(|left| left.is_zero()) => return false,
                Ok(0) => {}
                Ok(_) => return true,
                // A signal: the caller looks at its own flags after the tick.
                Err(rustix::io::Errno::INTR) => {}
                Err(_) => return true,
            }
        }
    }

    /// The error for a program that has closed its pipe.
    fn ended(&mut self) -> PipeError {
        // It is about to end by itself; if it has only closed its output, nothing can be expected of it either.
        let patience = Instant::now() + Duration::from_secs(1);
        let status = loop {
            match self.child.try_wait() {
                Ok(None) if Instant::now() < patience => std::thread::sleep(Duration::from_millis(1)),
                Ok(status) => break status,
                Err(_) => break None,
            }
        };
        let how = match status.map(|status| (status.signal(), status.code())) {
            Some((Some(signal), _)) => format!("was killed by signal {signal}"),
            Some((None, Some(code))) => format!("ended with exit code {code}"),
            _ => "closed its standard output".to_owned(),
        };
        PipeError::Ended { program: self.program.clone(), how, tick: self.tick }
    }

    fn protocol(&self, what: String) -> PipeError {
        PipeError::Protocol { program: self.program.clone(), what }
    }
}

impl Drop for PipedController {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn schema_text() -> String {
    format!("{:016x}", schema_hash())
}

fn json<T: Serialize>(value: &T) -> Vec<u8> {
    serde_json::to_vec(value).unwrap_or_default()
}

fn write_frame(to: &mut impl Write, kind: u32, bytes: &[u8]) -> std::io::Result<()> {
    to.write_all(&kind.to_le_bytes())?;
    to.write_all(&(bytes.len() as u32).to_le_bytes())?;
    to.write_all(bytes)?;
    to.flush()
}

/// The next frame; `None` at the end of the pipe.
fn read_frame(from: &mut impl Read) -> std::io::Result<Option<(u32, Vec<u8>)>> {
    let mut head = [0; 8];
    match from.read_exact(&mut head) {
        Err(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => return Ok(None),
        other => other?,
    }
    let [kind, len] = [&head[..4], &head[4..]].map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    if len > MAX_FRAME {
        return Err(std::io::Error::other(format!("a frame of {len} bytes")));
    }
    let mut bytes = vec![0; len as usize];
    from.read_exact(&mut bytes)?;
    Ok(Some((kind, bytes)))
}

/// The controller's half: serves a parent on standard input and standard output, until the former ends. `build` makes
/// the agent of the scenario's plan. Returns the exit code; a failure has been told to the parent.
pub fn serve_controller<A: Agent>(build: impl FnOnce(&Plan) -> Result<A, ScenarioError>) -> u8 {
    let mut to = BufWriter::new(std::io::stdout().lock());
    match serve(&mut BufReader::new(std::io::stdin().lock()), &mut to, build) {
        Ok(()) => exit::OK,
        Err(error) => {
            let failed = Failed { code: error.exit_code(), message: error.to_string() };
            // A parent that is gone has no use for it.
            let _ = write_frame(&mut to, kind::FAILED, &json(&failed));
            failed.code
        }
    }
}

fn serve<A: Agent>(
    from: &mut impl Read,
    to: &mut impl Write,
    build: impl FnOnce(&Plan) -> Result<A, ScenarioError>,
) -> Result<(), RuntimeError> {
    let start = match read_frame(from).map_err(RuntimeError::Pipe)? {
        Some((kind::START, bytes)) => serde_json::from_slice::<Start>(&bytes),
        _ => return Err(RuntimeError::Pipe(std::io::Error::other("the first frame is not the parent's"))),
    };
    let start = start.map_err(|error| RuntimeError::Pipe(error.into()))?;
    let plan = Scenario::parse(&start.scenario, &start.source)?.plan()?;
    let plan = plan.with_origin(&start.source, start.folder.as_deref());
    let agent = build(&plan)?;
    let columns = agent.columns().iter().map(|&name| name.to_owned()).collect();
    let mut controller = Controller::with_agent(&plan, agent);
    let mut send = |kind, bytes: &[u8]| write_frame(to, kind, bytes).map_err(RuntimeError::Pipe);
    send(kind::READY, &json(&Ready { version: VERSION, schema: schema_text(), columns }))?;
    let (mut command, mut learning) = (Command::default(), Learning::default());
    while let Some((kind, bytes)) = read_frame(from).map_err(RuntimeError::Pipe)? {
        if kind != kind::OBSERVATION || bytes.len() != size_of::<Observation>() {
            return Err(RuntimeError::Pipe(std::io::Error::other(format!("frame {kind} of {} bytes", bytes.len()))));
        }
        let observation: Observation = bytemuck::pod_read_unaligned(&bytes);
        controller.respond(&observation, &mut command);
        send(kind::COMMAND, bytemuck::bytes_of(&command))?;
        controller.after_command(&observation);
        controller.record(&observation, &mut learning);
        send(kind::LEARNING, bytemuck::bytes_of(&learning))?;
    }
    send(kind::REPORT, &json(&controller.finish()))
}
