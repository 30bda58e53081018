//! The loops' source of time: the real clock, or virtual time that the arrival of the peer's sample steps.
//!
//! In real time a tick begins at its absolute deadline, and a sample that has not arrived by then is missed. In
//! stepped time a tick begins as soon as the awaited sample has arrived. The clock then reads the tick's
//! scheduled instant, so that every time stamp is a function of the tick alone.

use super::{monotonic_ns, pause, sleep_until};

/// How a wait for a tick ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WakeReason {
    /// The tick begins.
    Tick,
    /// The caller's check cancelled the wait.
    Cancelled,
}

/// The source of a loop's time. Tick k is scheduled at `t0 + k * period`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TimeSource {
    /// CLOCK_MONOTONIC.
    Real {
        /// Start of tick 0, ns.
        t0_ns: u64,
        /// Period, ns.
        period_ns: u64,
    },
    /// Virtual time. It starts at 0 and equals the scheduled instant of the tick in progress.
    Stepped {
        /// Period, ns.
        period_ns: u64,
        /// The current virtual time, ns.
        now_ns: u64,
    },
}

/// Longest uninterrupted sleep, ns: the longest time until a waiting loop notices the end of the run.
const SLICE_NS: u64 = 50_000_000;

impl TimeSource {
    /// A real source: tick 0 begins at `t0_ns` on CLOCK_MONOTONIC.
    pub fn real(t0_ns: u64, period_ns: u64) -> Self {
        Self::Real { t0_ns, period_ns }
    }

    /// A stepped source at tick 0.
    pub fn stepped(period_ns: u64) -> Self {
        Self::Stepped { period_ns, now_ns: 0 }
    }

    /// The instant for which tick `tick` is scheduled, ns.
    pub fn scheduled(&self, tick: u64) -> u64 {
        match *self {
            Self::Real { t0_ns, period_ns } => t0_ns + tick * period_ns,
            Self::Stepped { period_ns, .. } => tick * period_ns,
        }
    }

    /// The current time, ns.
    pub fn now(&self) -> u64 {
        match *self {
            Self::Real { .. } => monotonic_ns(),
            Self::Stepped { now_ns, .. } => now_ns,
        }
    }

    /// The last tick whose scheduled instant has passed; in stepped time, the tick in progress.
    pub fn due(&self) -> u64 {
        match *self {
            Self::Real { t0_ns, period_ns } => self.now().saturating_sub(t0_ns) / period_ns,
            Self::Stepped { period_ns, now_ns } => now_ns / period_ns,
        }
    }

    /// Whether ticks follow the real clock.
    pub fn is_real(&self) -> bool {
        matches!(self, Self::Real { .. })
    }

    /// Moves a stepped source to `tick`, for a loop that its peer paces. Does nothing to a real source.
    pub fn step_to(&mut self, tick: u64) {
        let scheduled = self.scheduled(tick);
        if let Self::Stepped { now_ns, .. } = self {
            *now_ns = scheduled;
        }
    }

    /// Waits until `tick` begins. In real time that is its deadline, and `arrived` is not called. In stepped
    /// time it is the moment when `arrived` returns true: the peer's sample is there. `cancel` is called during
    /// the wait, at least about every 50 ms. When it returns true, the wait is cancelled.
    pub fn await_tick(
        &mut self,
        tick: u64,
        backoff: &mut Backoff,
        mut arrived: impl FnMut() -> bool,
        mut cancel: impl FnMut() -> bool,
    ) -> WakeReason {
        let scheduled = self.scheduled(tick);
        if self.is_real() {
            loop {
                let now = self.now();
                if now >= scheduled {
                    return if cancel() { WakeReason::Cancelled } else { WakeReason::Tick };
                }
                sleep_until(scheduled.min(now + SLICE_NS));
                if scheduled > now + SLICE_NS && cancel() {
                    return WakeReason::Cancelled;
                }
            }
        }
        backoff.begin();
        while !arrived() {
            if backoff.pause() && cancel() {
                return WakeReason::Cancelled;
            }
        }
        self.step_to(tick);
        WakeReason::Tick
    }
}

/// Waits for a peer that answers in microseconds and may share this core: it yields the core on every turn, and
/// after some milliseconds sleeps between turns.
///
/// Beside other programs that compute, a yield gives the core away for a whole slice of the scheduler, some
/// milliseconds, and every tick would take that long. A thread that sleeps and is woken gets the core at once. So the
/// length of a yield is measured now and then, and after two long ones in a row the next turns are sleeps. (One alone
/// may be the logger's.)
#[derive(Debug, Default)]
pub struct Backoff {
    /// Turns of this wait.
    turns: u32,
    /// Yields of all waits.
    yields: u32,
    /// Whether the yield that was measured last took long.
    was_long: bool,
    /// Turns that still sleep because yields took long.
    short_sleeps: u32,
    /// What wakes this thread from such a sleep; without it the sleeps are short.
    sleep: Option<Box<dyn InterruptibleSleep>>,
}

/// A sleep from which the peer wakes this thread.
pub trait InterruptibleSleep: std::fmt::Debug + Send {
    /// Lets the peer know whether it has to wake this thread.
    fn set_expected(&mut self, expected: bool);
    /// Sleeps until the peer has sent something since the last call, or for a short time.
    fn sleep(&mut self);
    /// What this thread slept for has arrived.
    fn arrived(&mut self);
}

impl Backoff {
    /// Turns that only yield: some milliseconds, far longer than a healthy peer takes.
    const YIELDS: u32 = 4096;
    /// The sleep in each turn after that, ns.
    const SLEEP_NS: u64 = 50_000;
    /// Of so many yields one is measured.
    const MEASURED: u32 = 64;
    /// A yield that takes longer found other programs on its core, ns.
    const LONG_YIELD_NS: u64 = 200_000;
    /// Turns that sleep after long yields, and how long if nobody wakes this thread, ns.
    const SHORT_SLEEPS: u32 = 8192;
    const SHORT_SLEEP_NS: u64 = 5_000;

    /// A backoff whose short sleeps are `sleep`, from which the peer wakes it.
    pub fn woken_by(sleep: impl InterruptibleSleep + 'static) -> Self {
        Self { sleep: Some(Box::new(sleep)), ..Self::default() }
    }

    /// Begins another wait.
    #[inline]
    pub fn begin(&mut self) {
        if self.short_sleeps > 0
            && self.turns > 0
            && let Some(sleep) = &mut self.sleep
        {
            sleep.arrived();
        }
        self.turns = 0;
    }

    /// Waits for one turn. Returns true when the caller should check whether to cancel: on every 64th turn, and
    /// after each long sleep.
    #[inline]
    pub fn pause(&mut self) -> bool {
        if self.turns >= Self::YIELDS {
            pause(Self::SLEEP_NS);
            return true;
        }
        self.turns += 1;
        if self.short_sleeps > 0 {
            self.sleep_shortly();
        } else {
            self.yields = self.yields.wrapping_add(1);
            if self.yields.is_multiple_of(Self::MEASURED) {
                self.measured_yield();
            } else {
                rustix::thread::sched_yield();
            }
        }
        self.turns.is_multiple_of(64)
    }

    fn measured_yield(&mut self) {
        let began = monotonic_ns();
        rustix::thread::sched_yield();
        self.judge(monotonic_ns() - began > Self::LONG_YIELD_NS);
    }

    /// Takes whether the yield that was measured took long.
    fn judge(&mut self, long: bool) {
        if long && self.was_long {
            self.short_sleeps = Self::SHORT_SLEEPS;
            self.expect(true);
        } else if long {
            // The next one is measured, too.
            self.yields = Self::MEASURED - 1;
        }
        self.was_long = long;
    }

    #[cold]
    fn sleep_shortly(&mut self) {
        self.short_sleeps -= 1;
        match &mut self.sleep {
            Some(sleep) => sleep.sleep(),
            None => pause(Self::SHORT_SLEEP_NS),
        }
        if self.short_sleeps == 0 {
            // The first yield after them is measured, and still suspected.
            self.yields = Self::MEASURED - 1;
            self.expect(false);
        }
    }

    fn expect(&mut self, expected: bool) {
        if let Some(sleep) = &mut self.sleep {
            sleep.set_expected(expected);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stepped_time_is_a_function_of_the_tick() {
        let mut time = TimeSource::stepped(50_000_000);
        let mut calls = 0;
        let wake = time.await_tick(
            7,
            &mut Backoff::default(),
            || {
                calls += 1;
                calls == 3
            },
            || false,
        );
        assert_eq!((wake, calls, time.now()), (WakeReason::Tick, 3, 350_000_000));
    }

    #[test]
    fn real_ticks_begin_at_their_absolute_instant_and_can_be_cancelled() {
        let t0 = monotonic_ns();
        let mut time = TimeSource::real(t0, 2_000_000);
        assert_eq!(time.await_tick(5, &mut Backoff::default(), || unreachable!(), || false), WakeReason::Tick);
        assert!(time.now() >= t0 + 10_000_000);
        let mut far = TimeSource::real(t0 + 3_600_000_000_000, 1);
        assert_eq!(far.await_tick(0, &mut Backoff::default(), || unreachable!(), || true), WakeReason::Cancelled);
    }

    #[test]
    fn a_stepped_wait_can_be_cancelled() {
        let mut time = TimeSource::stepped(1);
        assert_eq!(time.await_tick(1, &mut Backoff::default(), || false, || true), WakeReason::Cancelled);
    }

    #[derive(Debug, Default)]
    struct CountedSleep(std::sync::Arc<std::sync::Mutex<Vec<&'static str>>>);

    impl InterruptibleSleep for CountedSleep {
        fn set_expected(&mut self, expected: bool) {
            self.0.lock().unwrap().push(if expected { "expected" } else { "no longer" });
        }

        fn sleep(&mut self) {
            self.0.lock().unwrap().push("sleeps");
        }

        fn arrived(&mut self) {
            self.0.lock().unwrap().push("arrived");
        }
    }

    /// The peer hears of it when sleeps begin and when they are over.
    #[test]
    fn sleeps_after_long_yields_are_ended_by_the_peer() {
        let sleep = CountedSleep::default();
        let said = std::sync::Arc::clone(&sleep.0);
        let mut backoff = Backoff::woken_by(sleep);
        backoff.judge(true);
        assert!(said.lock().unwrap().is_empty(), "one long yield may be the logger's");
        backoff.judge(true);
        backoff.short_sleeps = 2;
        backoff.pause();
        backoff.begin();
        backoff.pause();
        assert_eq!(*said.lock().unwrap(), ["expected", "sleeps", "arrived", "sleeps", "no longer"]);
        backoff.judge(true);
        assert_eq!(backoff.short_sleeps, Backoff::SHORT_SLEEPS, "it is still suspected");
    }
}
