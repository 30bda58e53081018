//! Statistics of learning over a run: losses and errors by window, and the inputs around target switches.
//!
//! The controller collects them, because it receives every observation of any plant. They are for reports only
//! and do not influence learning. All memory is allocated at the start.

use super::policy_snapshots::ticks_in;
use super::target_statistics::{TargetStatistics, TargetsAround};
use crate::scenario::Plan;
use crate::state::{Persist, StateVisitor};
use crate::stats::Window;
use crate::wire::{MAX_INPUTS, Observation, flag};

/// Number of windows of a run: as many as a figure can show.
const WINDOWS: u64 = 200;
/// Most windows of a run whose end is not known. Beyond, every two become one, twice as long.
const MOST_WINDOWS: usize = 2 * WINDOWS as usize;
/// Ticks recorded from a target switch on: the switch and 30 movements.
const SWITCH_TICKS: usize = 31;

/// The inputs of one tick.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Snapshot {
    /// The tick.
    pub tick: u64,
    /// The inputs at this tick.
    pub inputs: [f32; MAX_INPUTS],
}

/// Sums over one window.
#[derive(Debug, Clone, Copy, Default)]
struct WindowSums {
    ticks: u64,
    loss: f64,
    squares: f64,
    ends: u64,
    end_error: f64,
}

/// Records the inputs of a target switch and of the movement that follows it.
#[derive(Debug, Clone)]
pub struct Switch {
    snapshots: Vec<Snapshot>,
}

impl Default for Switch {
    fn default() -> Self {
        Self { snapshots: Vec::with_capacity(SWITCH_TICKS) }
    }
}

impl Switch {
    /// Adds the next observation. Returns the switch when it is complete: 31 ticks without a gap.
    pub fn observe(&mut self, observation: &Observation) -> Option<&[Snapshot]> {
        let tick = observation.header.tick;
        if observation.header.flags & flag::NEW_TARGET != 0 {
            self.snapshots.clear();
        } else if self.snapshots.last().is_none_or(|s| s.tick + 1 != tick) || self.snapshots.len() == SWITCH_TICKS {
            // Not the tick that follows the last one of a switch.
            return None;
        }
        self.snapshots.push(Snapshot { tick, inputs: observation.inputs });
        (self.snapshots.len() == SWITCH_TICKS).then_some(&self.snapshots)
    }
}

/// Statistics of a run.
#[derive(Debug, Clone)]
pub struct RunStatistics {
    /// Length of a window, ticks.
    length: u64,
    /// Index of the measure with the role `error`.
    error: Option<usize>,
    windows: Vec<Window>,
    current: WindowSums,
    /// First tick of the current window.
    from: u64,
    /// End of the current window.
    until: u64,
    last_error: f64,
    /// The loss that exploration alone causes, as steps of (first tick, loss); empty where it is not known.
    exploration_loss: Vec<(u64, f64)>,
    /// Results of single targets, for an arm.
    targets: Option<TargetStatistics>,
    switch: Switch,
    /// The first complete target switch.
    first: Vec<Snapshot>,
    /// A late complete target switch (with an arm, a typical one).
    last: Vec<Snapshot>,
    /// Distance of the error at the end of that target from the median of the last targets.
    last_distance: f64,
}

impl RunStatistics {
    /// The statistics of a run of `plan`, in as many windows as a figure can show.
    pub fn new(plan: &Plan) -> Self {
        if plan.scenario.is_endless() {
            // One a second at first.
            let length = ticks_in(plan, 1);
            return Self { windows: Vec::with_capacity(MOST_WINDOWS), ..Self::with_windows(plan, length) };
        }
        Self::with_windows(plan, plan.scenario.ticks.div_ceil(WINDOWS))
    }

    /// The statistics of a run of `plan`, in windows of `length` ticks.
    pub fn with_windows(plan: &Plan, length: u64) -> Self {
        Self {
            length,
            error: plan.error,
            windows: Vec::with_capacity((plan.scenario.ticks.div_ceil(length) as usize + 1).min(MAX_WINDOWS)),
            current: WindowSums::default(),
            from: 0,
            until: length,
            last_error: 0.0,
            exploration_loss: plan.exploration_loss(),
            targets: TargetStatistics::new(plan),
            switch: Switch::default(),
            first: Vec::with_capacity(SWITCH_TICKS),
            last: Vec::with_capacity(SWITCH_TICKS),
            last_distance: f64::INFINITY,
        }
    }

    /// Adds observation k: the reward and measures of tick k-1, the inputs of tick k.
    pub fn observe(&mut self, observation: &Observation) {
        let flags = observation.header.flags;
        if flags & flag::FIRST == 0 {
            let tick = observation.header.tick - 1;
            if tick >= self.until {
                self.close();
                self.from = tick;
                self.until = (tick / self.length + 1) * self.length;
            }
            let sums = &mut self.current;
            sums.ticks += 1;
            sums.loss -= f64::from(observation.reward);
            if let Some(targets) = &mut self.targets {
                targets.observe(-f64::from(observation.reward));
            }
            if let Some(index) = self.error {
                self.last_error = f64::from(observation.measures[index]);
                sums.squares += self.last_error * self.last_error;
                if flags & flag::NEW_TARGET != 0 {
                    sums.ends += 1;
                    sums.end_error += self.last_error;
                }
            }
        }
        if flags & flag::NEW_TARGET != 0 {
            self.end_target(observation.header.tick);
        }
        if let Some(switch) = self.switch.observe(observation) {
            let recorded = if self.first.is_empty() { &mut self.first } else { &mut self.last };
            // Until the end of a target shows whether its switch is typical, any switch is better than none.
            if recorded.is_empty() || self.targets.is_none() {
                recorded.clear();
                recorded.extend_from_slice(switch);
            }
        }
    }

    /// Ends the target before the one that begins with `tick`. Its switch replaces the recorded one unless the
    /// recorded one belongs to one of the last targets, and its error at the end is nearer to the median of the
    /// last targets.
    fn end_target(&mut self, tick: u64) {
        let Some(targets) = &mut self.targets else { return };
        let error = if self.error.is_some() { self.last_error } else { f64::NAN };
        let Some(end_error) = targets.begin(tick, error) else { return };
        let switch = &self.switch.snapshots;
        let is_first = switch.first().map(|s| s.tick) == self.first.first().map(|s| s.tick);
        if switch.len() < SWITCH_TICKS || is_first {
            return;
        }
        let distance = (end_error - targets.median_end_error()).abs();
        let recent = self.last.first().is_some_and(|s| targets.is_recent(s.tick));
        // An error that is not a number is never nearer: then the newest switch is recorded.
        let nearer = recent && self.last_distance < distance;
        if !nearer {
            self.last.clear();
            self.last.extend_from_slice(switch);
            self.last_distance = distance;
        }
    }

    /// Closes the current window.
    fn close(&mut self) {
        let sums = std::mem::take(&mut self.current);
        if sums.ticks == 0 {
            return;
        }
        if self.windows.len() == self.windows.capacity() {
            self.halve();
        }
        let n = sums.ticks as f64;
        self.windows.push(Window {
            from: self.from,
            ticks: sums.ticks,
            loss: sums.loss / n,
            noise_share: self.exploration_loss_at(self.from),
            mean_squared_error: self.error.map(|_| sums.squares / n),
            end_error: (sums.ends > 0).then(|| sums.end_error / sums.ends as f64),
            ends: sums.ends,
        });
    }

    /// Makes one window of every two, and the next ones twice as long. Takes no memory.
    fn halve(&mut self) {
        let pairs = self.windows.len().div_ceil(2);
        for i in 0..pairs {
            let [a, b] = [2 * i, 2 * i + 1].map(|at| self.windows.get(at).cloned());
            if let Some(a) = a {
                self.windows[i] = b.map_or(a.clone(), |b| a.and(&b));
            }
        }
        self.windows.truncate(pairs);
        self.length = self.length.saturating_mul(2);
    }

    /// The loss that exploration alone causes in `tick`; 0 where it is not known.
    fn exploration_loss_at(&self, tick: u64) -> f64 {
        self.exploration_loss.iter().rev().find(|(from, _)| *from <= tick).map_or(0.0, |&(_, loss)| loss)
    }

    /// Mean loss per tick and mean error at the end of a target, in the current window, or in the previous one
    /// while the current one is less than half full. NaN where there is no value.
    pub fn now(&self) -> (f32, f32) {
        let incomplete = self.current.ticks < self.length / 2;
        match self.windows.last() {
            Some(w) if incomplete => (w.loss as f32, w.end_error.unwrap_or(f64::NAN) as f32),
            _ => {
                let sums = &self.current;
                ((sums.loss / sums.ticks as f64) as f32, (sums.end_error / sums.ends as f64) as f32)
            }
        }
    }

    /// Ends the statistics after `done` ticks.
    pub fn finish(mut self, done: u64) -> FinishedStatistics {
        self.close();
        FinishedStatistics {
            windows: self.windows,
            first_switch: self.first,
            last_switch: self.last,
            targets: self.targets.map_or_else(Vec::new, |targets| targets.finish(done)),
        }
    }
}

/// The statistics of a whole run.
#[derive(Debug, Clone)]
pub struct FinishedStatistics {
    /// Losses and errors by window.
    pub windows: Vec<Window>,
    /// Inputs around the first complete target switch.
    pub first_switch: Vec<Snapshot>,
    /// Inputs around a late target switch. With an arm: the switch to the target whose error at its end was, when it
    /// ended, nearest to the median of the last targets. Otherwise: the last complete switch.
    pub last_switch: Vec<Snapshot>,
    /// Results of single targets around the ticks of the summary; empty without an arm.
    pub targets: Vec<TargetsAround>,
}

/// Limit on windows read from a saved state: more than any run has.
const MAX_WINDOWS: usize = 1 << 20;

/// Lists the windows to a visitor.
fn visit_windows(visitor: &mut dyn StateVisitor, windows: &mut Vec<Window>) {
    let mut count = windows.len() as u64;
    visitor.count("windows", &mut count);
    windows.resize_with((count as usize).min(MAX_WINDOWS), Window::default);
    for w in windows {
        let known = |x: Option<f64>| u64::from(x.is_some());
        let mut counts = [w.from, w.ticks, w.ends, known(w.mean_squared_error) | known(w.end_error) << 1];
        visitor.numbers("window_counts", &mut counts);
        let mut means =
            [w.loss, w.noise_share, w.mean_squared_error.unwrap_or_default(), w.end_error.unwrap_or_default()];
        visitor.numbers("windows", &mut means);
        *w = Window {
            from: counts[0],
            ticks: counts[1],
            loss: means[0],
            noise_share: means[1],
            mean_squared_error: (counts[3] & 1 != 0).then_some(means[2]),
            end_error: (counts[3] & 2 != 0).then_some(means[3]),
            ends: counts[2],
        };
    }
}

/// Lists snapshots to a visitor: their ticks as `name`, and their inputs as `inputs`.
fn visit_snapshots(visitor: &mut dyn StateVisitor, [name, inputs]: [&'static str; 2], snapshots: &mut Vec<Snapshot>) {
    let mut count = snapshots.len() as u64;
    visitor.count(name, &mut count);
    snapshots.resize((count as usize).min(SWITCH_TICKS), Snapshot { tick: 0, inputs: [0.0; MAX_INPUTS] });
    for snapshot in snapshots {
        visitor.number(name, &mut snapshot.tick);
        visitor.numbers(inputs, &mut snapshot.inputs);
    }
}

impl Persist for RunStatistics {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.number("window_length", &mut self.length);
        visit_windows(visitor, &mut self.windows);
        let sums = &mut self.current;
        let mut counts = [sums.ticks, sums.ends, self.from];
        visitor.numbers("current_counts", &mut counts);
        [sums.ticks, sums.ends, self.from] = counts;
        self.until = (self.from / self.length).saturating_add(1).saturating_mul(self.length);
        let mut means = [sums.loss, sums.squares, sums.end_error, self.last_error];
        visitor.numbers("current", &mut means);
        [sums.loss, sums.squares, sums.end_error, self.last_error] = means;
        visit_snapshots(visitor, ["switch", "switch_inputs"], &mut self.switch.snapshots);
        visit_snapshots(visitor, ["first", "first_inputs"], &mut self.first);
        visit_snapshots(visitor, ["last", "last_inputs"], &mut self.last);
        visitor.number("last_distance", &mut self.last_distance);
        if let Some(targets) = &mut self.targets {
            visitor.nested("targets", targets);
        }
    }
}
