//! Whether another process is still alive, without the races of process ids.

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fd::OwnedFd;
use rustix::process::{Pid, PidfdFlags, pidfd_open, pidfd_send_signal};

/// A handle on a process that stays valid when its id is reused.
#[derive(Debug)]
pub struct ProcessHandle {
    fd: OwnedFd,
}

impl ProcessHandle {
    /// A handle on process `pid`, or `None` when there is no such process any more (or no pidfd on this kernel).
    pub fn of(pid: u32) -> Option<Self> {
        let pid = Pid::from_raw(i32::try_from(pid).ok()?)?;
        pidfd_open(pid, PidfdFlags::empty()).ok().map(|fd| Self { fd })
    }

    /// Whether the process has ended; a zombie counts as ended.
    pub fn ended(&self) -> bool {
        let mut fds = [PollFd::new(&self.fd, PollFlags::IN)];
        let now = Timespec { tv_sec: 0, tv_nsec: 0 };
        matches!(poll(&mut fds, Some(&now)), Ok(1))
    }

    /// Waits until one of the processes has ended, or for `ns` nanoseconds.
    pub fn await_any<'a>(lives: impl Iterator<Item = &'a Self>, ns: u64) {
        let mut fds: Vec<_> = lives.map(|life| PollFd::new(&life.fd, PollFlags::IN)).collect();
        let limit = Timespec { tv_sec: (ns / 1_000_000_000) as i64, tv_nsec: (ns % 1_000_000_000) as i64 };
        // A signal ends the wait early: callers look at their flags and come back.
        let _ = poll(&mut fds, Some(&limit));
    }

    /// Stops the process (SIGSTOP), or lets it go on (SIGCONT).
    pub fn stop(&self, stop: bool) {
        let signal = if stop { rustix::process::Signal::STOP } else { rustix::process::Signal::CONT };
        let _ = pidfd_send_signal(&self.fd, signal);
    }

    /// Asks the process to end (SIGTERM).
    pub fn terminate(&self) {
        let _ = pidfd_send_signal(&self.fd, rustix::process::Signal::TERM);
    }

    /// Kills the process; one that has ended already is left alone.
    pub fn kill(&self) {
        let _ = pidfd_send_signal(&self.fd, rustix::process::Signal::KILL);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_child_lives_until_it_is_killed() {
        let mut child = std::process::Command::new("sleep").arg("60").spawn().unwrap();
        let life = ProcessHandle::of(child.id()).unwrap();
        assert!(!life.ended());
        life.kill();
        child.wait().unwrap();
        assert!(life.ended());
        assert!(ProcessHandle::of(0).is_none());
    }
}
