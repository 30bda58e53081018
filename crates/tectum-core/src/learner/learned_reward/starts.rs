//! Where rollouts start: states that were observed, states in which earlier rollouts ended, and states from anywhere.

use rand::RngExt as _;

use super::LearnedReward;
use super::rollouts::State;
use crate::MAX_INPUTS;

/// Rollouts start from states since the last change of the world, but from at least this number of the latest
/// states.
const MIN_START_STATES: u64 = 20;
impl LearnedReward {
    /// Draws the states from which rollout number `rollout` of each candidate starts, with a target.
    pub(super) fn draw_start(&mut self, rollout: usize) {
        let (count, fixed) = (self.inputs.len(), self.inputs.len() - self.wraps.len());
        let (recalled, mut drawn) = (self.sample_memory(), self.sample_box());
        // Inputs that no command moves any more keep their values.
        for i in (0..self.wraps.len()).filter(|&i| !self.movement.moves(i)) {
            drawn[fixed + i] = recalled[fixed + i];
        }
        let [target_draw, start_draw] = [(); 2].map(|()| self.rng.random::<f64>());
        let target = if target_draw < self.config.imagined { &drawn } else { &recalled };
        for (candidate, starts) in [&self.champion, &self.challenger].into_iter().zip(&mut self.starts) {
            let mut state = if start_draw < self.config.anywhere {
                drawn
            } else if start_draw < self.config.anywhere + self.config.onward && candidate.age > 0 {
                candidate.end_states[rollout]
            } else {
                recalled
            };
            state[..fixed].copy_from_slice(&target[..fixed]);
            state[count..].fill(0.0);
            starts[rollout] = state;
        }
        self.recalled[rollout] = recalled;
    }

    /// Draws a remembered state, with its target.
    fn sample_memory(&mut self) -> State {
        // States from before a change of the world are used only until there are enough later ones.
        let window = self.unchanged_ticks.max(MIN_START_STATES).min(self.remembered).min(self.memory.len() as u64);
        let tick = self.remembered - 1 - self.rng.random_range(0..window);
        self.memory[(tick % self.memory.len() as u64) as usize]
    }

    /// Draws a state from the whole input box.
    pub(super) fn sample_box(&mut self) -> State {
        let mut state = [0.0; MAX_INPUTS];
        for (x, [low, high]) in state.iter_mut().zip(&self.ranges) {
            *x = low + (high - low) * self.rng.random::<f32>();
        }
        state
    }
}
