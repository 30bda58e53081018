//! The run's own statistics of how learning goes: losses and errors by window, and the inputs around target switches.
//!
//! The controller keeps them, because it sees every observation of any plant; they are for people alone and touch nothing
//! that is learned. All memory is taken at the start.

use super::target_statistics::{TargetStatistics, TargetsAround};
use crate::plant::noise_share;
use crate::report::Window;
use crate::scenario::{ArmConfig, Plan};
use crate::state::{Persist, StateVisitor};
use crate::wire::{MAX_INPUTS, Observation, flag};

/// Windows of a run.
const WINDOWS: u64 = 200;
/// Ticks kept around a target switch: the switch and 30 movements.
const KEPT: usize = 31;

/// The inputs of one tick.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Snapshot {
    /// The tick.
    pub tick: u64,
    /// Its inputs.
    pub inputs: [f32; MAX_INPUTS],
}

/// Sums of one window.
#[derive(Debug, Clone, Copy, Default)]
struct WindowSums {
    ticks: u64,
    loss: f64,
    squares: f64,
    ends: u64,
    end_error: f64,
}

/// The inputs of a target switch and the movement that follows it.
#[derive(Debug, Clone)]
pub struct Switch {
    row: Vec<Snapshot>,
}

impl Default for Switch {
    fn default() -> Self {
        Self { row: Vec::with_capacity(KEPT) }
    }
}

impl Switch {
    /// Takes the next observation in, and gives a whole switch, 31 ticks without a gap, when it has become whole.
    pub fn see(&mut self, observation: &Observation) -> Option<&[Snapshot]> {
        let tick = observation.header.tick;
        if observation.header.flags & flag::NEW_TARGET != 0 {
            self.row.clear();
        } else if self.row.last().is_none_or(|s| s.tick + 1 != tick) || self.row.len() == KEPT {
            // Not a gapless row from a switch on.
            return None;
        }
        self.row.push(Snapshot { tick, inputs: observation.inputs });
        (self.row.len() == KEPT).then_some(&self.row)
    }
}

/// The account.
#[derive(Debug, Clone)]
pub struct RunStatistics {
    length: u64,
    /// Index of the measure called `error`.
    error: Option<usize>,
    windows: Vec<Window>,
    current: WindowSums,
    from: u64,
    /// Where the window in progress ends.
    until: u64,
    last_error: f64,
    /// What exploration costs, where that is known: the arm, and the noise's standard deviation.
    arm: Option<(ArmConfig, f64)>,
    /// Target by target, for an arm.
    targets: Option<TargetStatistics>,
    switch: Switch,
    first: Vec<Snapshot>,
    /// A switch to one of the last targets, and how far the error at that target's end was from the median of the last.
    last: Vec<Snapshot>,
    last_distance: f64,
}

impl RunStatistics {
    /// The account of a run of `plan`, in as many windows as a figure can show.
    pub fn new(plan: &Plan) -> Self {
        Self::with_windows(plan, plan.scenario.ticks.div_ceil(WINDOWS))
    }

    /// The account of a run of `plan`, in windows of `length` ticks.
    pub fn with_windows(plan: &Plan, length: u64) -> Self {
        Self {
            length,
            error: plan.measures.iter().position(|name| name == "error"),
            windows: Vec::with_capacity(plan.scenario.ticks.div_ceil(length) as usize + 1),
            current: WindowSums::default(),
            from: 0,
            until: length,
            last_error: 0.0,
            arm: plan.scenario.plant.arm.clone().map(|arm| (arm, plan.scenario.policy.sigma)),
            targets: TargetStatistics::new(plan),
            switch: Switch::default(),
            first: Vec::with_capacity(KEPT),
            last: Vec::with_capacity(KEPT),
            last_distance: f64::INFINITY,
        }
    }

    /// Takes observation k into the account: the reward and measures of tick k-1, the inputs of tick k.
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
        if let Some(switch) = self.switch.see(observation) {
            let kept = if self.first.is_empty() { &mut self.first } else { &mut self.last };
            // Until a target's end shows whether its switch is typical, any is better than none.
            if kept.is_empty() || self.targets.is_none() {
                kept.clear();
                kept.extend_from_slice(switch);
            }
        }
    }

    /// The target before the one that begins with `tick` is over. Its switch is kept if the error at its end is nearer to
    /// the median of the last targets than that of the switch that was kept, or if that one is no longer one of the last.
    fn end_target(&mut self, tick: u64) {
        let Some(targets) = &mut self.targets else { return };
        let error = if self.error.is_some() { self.last_error } else { f64::NAN };
        let Some(end_error) = targets.begin(tick, error) else { return };
        let row = &self.switch.row;
        let is_first = row.first().map(|s| s.tick) == self.first.first().map(|s| s.tick);
        if row.len() < KEPT || is_first {
            return;
        }
        let distance = (end_error - targets.median_end_error()).abs();
        let recent = self.last.first().is_some_and(|s| targets.is_recent(s.tick));
        // An error that is not a number is never nearer: then the newest switch is kept.
        let nearer = recent && self.last_distance < distance;
        if !nearer {
            self.last.clear();
            self.last.extend_from_slice(row);
            self.last_distance = distance;
        }
    }

    fn close(&mut self) {
        let sums = std::mem::take(&mut self.current);
        if sums.ticks == 0 || self.windows.len() == self.windows.capacity() {
            return;
        }
        let n = sums.ticks as f64;
        self.windows.push(Window {
            from: self.from,
            ticks: sums.ticks,
            loss: sums.loss / n,
            noise_share: self.arm.as_ref().map_or(0.0, |(arm, sigma)| noise_share(arm, *sigma, self.from)),
            mean_squared_error: self.error.map(|_| sums.squares / n),
            end_error: (sums.ends > 0).then(|| sums.end_error / sums.ends as f64),
            ends: sums.ends,
        });
    }

    /// Mean loss a tick and mean error at the end of a target, in the window in progress or, when that is young, the one
    /// before: NaN where there is none.
    pub fn now(&self) -> (f32, f32) {
        let young = self.current.ticks < self.length / 2;
        match self.windows.last() {
            Some(w) if young => (w.loss as f32, w.end_error.unwrap_or(f64::NAN) as f32),
            _ => {
                let sums = &self.current;
                ((sums.loss / sums.ticks as f64) as f32, (sums.end_error / sums.ends as f64) as f32)
            }
        }
    }

    /// Ends the account after `done` ticks.
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

/// What [`RunStatistics`] gives at the end of a run.
#[derive(Debug, Clone)]
pub struct FinishedStatistics {
    /// Losses and errors, window by window.
    pub windows: Vec<Window>,
    /// Inputs around the first whole target switch.
    pub first_switch: Vec<Snapshot>,
    /// Inputs around a late target switch: with an arm, the one whose end error was nearest to the median of the last
    /// targets when it was over; otherwise the last whole one.
    pub last_switch: Vec<Snapshot>,
    /// Single targets around the ticks that the summary looks at; empty without an arm.
    pub targets: Vec<TargetsAround>,
}

/// More records than any run keeps.
const MOST: usize = 1 << 20;

fn remember_windows(visitor: &mut dyn StateVisitor, windows: &mut Vec<Window>) {
    let mut count = windows.len() as u64;
    visitor.count("windows", &mut count);
    windows.resize_with((count as usize).min(MOST), Window::default);
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

/// The row `name` of ticks, and the row `inputs` beside it.
fn remember_row(visitor: &mut dyn StateVisitor, [name, inputs]: [&'static str; 2], row: &mut Vec<Snapshot>) {
    let mut count = row.len() as u64;
    visitor.count(name, &mut count);
    row.resize((count as usize).min(KEPT), Snapshot { tick: 0, inputs: [0.0; MAX_INPUTS] });
    for snapshot in row {
        visitor.number(name, &mut snapshot.tick);
        visitor.numbers(inputs, &mut snapshot.inputs);
    }
}

impl Persist for RunStatistics {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        remember_windows(visitor, &mut self.windows);
        let sums = &mut self.current;
        let mut counts = [sums.ticks, sums.ends, self.from];
        visitor.numbers("current_counts", &mut counts);
        [sums.ticks, sums.ends, self.from] = counts;
        self.until = (self.from / self.length).saturating_add(1).saturating_mul(self.length);
        let mut means = [sums.loss, sums.squares, sums.end_error, self.last_error];
        visitor.numbers("current", &mut means);
        [sums.loss, sums.squares, sums.end_error, self.last_error] = means;
        remember_row(visitor, ["switch", "switch_inputs"], &mut self.switch.row);
        remember_row(visitor, ["first", "first_inputs"], &mut self.first);
        remember_row(visitor, ["last", "last_inputs"], &mut self.last);
        visitor.number("last_distance", &mut self.last_distance);
        if let Some(targets) = &mut self.targets {
            visitor.nested("targets", targets);
        }
    }
}
