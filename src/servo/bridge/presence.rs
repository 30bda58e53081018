//! What may disappear under the bridge: the port, when its cable is pulled out; time, when the machine sleeps or the
//! process is stopped; and the guard.

use std::sync::{Arc, Mutex};

use super::{Bridge, SafetyState, TripCause};

/// Called with a sentence when the bridge cannot go on. It ends the process.
pub type GiveUp = Box<dyn FnMut(&str)>;

/// Number of periods between two ticks after which the bridge has stood still. The guard acts after as many.
const STALL_PERIODS: u64 = crate::servo::guard::SILENT_PERIODS;

/// Time by which the machine must have slept to count, ns. Both clocks are read one after the other.
const MIN_SLEEP: u64 = 10_000_000;

/// What the bridge knows about port, clock and guard.
#[derive(Default)]
pub(super) struct Presence {
    /// Passes a heartbeat to the guard: whether torque may be on. Returns false when there is no guard any more.
    guard: Option<Box<dyn FnMut(bool) -> bool>>,
    /// Time for which the machine has slept since it was started, ns.
    slept: Option<Box<dyn FnMut() -> u64>>,
    last_slept: Option<u64>,
    /// Beginning of the last tick, ns.
    last_tick: Option<u64>,
    period: u64,
    /// Since when the port is gone, ns.
    gone_since: Option<u64>,
    reopen_within: u64,
    give_up: Option<GiveUp>,
    /// Whether nobody needs the port after the run.
    port_ends_with_run: bool,
    /// Whether the loop is over, and torque off.
    pub(super) ended: bool,
    /// Why torque was off at the end.
    pub(super) ending: Arc<Mutex<Option<TripCause>>>,
}

impl Presence {
    pub(super) fn new(period: u64, reopen_within: u64) -> Self {
        Self { period, reopen_within, ..Self::default() }
    }

    /// Leaves servos that cannot be told to turn torque off to the guard: it is not bidden farewell, so it acts when
    /// this process has ended, and waits for a cable that is out.
    pub(super) fn leave_to_guard(&mut self) {
        if !self.port_ends_with_run {
            std::mem::forget(self.guard.take());
        }
    }

    /// Length of a tick, ns.
    pub(super) fn period(&self) -> u64 {
        self.period
    }

    /// Ends the process with a sentence when a port was gone for longer than `limit`, ns.
    pub(super) fn give_up_after(&mut self, gone: u64, limit: u64, why: &str) {
        if gone >= limit
            && let Some(mut give_up) = self.give_up.take()
        {
            give_up(why);
        }
    }

    /// Why torque must go off at `now`, the beginning of a tick, if time has passed unseen.
    fn standstill(&mut self, now: u64) -> Option<TripCause> {
        let slept = self.slept.as_mut().map_or(0, |slept| slept());
        let asleep = self.last_slept.replace(slept).is_some_and(|last| slept.saturating_sub(last) > MIN_SLEEP);
        let last = self.last_tick.replace(now);
        let stalled = last.is_some_and(|last| now.saturating_sub(last) > STALL_PERIODS * self.period);
        match (asleep, stalled) {
            (true, _) => Some(TripCause::Suspended),
            (false, true) => Some(TripCause::Stalled),
            (false, false) => None,
        }
    }
}

impl Bridge {
    /// Sets what passes heartbeats to the guard: called with whether torque may be on, it returns whether the guard
    /// lives. Without a guard the bridge has torque only in tests.
    pub fn set_guard(&mut self, guard: Box<dyn FnMut(bool) -> bool>) {
        self.presence.guard = Some(guard);
    }

    /// Says that the port ends with the run, as that of a chain which is emulated for it does: nothing is left to the
    /// guard.
    pub fn set_port_ends_with_run(&mut self) {
        self.presence.port_ends_with_run = true;
    }

    /// Sets the clock of the machine's sleep: the time, ns, for which it was suspended since it was started.
    pub fn set_sleep_clock(&mut self, slept: Box<dyn FnMut() -> u64>) {
        self.presence.slept = Some(slept);
    }

    /// Sets what ends the process when the port is gone and stays gone. Without it the bridge goes on looking for it.
    pub fn set_give_up(&mut self, give_up: GiveUp) {
        self.presence.give_up = Some(give_up);
    }

    /// Why torque was off when the bridge was dropped, if its safety had turned it off.
    pub fn ending(&self) -> Arc<Mutex<Option<TripCause>>> {
        Arc::clone(&self.presence.ending)
    }

    /// Passes a heartbeat on. Returns false when the guard has died.
    pub(super) fn beat(&mut self, torque: bool) -> bool {
        self.presence.guard.as_mut().is_none_or(|guard| guard(torque))
    }

    /// Whether a servo may have torque: always while the port is gone, because nobody could turn it off.
    pub(super) fn may_have_torque(&self) -> bool {
        self.safety.state() == SafetyState::Driving
            || self.bus.is_gone() && self.safety.state() != SafetyState::ReadOnly
    }

    /// At the beginning of a tick: whether time has passed unseen, and whether the port is there.
    pub(super) fn check_presence(&mut self, tick: u64) {
        let now = self.bus.now();
        if let Some(cause) = self.presence.standstill(now)
            && self.safety.state() == SafetyState::Driving
        {
            self.turn_torque_off();
            self.safety.trip(cause);
        }
        if self.bus.is_gone() {
            self.look_for_port(tick, now);
        }
    }

    /// Opens the port again if it is back. Turns torque off before anything else.
    fn look_for_port(&mut self, tick: u64, now: u64) {
        let since = *self.presence.gone_since.get_or_insert(now);
        self.safety.trip(TripCause::Unplugged);
        match self.bus.reopen() {
            Ok(()) => {
                self.bus.torque_off(&self.ids);
                self.presence.gone_since = None;
                (self.notify)(&format!("tick {tick}: the port is open again; torque was turned off"));
            }
            Err(error) if now.saturating_sub(since) >= self.presence.reopen_within => {
                if let Some(mut give_up) = self.presence.give_up.take() {
                    self.write_report();
                    give_up(&format!("the port was gone for {} s: {error}", (now - since) / 1_000_000_000));
                }
            }
            Err(_) => {}
        }
    }
}
