//! Commands for the ticks to come, from the plan: what a plant may do when the next commands do not reach it.

use super::super::linalg::dot;
use super::super::model::MAX_MODEL_OUTPUTS;
use super::super::world::advance;
use super::{Differences, ModelPredictive};
use crate::plant::MAX_JOINTS;

impl ModelPredictive {
    /// Commands for the ticks after the one that was just answered, in their units and without noise:
    /// `u*_t + K_t (x_t - x*_t)`, with the states `x_t` that the models of movement predict from the command that goes
    /// out. Before the first plan it is that command itself, so that exploration reaches a plant for which all commands
    /// are late. Returns the number of ticks. Only scratch memory changes.
    pub fn look_ahead(&mut self, commands: &mut [[f32; MAX_JOINTS]]) -> usize {
        let (n, nx, m) = (self.places.inputs, self.places.state(), self.places.commands);
        if !self.planned {
            for command in &mut *commands {
                for (to, u) in command.iter_mut().zip(self.command()) {
                    *to = u as f32;
                }
            }
            return commands.len();
        }
        let ticks = commands.len().min(self.plan.horizon - 1);
        self.after[..nx].copy_from_slice(&self.state);
        self.after[nx..].copy_from_slice(&self.command[..m]);
        for (step, command) in (1..).zip(&mut commands[..ticks]) {
            let mut changes = [0.0; MAX_MODEL_OUTPUTS];
            self.dynamics.value(&self.after, &mut changes[..n]);
            advance(self.places, &self.ranges, &self.after, &changes[..n], &mut self.start);
            Differences(&self.ranges, self.places).difference(&self.start, self.plan.state(step), &mut self.apart);
            self.after[..nx].copy_from_slice(&self.start);
            for j in 0..m {
                let back = dot(&self.plan.gains[(step * m + j) * nx..][..nx], &self.apart);
                let u = self.planner.limits.clamp(&self.start, j, self.plan.commands[step * m + j] + back);
                self.after[nx + j] = u;
                command[j] = (u * self.limits[j]) as f32;
            }
        }
        ticks
    }
}
