//! The simulated plant of a scenario: its body, and how late it is.

use super::state_space::MAX_STATES;
use super::timing::{Begin, Timing};
use super::{
    Arm, ArmConfig, CartPole, CartPoleConfig, Eye, EyeConfig, Furuta, FurutaConfig, JointState, Outcome, Pendulum,
    PendulumConfig, Plant, PointMass, PointMassConfig, Reacher, ReacherConfig, So101, So101Config, TimingConfig,
};
use crate::MAX_OUTPUTS;
use crate::flag;
use crate::state::{Persist, StateVisitor};

/// The configuration of a body.
// Read once a run, so that its size does not matter.
#[expect(clippy::large_enum_variant)]
#[derive(Debug, Clone, PartialEq)]
pub enum BodyConfig {
    /// The planar arm.
    Arm(ArmConfig),
    /// The saccading eye.
    Eye(EyeConfig),
    /// The pendulum.
    Pendulum(PendulumConfig),
    /// The cart-pole.
    CartPole(CartPoleConfig),
    /// The two-joint arm with inertia.
    Reacher(ReacherConfig),
    /// The Furuta pendulum.
    Furuta(FurutaConfig),
    /// The point mass.
    PointMass(PointMassConfig),
    /// The SO-101.
    So101(So101Config),
}

impl BodyConfig {
    /// Ticks of a trial, after which there is a new target or a new start; 0 for one without end.
    pub fn trial_ticks(&self) -> u64 {
        match self {
            Self::Arm(arm) => arm.target_every,
            Self::Eye(_) => 1,
            Self::Pendulum(pendulum) => pendulum.episode_ticks,
            Self::CartPole(cart_pole) => cart_pole.episode_ticks,
            Self::Reacher(reacher) => reacher.episode_ticks,
            Self::Furuta(furuta) => furuta.episode_ticks,
            Self::PointMass(point_mass) => point_mass.target_every,
            Self::So101(so101) => so101.target_every,
        }
    }
}

/// The bodies.
#[derive(Debug, Clone)]
enum Body {
    Arm(Box<Arm>),
    Eye(Eye),
    Pendulum(Pendulum),
    CartPole(CartPole),
    Reacher(Reacher),
    Furuta(Furuta),
    PointMass(PointMass),
    So101(Box<So101>),
}

/// A simulated plant.
#[derive(Debug, Clone)]
pub struct SimulatedPlant {
    body: Body,
    /// Number of inputs.
    inputs: usize,
    timing: Option<Box<Timing>>,
    /// Whether the latest inputs are those of a new start.
    truncated: bool,
}

impl SimulatedPlant {
    /// The plant of a validated configuration, for ticks of `period_s`, s, and the run's `seed`.
    pub fn new(config: &BodyConfig, timing: &TimingConfig, period_s: f64, seed: u64) -> Self {
        let body = match config {
            BodyConfig::Arm(config) => Body::Arm(Box::new(Arm::new(config, period_s, seed))),
            BodyConfig::Eye(config) => Body::Eye(Eye::new(config, seed)),
            BodyConfig::Pendulum(config) => Body::Pendulum(Pendulum::new(config, period_s, seed)),
            BodyConfig::CartPole(config) => Body::CartPole(CartPole::new(config, period_s, seed)),
            BodyConfig::Reacher(config) => Body::Reacher(Reacher::new(config, period_s, seed)),
            BodyConfig::Furuta(config) => Body::Furuta(Furuta::new(config, period_s, seed)),
            BodyConfig::PointMass(config) => Body::PointMass(PointMass::new(config, period_s, seed)),
            BodyConfig::So101(config) => Body::So101(Box::new(So101::new(config, period_s, seed))),
        };
        let signals = config.signals();
        let late = (!timing.is_nothing()).then(|| Box::new(Timing::new(timing, signals.seen, period_s)));
        Self { body, inputs: signals.inputs.len(), timing: late, truncated: false }
    }

    /// Whether the latest sensing ended an episode because its time was over: the inputs are those of a new start.
    pub fn truncated(&self) -> bool {
        self.truncated
    }

    /// The same of the body, whose inputs are not late.
    fn body_truncated(&self) -> bool {
        match &self.body {
            Body::Arm(_) | Body::Eye(_) => false,
            Body::Pendulum(plant) => plant.truncated(),
            Body::CartPole(plant) => plant.truncated(),
            Body::Reacher(plant) => plant.truncated(),
            Body::Furuta(plant) => plant.truncated(),
            Body::PointMass(plant) => plant.truncated(),
            Body::So101(plant) => plant.truncated(),
        }
    }

    /// Writes the state of the body, in the order of its true model, and returns the number of its numbers; 0 for the
    /// eye, which has no model.
    pub fn state(&self, to: &mut [f64; MAX_STATES]) -> usize {
        let state = match &self.body {
            Body::Eye(_) => &[],
            Body::Arm(arm) => {
                let (angles, target) = (arm.angles(), arm.target());
                let all = angles.iter().chain(&target);
                to.iter_mut().zip(all).for_each(|(to, from)| *to = f64::from(*from));
                return angles.len() + target.len();
            }
            Body::Pendulum(plant) => plant.state(),
            Body::CartPole(plant) => plant.state(),
            Body::Reacher(plant) => plant.state(),
            Body::Furuta(plant) => plant.state(),
            Body::PointMass(plant) => plant.state(),
            Body::So101(plant) => plant.state(),
        };
        to[..state.len()].copy_from_slice(state);
        state.len()
    }

    fn body(&self) -> &dyn Plant {
        match &self.body {
            Body::Arm(plant) => &**plant,
            Body::Eye(plant) => plant,
            Body::Pendulum(plant) => plant,
            Body::CartPole(plant) => plant,
            Body::Reacher(plant) => plant,
            Body::Furuta(plant) => plant,
            Body::PointMass(plant) => plant,
            Body::So101(plant) => &**plant,
        }
    }

    fn body_mut(&mut self) -> &mut dyn Plant {
        match &mut self.body {
            Body::Arm(plant) => &mut **plant,
            Body::Eye(plant) => plant,
            Body::Pendulum(plant) => plant,
            Body::CartPole(plant) => plant,
            Body::Reacher(plant) => plant,
            Body::Furuta(plant) => plant,
            Body::PointMass(plant) => plant,
            Body::So101(plant) => &mut **plant,
        }
    }
}

impl Plant for SimulatedPlant {
    fn sense(&mut self, tick: u64, inputs: &mut [f32]) -> bool {
        let fresh = match &mut self.body {
            // A direct call: the arm's tick is the one that is measured.
            Body::Arm(arm) => arm.sense(tick, inputs),
            _ => self.body_mut().sense(tick, inputs),
        };
        self.truncated = self.body_truncated();
        let Some(timing) = &mut self.timing else { return fresh };
        let begin = match (fresh, self.truncated) {
            (false, _) => Begin::Nothing,
            (true, false) => Begin::Trial,
            (true, true) => Begin::Episode,
        };
        let used = self.inputs.min(inputs.len());
        let late = timing.sense(tick, &mut inputs[..used], begin);
        self.truncated = late == Begin::Episode;
        late != Begin::Nothing
    }

    fn advance(&mut self, tick: u64, applied: &[f32]) -> Outcome {
        let Some(mut timing) = self.timing.take() else {
            return match &mut self.body {
                Body::Arm(arm) => arm.advance(tick, applied),
                _ => self.body_mut().advance(tick, applied),
            };
        };
        let mut acting = [0.0; MAX_OUTPUTS];
        timing.command(applied, &mut acting);
        let outcome = self.body_mut().advance(tick, &acting[..applied.len()]);
        let reward = timing.reward(outcome.reward);
        self.timing = Some(timing);
        Outcome { reward, ..outcome }
    }

    /// An episode that was cut off is stated with the inputs of the new start, however late these are.
    fn sensing_flags(&self) -> u32 {
        if self.truncated { flag::TRUNCATED } else { 0 }
    }

    fn joints(&self) -> Option<JointState> {
        self.body().joints()
    }
}

impl Persist for SimulatedPlant {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        match &mut self.body {
            Body::Arm(plant) => plant.visit_state(visitor),
            Body::Eye(plant) => plant.visit_state(visitor),
            Body::Pendulum(plant) => plant.visit_state(visitor),
            Body::CartPole(plant) => plant.visit_state(visitor),
            Body::Reacher(plant) => plant.visit_state(visitor),
            Body::Furuta(plant) => plant.visit_state(visitor),
            Body::PointMass(plant) => plant.visit_state(visitor),
            Body::So101(plant) => plant.visit_state(visitor),
        }
        visitor.boolean("truncated", &mut self.truncated);
        if let Some(timing) = &mut self.timing {
            visitor.nested("timing", &mut **timing);
        }
    }
}
