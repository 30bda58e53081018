//! The operating-system boundary: time, signals, handles on other processes, real-time scheduling, and facts
//! about the machine.
//!
//! Only this module and `channel` ask the operating system for the time or sleep. The loops take a
//! [`TimeSource`], which is real (absolute deadlines on CLOCK_MONOTONIC) or stepped (the tick's own virtual
//! time).

mod holders;
mod limits;
mod machine;
mod process_handle;
mod realtime;
mod signals;
mod source;

pub use holders::{maps_file, processes_mapping};
pub use limits::{lock_limit, lock_remedy, priority_limit, priority_remedy};
pub use machine::{cores, last_level_cache, machine_facts};
pub use process_handle::ProcessHandle;
pub use realtime::set_fifo_priority;
pub use realtime::{RealtimeGranted, RealtimeRefusal, RealtimeReport, RealtimeRequest};
pub use signals::{TerminationSignals, let_children_hear_hangup};
pub use source::{Backoff, InterruptibleSleep, TimeSource, WakeReason};

use std::path::Path;

use rustix::thread::{NanosleepRelativeResult, clock_nanosleep_absolute, nanosleep};
use rustix::time::{ClockId, Timespec, clock_gettime};

/// CLOCK_MONOTONIC, ns.
pub fn monotonic_ns() -> u64 {
    nanoseconds(clock_gettime(ClockId::Monotonic))
}

/// CLOCK_MONOTONIC at the kernel's last timer tick, ns: it moves every few milliseconds, and takes less time to read.
pub fn coarse_ns() -> u64 {
    nanoseconds(clock_gettime(ClockId::MonotonicCoarse))
}

/// The time for which the machine was suspended since it was started, ns: CLOCK_BOOTTIME counts it, CLOCK_MONOTONIC
/// does not.
pub fn suspended_ns() -> u64 {
    nanoseconds(clock_gettime(ClockId::Boottime)).saturating_sub(monotonic_ns())
}

/// The wall clock, ns since 1970. It is read once per run, to date the log.
pub fn wall_ns() -> u64 {
    nanoseconds(clock_gettime(ClockId::Realtime))
}

/// The processor time that the calling thread has used, ns.
pub fn thread_cpu_ns() -> u64 {
    nanoseconds(clock_gettime(ClockId::ThreadCPUTime))
}

/// The processor time that a process of this user has used, all its threads together, ns; `None` when it has ended.
pub fn process_cpu_ns(pid: u32) -> Option<u64> {
    let mut sum = 0;
    for thread in std::fs::read_dir(format!("/proc/{pid}/task")).ok()?.flatten() {
        // A thread that has ended meanwhile no longer belongs to the process.
        sum += running_ns(&thread.path()).unwrap_or(0);
    }
    Some(sum)
}

/// The processor time that a thread of this process has used, ns; 0 when it has ended.
pub fn cpu_ns_of_thread(thread: i32) -> u64 {
    running_ns(Path::new(&format!("/proc/self/task/{thread}"))).unwrap_or(0)
}

/// The first field of a thread's `schedstat`: time on a core, ns. Time waiting for a core and the number of time
/// slices follow.
fn running_ns(thread: &Path) -> Option<u64> {
    let text = std::fs::read_to_string(thread.join("schedstat")).ok()?;
    text.split(' ').next()?.parse().ok()
}

/// Sleeps until the absolute instant `at` on CLOCK_MONOTONIC, ns; returns at once if it has passed. A signal
/// ends the sleep early, so callers check their flags and call again.
pub fn sleep_until(at: u64) {
    // The result tells only whether a signal interrupted the sleep. Callers find that out from the clock.
    let _ = clock_nanosleep_absolute(ClockId::Monotonic, &timespec(at));
}

/// Sleeps for `ns` nanoseconds, for pacing without a deadline. A signal ends the sleep early.
pub fn pause(ns: u64) {
    match nanosleep(&timespec(ns)) {
        NanosleepRelativeResult::Ok | NanosleepRelativeResult::Interrupted(_) => {}
        NanosleepRelativeResult::Err(error) => debug_assert!(false, "nanosleep: {error}"),
    }
}

/// Sets the calling thread's timer slack to 1 ns. With the default slack of an ordinary thread, timers fire up
/// to 50 us late.
pub fn precise_timers() {
    let _ = rustix::thread::set_current_timer_slack(std::num::NonZeroU64::new(1));
}

/// The niceness of whoever only watches.
const WATCHER_NICENESS: i32 = 10;

/// Lets all others go before the calling thread where processors are short, as whoever only watches a run should. What
/// it starts later does so, too.
pub fn go_behind_others() {
    use rustix::process::{getpriority_process, setpriority_process};
    if getpriority_process(None).is_ok_and(|niceness| niceness < WATCHER_NICENESS) {
        let _ = setpriority_process(None, WATCHER_NICENESS);
    }
}

fn nanoseconds(t: Timespec) -> u64 {
    t.tv_sec as u64 * 1_000_000_000 + t.tv_nsec as u64
}

fn timespec(ns: u64) -> Timespec {
    Timespec { tv_sec: (ns / 1_000_000_000) as i64, tv_nsec: (ns % 1_000_000_000) as i64 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustix::process::getpriority_process;

    #[test]
    fn only_the_thread_that_asks_goes_behind_others() {
        let before = getpriority_process(None).unwrap();
        let behind = std::thread::spawn(|| {
            go_behind_others();
            go_behind_others();
            getpriority_process(None).unwrap()
        });
        assert_eq!(behind.join().unwrap(), before.max(WATCHER_NICENESS));
        assert_eq!(getpriority_process(None).unwrap(), before);
    }
}
