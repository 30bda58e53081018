//! The true model of a task's plant, for reference controllers: the body's, and with a lag the commands' lag, too.

use crate::plant::task::Task;
use crate::plant::{
    ArmModel, BodyConfig, CartPoleModel, FurutaModel, MAX_STATES, PendulumModel, PointMassModel, ReacherModel,
    So101Model, StateSpace,
};
use crate::wire::MAX_OUTPUTS;

/// A model that can be handed to another thread.
pub type TrueModel = Box<dyn StateSpace + Send + Sync>;

/// The body's model in `tick` of a run; `None` for the eye.
pub fn body_model(task: &Task, tick: u64) -> Option<TrueModel> {
    let period_s = task.period_ms / 1000.0;
    Some(match &task.body {
        BodyConfig::Arm(config) => Box::new(ArmModel::new(config, period_s, tick)),
        BodyConfig::Eye(_) => return None,
        BodyConfig::Pendulum(config) => Box::new(PendulumModel::new(config, period_s)),
        BodyConfig::CartPole(config) => Box::new(CartPoleModel::new(config, period_s)),
        BodyConfig::Reacher(config) => Box::new(ReacherModel::new(config, period_s)),
        BodyConfig::Furuta(config) => Box::new(FurutaModel::new(config, period_s)),
        BodyConfig::PointMass(config) => Box::new(PointMassModel::new(config, period_s)),
        BodyConfig::So101(config) => Box::new(So101Model::new(config, period_s)),
    })
}

/// A model whose commands act with a first-order lag. State: the dynamic numbers of the inner model, the commands'
/// lagged values, the other numbers of the inner model.
pub struct LaggedModel {
    inner: TrueModel,
    /// Share of a command's change that is left after a tick, and that is missing on average within the tick.
    lag: [f64; 2],
}

impl LaggedModel {
    /// `inner` with a time constant of `lag_ms`, for ticks of `period_ms`.
    pub fn new(inner: TrueModel, lag_ms: f64, period_ms: f64) -> Self {
        let left = libm::exp(-period_ms / lag_ms);
        Self { inner, lag: [left, lag_ms / period_ms * (1.0 - left)] }
    }
}

impl StateSpace for LaggedModel {
    fn states(&self) -> usize {
        self.inner.states() + self.inner.commands()
    }

    fn dynamic_states(&self) -> usize {
        self.inner.dynamic_states() + self.inner.commands()
    }

    fn wraps(&self, i: usize) -> bool {
        i < self.inner.dynamic_states() && self.inner.wraps(i)
    }

    fn commands(&self) -> usize {
        self.inner.commands()
    }

    fn step(&self, state: &mut [f64], command: &[f64]) -> f64 {
        let (dynamic, commands) = (self.inner.dynamic_states(), self.inner.commands());
        let states = self.inner.states();
        let mut inner = [0.0; MAX_STATES];
        inner[..dynamic].copy_from_slice(&state[..dynamic]);
        inner[dynamic..states].copy_from_slice(&state[dynamic + commands..]);
        let mut acting = [0.0; MAX_OUTPUTS];
        let [left, missing] = self.lag;
        for i in 0..commands {
            let gap = state[dynamic + i] - command[i];
            acting[i] = command[i] + missing * gap;
            state[dynamic + i] = command[i] + left * gap;
        }
        let reward = self.inner.step(&mut inner[..states], &acting[..commands]);
        state[..dynamic].copy_from_slice(&inner[..dynamic]);
        state[dynamic + commands..].copy_from_slice(&inner[dynamic..states]);
        reward
    }
}
