//! Delays and lag between a plant and its controller.
//!
//! A real arm's picture is processed for a while, its reward comes later than its joints' angles, and its motors do not
//! reach a commanded rate at once. [`Timing`] stands around a plant and makes it late in these ways. The measures,
//! which an outside observer notes, stay in time.

use serde::{Deserialize, Serialize};

use crate::state::{Persist, StateVisitor};
use crate::{MAX_INPUTS, MAX_OUTPUTS};

/// Largest delay, ticks.
pub const MAX_DELAY: usize = 20;

/// `[plant.timing]`: how late a simulated plant is. All delays are in ticks; the whole delay counts for rewards and
/// pictures in addition to their own.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TimingConfig {
    /// Delay of all inputs and of the reward.
    pub delay: usize,
    /// Delay of the reward alone. Until the first reward comes, rewards are 0.
    pub reward_delay: usize,
    /// Delay of the inputs that come from a camera: targets, and what else is seen.
    pub picture_delay: usize,
    /// Time constant of a first-order lag of all commands, ms; 0 for none.
    pub lag_ms: f64,
}

impl TimingConfig {
    /// Whether nothing is late.
    pub fn is_nothing(&self) -> bool {
        *self == Self::default()
    }
}

/// A signal that comes a fixed number of ticks late.
#[derive(Debug, Clone)]
struct DelayLine<const N: usize> {
    delay: usize,
    values: [[f32; N]; MAX_DELAY + 1],
    /// Where the next value goes.
    next: u64,
}

impl<const N: usize> DelayLine<N> {
    fn new(delay: usize) -> Self {
        Self { delay: delay.min(MAX_DELAY), values: [[0.0; N]; MAX_DELAY + 1], next: 0 }
    }

    /// Takes the newest value, and gives the one of `delay` ticks ago.
    fn pass(&mut self, newest: &[f32; N]) -> [f32; N] {
        self.values[self.next as usize] = *newest;
        self.next = (self.next + 1) % (self.delay + 1) as u64;
        self.values[self.next as usize]
    }

    fn visit(&mut self, name: &'static str, visitor: &mut dyn StateVisitor) {
        visitor.enter(name);
        for value in &mut self.values[..=self.delay] {
            visitor.numbers("values", value.as_mut_slice());
        }
        visitor.number("next", &mut self.next);
        visitor.leave();
        // A damaged state must not lead out of the line.
        self.next = self.next.min(self.delay as u64);
    }
}

/// What begins with some inputs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Begin {
    /// Nothing.
    Nothing,
    /// A trial.
    Trial,
    /// A trial from a new start: the episode before was cut off.
    Episode,
}

/// All inputs of a tick, then what begins with them as a number.
type Sensed = [f32; MAX_INPUTS + 1];

/// What is late around a plant.
#[derive(Debug, Clone)]
pub(super) struct Timing {
    inputs: DelayLine<{ MAX_INPUTS + 1 }>,
    pictures: DelayLine<{ MAX_INPUTS + 1 }>,
    /// So many inputs, the first ones, come from a camera.
    seen: usize,
    reward: DelayLine<1>,
    /// Share of a command's change that is left after a tick, and that is missing on average within the tick.
    lag: Option<[f64; 2]>,
    /// The commands' lagged values at the end of the last tick.
    reached: [f64; MAX_OUTPUTS],
    /// The tick and the inputs that were sensed last.
    sensed_tick: Option<u64>,
    sensed: Sensed,
}

impl Timing {
    /// For a plant of which the first `seen` inputs come from a camera, and ticks of `period_s`, s.
    pub fn new(config: &TimingConfig, seen: usize, period_s: f64) -> Self {
        let time_constant = config.lag_ms / 1000.0;
        let lag = (time_constant > 0.0).then(|| {
            let left = libm::exp(-period_s / time_constant);
            [left, time_constant / period_s * (1.0 - left)]
        });
        Self {
            inputs: DelayLine::new(config.delay),
            pictures: DelayLine::new(config.picture_delay),
            seen,
            reward: DelayLine::new(config.delay + config.reward_delay),
            lag,
            reached: [0.0; MAX_OUTPUTS],
            sensed_tick: None,
            sensed: [0.0; MAX_INPUTS + 1],
        }
    }

    /// Replaces the inputs of `tick`, with which `begin` begins, by the late ones, and returns what begins with those.
    /// Until the first late inputs come, those of the start are there.
    pub fn sense(&mut self, tick: u64, inputs: &mut [f32], begin: Begin) -> Begin {
        let used = inputs.len().min(MAX_INPUTS);
        let mut now = [0.0; MAX_INPUTS + 1];
        now[..used].copy_from_slice(&inputs[..used]);
        let Some(last) = self.sensed_tick.replace(tick) else {
            self.inputs.values.fill(now);
            self.pictures.values.fill(now);
            self.sensed = now;
            self.pass(&now);
            return begin;
        };
        // Nothing was sensed in ticks that were passed over.
        let mut between = self.sensed;
        between[MAX_INPUTS] = 0.0;
        for _ in 0..(tick - last).saturating_sub(1).min(2 * MAX_DELAY as u64) {
            self.pass(&between);
        }
        now[MAX_INPUTS] = f32::from(begin as u8);
        self.sensed = now;
        let late = self.pass(&now);
        inputs[..used].copy_from_slice(&late[..used]);
        match late[MAX_INPUTS] {
            0.0 => Begin::Nothing,
            1.0 => Begin::Trial,
            _ => Begin::Episode,
        }
    }

    /// One tick of the delays of inputs. What a camera shows begins a trial when it is seen.
    fn pass(&mut self, now: &Sensed) -> Sensed {
        let mut late = self.inputs.pass(now);
        let pictures = self.pictures.pass(&late);
        late[..self.seen].copy_from_slice(&pictures[..self.seen]);
        if self.seen > 0 {
            late[MAX_INPUTS] = pictures[MAX_INPUTS];
        }
        late
    }

    /// The commands as they act on average during a tick.
    pub fn command(&mut self, applied: &[f32], acting: &mut [f32; MAX_OUTPUTS]) {
        acting[..applied.len()].copy_from_slice(applied);
        let Some([left, missing]) = self.lag else { return };
        for ((applied, acting), reached) in applied.iter().zip(acting).zip(&mut self.reached) {
            let applied = f64::from(*applied);
            let gap = *reached - applied;
            *acting = (applied + missing * gap) as f32;
            *reached = applied + left * gap;
        }
    }

    /// The reward that arrives in place of the tick's own.
    pub fn reward(&mut self, reward: f32) -> f32 {
        let [late] = self.reward.pass(&[reward]);
        late
    }
}

impl Persist for Timing {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        self.inputs.visit("inputs", visitor);
        self.pictures.visit("pictures", visitor);
        self.reward.visit("rewards", visitor);
        visitor.numbers("reached", &mut self.reached);
        visitor.optional("sensed_tick", &mut self.sensed_tick);
        visitor.numbers("sensed", &mut self.sensed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::{BodyConfig, PendulumConfig, Plant as _, PointMassConfig, SimulatedPlant};

    fn point_mass(timing: &TimingConfig) -> SimulatedPlant {
        let config = PointMassConfig { target_every: 7, ..PointMassConfig::default() };
        SimulatedPlant::new(&BodyConfig::PointMass(config), timing, 0.05, 1)
    }

    /// Inputs, new target and reward of each tick.
    fn run(mut plant: SimulatedPlant) -> Vec<([f32; 6], bool, f32)> {
        (0..40)
            .map(|tick| {
                let mut inputs = [0.0; 6];
                let fresh = plant.sense(tick, &mut inputs);
                (inputs, fresh, plant.advance(tick, &[0.5, -0.2]).reward)
            })
            .collect()
    }

    #[test]
    fn each_signal_is_late_by_its_own_delay() {
        let timing = TimingConfig { delay: 1, reward_delay: 2, picture_delay: 3, lag_ms: 0.0 };
        let (plain, late) = (run(point_mass(&TimingConfig::default())), run(point_mass(&timing)));
        for tick in 4..40 {
            assert_eq!(late[tick].0[..2], plain[tick - 4].0[..2], "the target, tick {tick}");
            assert_eq!(late[tick].1, plain[tick - 4].1 && tick > 4, "a new target, tick {tick}");
            assert_eq!(late[tick].0[2..], plain[tick - 1].0[2..], "position and velocity, tick {tick}");
            assert_eq!(late[tick].2, plain[tick - 3].2, "the reward, tick {tick}");
        }
        assert!(late[0].1, "the first trial begins at once");
        assert_eq!(late[0].0, plain[0].0);
        assert_eq!([late[0].2, late[1].2, late[2].2], [0.0; 3]);
    }

    #[test]
    fn a_lagged_command_comes_near_in_its_time_constant() {
        let mut timing = Timing::new(&TimingConfig { lag_ms: 100.0, ..TimingConfig::default() }, 0, 0.05);
        let mut acting = [0.0; MAX_OUTPUTS];
        let mut sum = 0.0;
        for _ in 0..2 {
            timing.command(&[1.0], &mut acting);
            sum += f64::from(acting[0]);
        }
        // The integral of 1 - exp(-t / 100 ms) over 100 ms is exp(-1) of 100 ms.
        assert!((sum * 0.05 - 0.1 * (-1.0_f64).exp()).abs() < 1e-7, "{sum}");
        assert!((timing.reached[0] - (1.0 - (-1.0_f64).exp())).abs() < 1e-12);
    }

    #[test]
    fn ticks_that_were_passed_over_are_counted() {
        let timing = TimingConfig { delay: 3, ..TimingConfig::default() };
        let mut plant = point_mass(&timing);
        let mut inputs = [0.0; 6];
        for tick in 0..10 {
            plant.sense(tick, &mut inputs);
            plant.advance(tick, &[1.0, 0.0]);
        }
        let before = inputs;
        for tick in 10..14 {
            plant.advance(tick, &[1.0, 0.0]);
        }
        plant.sense(14, &mut inputs);
        assert!(inputs[2] > before[2], "what was sensed in tick 9 comes before tick 14");
    }

    #[test]
    fn the_end_of_an_episode_is_late_with_its_inputs() {
        let config = PendulumConfig { episode_ticks: 5, ..PendulumConfig::default() };
        let timing = TimingConfig { delay: 2, ..TimingConfig::default() };
        let mut plant = SimulatedPlant::new(&BodyConfig::Pendulum(config), &timing, 0.05, 1);
        let ends: Vec<u64> = (0..20)
            .filter(|&tick| {
                let fresh = plant.sense(tick, &mut [0.0; 2]);
                plant.advance(tick, &[0.0]);
                assert!(fresh || !plant.truncated());
                plant.truncated()
            })
            .collect();
        assert_eq!(ends, [7, 12, 17]);
    }
}
