//! A handle on another process, to see whether it has ended and to signal it. A pidfd avoids the race in which
//! the system gives a process id to a new process.

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fd::{BorrowedFd, OwnedFd};
use rustix::process::{Pid, PidfdFlags, kill_process_group, pidfd_open, pidfd_send_signal};

/// A handle on a process. It never refers to another process, even when the process id is used again.
#[derive(Debug)]
pub struct ProcessHandle {
    fd: OwnedFd,
    pid: Pid,
}

impl ProcessHandle {
    /// A handle on process `pid`; `None` when the process no longer exists, or when this kernel has no pidfd.
    pub fn of(pid: u32) -> Option<Self> {
        let pid = Pid::from_raw(i32::try_from(pid).ok()?)?;
        pidfd_open(pid, PidfdFlags::empty()).ok().map(|fd| Self { fd, pid })
    }

    /// Whether the process has ended; a zombie counts as ended.
    pub fn ended(&self) -> bool {
        let mut fds = [PollFd::new(&self.fd, PollFlags::IN)];
        let now = Timespec { tv_sec: 0, tv_nsec: 0 };
        matches!(poll(&mut fds, Some(&now)), Ok(1))
    }

    /// Waits until one of the processes has ended, or for `ns` nanoseconds.
    pub fn await_any<'a>(processes: impl Iterator<Item = &'a Self>, ns: u64) {
        Self::await_any_or(processes, std::iter::empty(), ns);
    }

    /// Waits until one of the processes has ended, one of the `pipes` can be read, or for `ns` nanoseconds. False if
    /// the time is over, and nothing of that has happened.
    pub fn await_any_or<'a>(
        processes: impl Iterator<Item = &'a Self>,
        pipes: impl Iterator<Item = BorrowedFd<'a>>,
        ns: u64,
    ) -> bool {
        let mut fds: Vec<_> = processes.map(|process| PollFd::new(&process.fd, PollFlags::IN)).collect();
        fds.extend(pipes.map(|pipe| PollFd::from_borrowed_fd(pipe, PollFlags::IN)));
        let limit = Timespec { tv_sec: (ns / 1_000_000_000) as i64, tv_nsec: (ns % 1_000_000_000) as i64 };
        // A signal ends the wait early, so callers check their flags and call again.
        !matches!(poll(&mut fds, Some(&limit)), Ok(0))
    }

    /// Stops the process (SIGSTOP), or continues it (SIGCONT).
    pub fn stop(&self, stop: bool) {
        let signal = if stop { rustix::process::Signal::STOP } else { rustix::process::Signal::CONT };
        let _ = pidfd_send_signal(&self.fd, signal);
    }

    /// Asks the process to end (SIGTERM).
    pub fn terminate(&self) {
        let _ = pidfd_send_signal(&self.fd, rustix::process::Signal::TERM);
    }

    /// Kills every process in the group that this process leads: itself and what it has started. For a child of this
    /// process that it has not collected yet: until then no other process can get its id.
    pub fn kill_group(&self) {
        let _ = kill_process_group(self.pid, rustix::process::Signal::KILL);
        self.kill();
    }

    /// Kills the process (SIGKILL); does nothing when it has already ended.
    pub fn kill(&self) {
        let _ = pidfd_send_signal(&self.fd, rustix::process::Signal::KILL);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_child_has_ended_only_after_it_was_killed() {
        let mut child = std::process::Command::new("sleep").arg("60").spawn().unwrap();
        let process = ProcessHandle::of(child.id()).unwrap();
        assert!(!process.ended());
        let await_end = |ns| ProcessHandle::await_any_or([&process].into_iter(), std::iter::empty(), ns);
        assert!(!await_end(1));
        process.kill();
        child.wait().unwrap();
        assert!(process.ended() && await_end(3_600_000_000_000));
        assert!(ProcessHandle::of(0).is_none());
    }
}
