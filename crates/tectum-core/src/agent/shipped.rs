//! The agent of the learner that a scenario names: one of this package's.

use tectum_encoder::Encoder;
use tectum_encoder::simd::SimdPath;

use super::{Agent, AgentRecord, Answer, Experience, LinearAgent, ModelPredictiveAgent, Percept};
use crate::learner::LearnerSpec;
use crate::plant::MAX_JOINTS;
use crate::policy::{LinearPolicy, Noise};
use crate::state::{Persist, StateVisitor};

/// One of this package's agents.
// The linear agent is not boxed: its tick takes a microsecond, and another indirection would show.
#[allow(clippy::large_enum_variant)]
#[derive(Debug, Clone)]
pub enum ShippedAgent {
    /// A learning rule with a linear policy.
    Linear(LinearAgent),
    /// The model-predictive learner.
    ModelPredictive(Box<ModelPredictiveAgent>),
}

impl ShippedAgent {
    /// The agent that `spec` configures. One with a linear policy has the features of `encoder`, and noise of the
    /// distribution `noise`.
    pub fn of(spec: &LearnerSpec, encoder: impl FnOnce() -> Encoder, noise: Noise) -> Self {
        if spec.learner.rule.is_linear() {
            Self::Linear(LinearAgent::new(spec, encoder(), noise))
        } else {
            Self::ModelPredictive(Box::new(ModelPredictiveAgent::of(spec)))
        }
    }

    /// The same agent with its inner loops on `path` instead of the machine's best path. The numbers are the same, bit
    /// for bit.
    pub fn on(self, path: SimdPath) -> Self {
        match self {
            Self::Linear(agent) => Self::Linear(agent.on(path)),
            Self::ModelPredictive(agent) => Self::ModelPredictive(agent),
        }
    }

    #[inline]
    fn agent(&self) -> &dyn Agent {
        match self {
            Self::Linear(agent) => agent,
            Self::ModelPredictive(agent) => &**agent,
        }
    }
}

// None of these is `#[inline]`: a crate that makes a `dyn Agent` of it would compile its own copies, with its own
// optimisation.
impl Agent for ShippedAgent {
    fn act(&mut self, percept: &Percept, answer: &mut Answer) {
        match self {
            Self::Linear(agent) => agent.act(percept, answer),
            Self::ModelPredictive(agent) => agent.act(percept, answer),
        }
    }

    fn look_ahead(&mut self, commands: &mut [[f32; MAX_JOINTS]]) -> usize {
        match self {
            Self::Linear(agent) => agent.look_ahead(commands),
            Self::ModelPredictive(agent) => agent.look_ahead(commands),
        }
    }

    fn learn(&mut self, experience: &Experience) -> bool {
        match self {
            Self::Linear(agent) => agent.learn(experience),
            Self::ModelPredictive(agent) => agent.learn(experience),
        }
    }

    fn improve(&mut self, updates: u32) {
        match self {
            Self::Linear(agent) => agent.improve(updates),
            Self::ModelPredictive(agent) => agent.improve(updates),
        }
    }

    fn freeze(&mut self) -> bool {
        match self {
            Self::Linear(agent) => agent.freeze(),
            Self::ModelPredictive(agent) => agent.freeze(),
        }
    }

    fn columns(&self) -> &'static [&'static str] {
        self.agent().columns()
    }

    fn record(&self, record: &mut AgentRecord) {
        match self {
            Self::Linear(agent) => agent.record(record),
            Self::ModelPredictive(agent) => agent.record(record),
        }
    }

    fn halted(&self) -> bool {
        match self {
            Self::Linear(agent) => agent.halted(),
            Self::ModelPredictive(agent) => agent.halted(),
        }
    }

    fn outliers(&self) -> u64 {
        self.agent().outliers()
    }

    fn counts(&self) -> Vec<(&'static str, u64)> {
        self.agent().counts()
    }

    fn save_every(&self) -> u64 {
        self.agent().save_every()
    }

    fn policy(&self) -> Option<&LinearPolicy> {
        self.agent().policy()
    }
}

impl Persist for ShippedAgent {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        match self {
            Self::Linear(agent) => agent.visit_state(visitor),
            Self::ModelPredictive(agent) => agent.visit_state(visitor),
        }
    }
}
