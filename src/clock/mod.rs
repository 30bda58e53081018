//! The operating-system boundary: time, signals, other processes' lives, scheduling, and what machine this is.
//!
//! Nothing outside this room and [`crate::channel`] asks the operating system for the time or sleeps. The loops take
//! a [`TimeSource`], which is real (absolute deadlines on CLOCK_MONOTONIC) or stepped (the tick's own virtual time).

mod holders;
mod limits;
mod machine;
mod process_handle;
mod realtime;
mod signals;
mod source;

pub use holders::mapping;
pub use limits::{lock_limit, lock_remedy, priority_limit, priority_remedy};
pub use machine::facts;
pub use process_handle::ProcessHandle;
pub use realtime::{RealtimeGranted, RealtimeRefusal, RealtimeReport, RealtimeRequest, fifo};
pub use signals::TerminationSignals;
pub use source::{Backoff, TimeSource, WakeReason};

use rustix::thread::{NanosleepRelativeResult, clock_nanosleep_absolute, nanosleep};
use rustix::time::{ClockId, Timespec, clock_gettime};

/// CLOCK_MONOTONIC, ns.
pub fn monotonic_ns() -> u64 {
    nanoseconds(clock_gettime(ClockId::Monotonic))
}

/// The wall clock, ns since 1970. Read once a run, to give its log a date.
pub fn wall_ns() -> u64 {
    nanoseconds(clock_gettime(ClockId::Realtime))
}

/// Sleeps until the absolute instant `at` on CLOCK_MONOTONIC, ns; returns at once if it has passed. A signal that
/// interrupts the sleep ends it early: callers look at their flags and come back.
pub fn sleep_until(at: u64) {
    // The result says only whether a signal came between, which the caller finds out from the clock.
    let _ = clock_nanosleep_absolute(ClockId::Monotonic, &timespec(at));
}

/// Sleeps for `ns` nanoseconds, for pacing that no deadline hangs on; a signal ends it early.
pub fn pause(ns: u64) {
    match nanosleep(&timespec(ns)) {
        NanosleepRelativeResult::Ok | NanosleepRelativeResult::Interrupted(_) => {}
        NanosleepRelativeResult::Err(error) => debug_assert!(false, "nanosleep: {error}"),
    }
}

/// Asks for timers that fire when they are due instead of up to 50 us later (the default slack of a normal thread).
pub fn precise_timers() {
    let _ = rustix::thread::set_current_timer_slack(std::num::NonZeroU64::new(1));
}

fn nanoseconds(t: Timespec) -> u64 {
    t.tv_sec as u64 * 1_000_000_000 + t.tv_nsec as u64
}

fn timespec(ns: u64) -> Timespec {
    Timespec { tv_sec: (ns / 1_000_000_000) as i64, tv_nsec: (ns % 1_000_000_000) as i64 }
}
