//! A program that was started as a child, and frames to it and from it.

use std::io::{BufWriter, Read};
use std::os::fd::AsFd as _;
use std::os::unix::process::{CommandExt as _, ExitStatusExt as _};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command as Process, Stdio};
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use serde::de::DeserializeOwned;

use super::frame::{MAX_FRAME, head, write_frame};
use super::{Failed, PIPE_OPTION, PipeError, kind};
use crate::clock::TerminationSignals;
use crate::runtime::exit;

/// How often a wait for an answer looks for signals.
const LOOK: Duration = Duration::from_millis(50);
/// How long a program may still take for an answer, or for its report, once a signal has come.
const PATIENCE: Duration = Duration::from_secs(1);

/// A child with which this process takes turns. Dropped, it is killed.
#[derive(Debug)]
pub(super) struct PipedProgram {
    child: Child,
    to: Option<BufWriter<ChildStdin>>,
    from: ChildStdout,
    name: String,
    /// How long it may take for an answer; `None`: for ever.
    limit: Option<Duration>,
    /// The signals that end a wait for an answer.
    pub signals: Option<TerminationSignals>,
    /// The tick that it answers next.
    pub tick: u64,
}

impl PipedProgram {
    /// Starts the program `name` at `path` with `arguments`. It is killed when it gives no answer for `hang_s` seconds;
    /// 0: never.
    pub fn start(name: &str, path: &Path, arguments: &[String], hang_s: f64) -> Result<Self, PipeError> {
        let failed = |cause: String| PipeError::Start { program: name.to_owned(), cause };
        let mut process = Process::new(path);
        // With a process group of its own, Ctrl-C at the terminal reaches only the parent, which ends the child.
        process.args(arguments).arg(PIPE_OPTION).process_group(0);
        process.stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = process.spawn().map_err(|cause| failed(cause.to_string()))?;
        let (Some(to), Some(from)) = (child.stdin.take(), child.stdout.take()) else {
            return Err(failed("it has no pipes".to_owned()));
        };
        Ok(Self {
            child,
            to: Some(BufWriter::new(to)),
            from,
            name: name.to_owned(),
            limit: (hang_s > 0.0).then(|| Duration::from_secs_f64(hang_s)),
            signals: None,
            tick: 0,
        })
    }

    /// Operating-system id of the child.
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// Ends the child's standard input.
    pub fn close(&mut self) {
        self.to = None;
    }

    /// The number of the signal that has come; 0 if there was none.
    pub fn signal(&self) -> u32 {
        self.signals.as_ref().map_or(0, TerminationSignals::received)
    }

    pub fn send(&mut self, kind: u32, bytes: &[u8]) -> Result<(), PipeError> {
        let Some(to) = &mut self.to else { return Err(self.protocol("its pipe is closed".to_owned())) };
        match write_frame(to, kind, bytes) {
            Ok(()) => Ok(()),
            // It may have said why before it ended.
            Err(_) => Err(self.receive(None).err().unwrap_or_else(|| self.ended())),
        }
    }

    pub fn receive_json<T: DeserializeOwned>(&mut self, kind: u32) -> Result<T, PipeError> {
        let bytes = self.receive(Some(kind))?;
        serde_json::from_slice(&bytes).map_err(|error| self.protocol(format!("frame {kind} is no such JSON: {error}")))
    }

    pub fn receive_sample(&mut self, kind: u32, to: &mut [u8]) -> Result<(), PipeError> {
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
        let mut first = [0; 8];
        self.read(&mut first, limit)?;
        let (kind, len) = head(first);
        let expected = kind == kind::FAILED || wanted.is_none_or(|wanted| wanted == kind);
        if !expected || len > MAX_FRAME {
            let what = format!("it wrote {first:02x?} where frame {} was due", wanted.unwrap_or(kind::FAILED));
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
            if let Err(why) = self.wait(until) {
                let _ = self.child.kill();
                return Err(why);
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

    /// Waits until something can be read, at the latest until `until`. Once a signal has come, it waits a little
    /// longer: most programs answer at once, and their report is of use.
    fn wait(&self, until: Option<Instant>) -> Result<(), PipeError> {
        let mut signalled = None;
        loop {
            let now = Instant::now();
            if self.signal() != 0 {
                let since = *signalled.get_or_insert(now);
                if now.duration_since(since) >= PATIENCE {
                    let (program, number) = (self.name.clone(), self.signal());
                    return Err(PipeError::Interrupted { program, tick: self.tick, number });
                }
            }
            let left = until.map(|until| until.saturating_duration_since(now));
            let nap = if self.signals.is_some() { Some(left.map_or(LOOK, |left| left.min(LOOK))) } else { left };
            let nap = nap.map(|nap| Timespec { tv_sec: nap.as_secs() as i64, tv_nsec: i64::from(nap.subsec_nanos()) });
            let mut fds = [PollFd::from_borrowed_fd(self.from.as_fd(), PollFlags::IN)];
            match poll(&mut fds, nap.as_ref()) {
                Ok(0) if left.is_some_and(|left| left.is_zero()) => {
                    let seconds = self.limit.unwrap_or_default().as_secs_f64();
                    return Err(PipeError::Silent { program: self.name.clone(), tick: self.tick, seconds });
                }
                Ok(0) | Err(rustix::io::Errno::INTR) => {}
                // Also an error: reading will name it.
                Ok(_) | Err(_) => return Ok(()),
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
        PipeError::Ended { program: self.name.clone(), how, tick: self.tick }
    }

    pub fn protocol(&self, what: String) -> PipeError {
        PipeError::Protocol { program: self.name.clone(), what }
    }
}

impl Drop for PipedProgram {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
