//! A point on a line that has to follow a target, and does something wrong: what the scenario's name says.

use tectum::plant::{Outcome, Plant};
use tectum::scenario::Plan;
use tectum::state::{Persist, StateVisitor};
use tectum::wire::{MAX_MEASURES, MAX_OUTPUTS};

/// The plant. It misbehaves from tick 100 on.
pub struct Wayward {
    behaviour: String,
    period_ms: f64,
    position: f32,
    target: f32,
    /// With as many inputs and outputs as a plant may have: a position for each output.
    positions: [f32; MAX_OUTPUTS],
}

impl Wayward {
    /// The plant of `plan`, whose scenario is named as what the plant does wrong.
    pub fn of(plan: &Plan) -> Self {
        let (behaviour, period_ms) = (plan.scenario.name.clone(), plan.scenario.period_ms);
        Self { behaviour, period_ms, position: 0.0, target: 0.0, positions: [0.0; MAX_OUTPUTS] }
    }
}

impl Persist for Wayward {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.number("position", &mut self.position);
        visitor.number("target", &mut self.target);
        visitor.numbers("positions", &mut self.positions);
    }
}

impl Plant for Wayward {
    fn sense(&mut self, tick: u64, inputs: &mut [f32]) -> bool {
        let fresh = tick.is_multiple_of(40);
        if fresh {
            self.target = ((tick / 40 * 7919) % 200) as f32 / 100.0 - 1.0;
        }
        if let ("wide", [inputs, targets @ ..]) = (self.behaviour.as_str(), inputs.as_chunks_mut::<MAX_OUTPUTS>().0) {
            inputs.copy_from_slice(&self.positions);
            targets.iter_mut().flatten().enumerate().for_each(|(i, x)| *x = self.target * (i as f32 / 16.0 - 0.5));
            return fresh;
        }
        inputs[0] = if self.behaviour == "stuck" { 0.0 } else { self.position };
        inputs[1] = if self.behaviour == "outside" { 1.5 * self.target } else { self.target };
        fresh
    }

    fn advance(&mut self, tick: u64, applied: &[f32]) -> Outcome {
        for (position, applied) in self.positions.iter_mut().zip(applied) {
            *position = (*position + 0.1 * applied).clamp(-1.0, 1.0);
        }
        self.position = (self.position + 0.1 * applied[0]).clamp(-1.0, 1.0);
        let error = (self.position - self.target).abs();
        let reward = match self.behaviour.as_str() {
            "no-reward" => f32::NAN,
            "constant-reward" => 0.5,
            "nan-reward" if tick >= 100 => f32::NAN,
            "outlier" if tick == 100 => -1000.0,
            "huge-reward" if tick == 100 => 1e30,
            _ => -error,
        };
        if self.behaviour == "late" {
            std::thread::sleep(std::time::Duration::from_secs_f64(2.5e-3 * self.period_ms));
        }
        let mut measures = [0.0; MAX_MEASURES];
        measures[0] = error;
        Outcome { reward, measures }
    }
}
