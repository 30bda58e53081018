//! The learner: acts from a plan that was made a tick ahead, and then learns and plans.

mod alarms;
mod learning;
mod look_ahead;
mod models;
mod persist;
mod planning;
mod rival_pace;
mod saturation;

use super::alignment::Alignment;
use super::belief::Belief;
use super::command_limits::CommandLimits;
use super::config::{ModelPredictiveConfig, ModelPredictiveSpec};
use super::dynamics::Dynamics;
use super::ends::LearnedEnds;
use super::exploration::NoiseSource;
use super::layout::Places;
use super::layouts::AngleReading;
use super::linalg::dot;
use super::memory::Memory;
use super::model::Model;
use super::operations::OperationBudget;
use super::planner::{CommandPlan, Planner};
use super::world::{CHANGE, Ranges, WorldScratch, wrap};
use crate::MAX_OUTPUTS;
use crate::seed::{Rng, stream};
use alarms::Alarms;
use rival_pace::RivalPace;
use saturation::SaturationWatch;

/// What happened in the tick before.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct TickFlags {
    /// Ticks were passed over, so that inputs and commands do not belong together.
    pub missed: bool,
    /// The command was limited.
    pub limited: bool,
    /// A new target or trial begins with this observation.
    pub new_target: bool,
    /// The episode ended, and this observation is the first of another.
    pub terminated: bool,
    /// The episode was cut off, and this observation is the first of another.
    pub truncated: bool,
}

/// An observation.
#[derive(Debug, Clone, Copy)]
pub struct Observed<'a> {
    /// The inputs, in their units.
    pub inputs: &'a [f64],
    /// The reward of the tick before.
    pub reward: f64,
    /// The command that was applied in the tick before.
    pub applied: &'a [f64],
    /// What happened.
    pub flags: TickFlags,
}

/// What the guards did, and how well the models predict.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct GuardCounts {
    /// Inputs that were not believed.
    pub input_outliers: u64,
    /// Rewards that were not believed.
    pub reward_outliers: u64,
    /// Alarms: the world seemed to have changed.
    pub alarms: u64,
    /// Times that ticks from before an alarm were forgotten.
    pub worlds: u64,
    /// Rival plans that were adopted.
    pub rivals: u64,
    /// Ticks in which the command was at its limit.
    pub clipped: u64,
    /// Observations that were not finite.
    pub unusable: u64,
    /// Ends of inputs that were learned, and stand.
    pub ends: u64,
    /// Ticks that were planned after.
    pub plans: u64,
    /// Times that commands were turned around, because they had been at their limit for long and led nowhere.
    pub saturations: u64,
}

/// The model-predictive learner.
#[derive(Debug, Clone)]
pub struct ModelPredictive {
    config: ModelPredictiveConfig,
    places: Places,
    middle: Vec<f64>,
    half: Vec<f64>,
    limits: Vec<f64>,
    sigma: Vec<f64>,
    ranges: Ranges,
    ends: LearnedEnds,
    dynamics: Dynamics,
    rewards: [Model; 2],
    scores: [f64; 2],
    pub(super) memory: Memory,
    beliefs: Vec<Belief>,
    reward_belief: Belief,
    plan: CommandPlan,
    rival: CommandPlan,
    planner: Planner,
    scratch: WorldScratch,
    noise: NoiseSource,
    rng: Rng,
    /// Number of observations.
    tick: u64,
    /// The state of the observation, and of the one before with its command.
    state: Vec<f64>,
    before: Vec<f64>,
    /// Whether the transition from `before` to `state` may be learned.
    teaches: bool,
    /// Whether a new target or trial began with the observation.
    boundary: bool,
    reward: f64,
    last_reward: f64,
    /// The tick in which the run or the episode began.
    began: u64,
    /// So many rewards of the memory, ever, were judged, and so many learned.
    judged: u64,
    learned_rewards: u64,
    /// The part of the ticks that begin with a new target, of late.
    boundary_rate: f64,
    /// Strange rewards in a row that were left out.
    strange: u32,
    /// Rewards come so many ticks late.
    shift: u64,
    /// How angles are read in the reward models.
    reading: AngleReading,
    alignment: Alignment,
    best: f64,
    worst: f64,
    command: [f64; MAX_OUTPUTS],
    /// The last command without noise, in its unit.
    mean: [f64; MAX_OUTPUTS],
    next_refit: u64,
    refits: u64,
    alarms: Alarms,
    planned: bool,
    /// Counts of guards.
    pub counts: GuardCounts,
    after: Vec<f64>,
    start: Vec<f64>,
    apart: Vec<f64>,
    rival_kind: u32,
    rival_pace: RivalPace,
    saturation: SaturationWatch,
    /// The operations of a tick.
    budget: OperationBudget,
    /// Whether it only answers and plans, as well as it can, and learns nothing.
    frozen: bool,
}

impl ModelPredictive {
    /// A learner that knows nothing.
    pub fn new(spec: &ModelPredictiveSpec) -> Self {
        let places = spec.places();
        let mut rng = stream(spec.seed, "models");
        let (dynamics, rewards) = models::models(spec, places, &mut rng);
        let horizon = if spec.config.horizon > 0 { spec.config.horizon } else { (480 / places.len()).clamp(20, 40) };
        Self {
            middle: spec.inputs.iter().map(|r| 0.5 * (r.min + r.max)).collect(),
            half: spec.inputs.iter().map(|r| 0.5 * (r.max - r.min)).collect(),
            sigma: spec.sigma.iter().zip(&spec.limits).map(|(s, l)| s / l).collect(),
            limits: spec.limits.clone(),
            ranges: Ranges::of(&spec.inputs),
            ends: LearnedEnds::new(places.inputs),
            memory: Memory::new(places, spec.config.memory),
            beliefs: vec![Belief::default(); places.inputs],
            reward_belief: Belief::default(),
            plan: CommandPlan::new(places, horizon),
            rival: CommandPlan::new(places, horizon),
            planner: Planner::new(places, horizon, CommandLimits::of(spec, places)),
            scratch: WorldScratch::new(places, &rewards),
            noise: NoiseSource::new(spec.seed),
            tick: 0,
            state: vec![0.0; places.state()],
            before: vec![0.0; places.len()],
            teaches: false,
            boundary: false,
            reward: 0.0,
            last_reward: 0.0,
            began: 0,
            judged: 0,
            learned_rewards: 0,
            boundary_rate: 0.0,
            strange: 0,
            shift: 0,
            reading: AngleReading::APART,
            alignment: Alignment::new(rewards[0].layout.clone(), &spec.inputs, spec.config.memory),
            best: f64::NEG_INFINITY,
            worst: f64::INFINITY,
            command: [0.0; MAX_OUTPUTS],
            mean: [0.0; MAX_OUTPUTS],
            next_refit: 30,
            refits: 0,
            alarms: Alarms::default(),
            planned: false,
            counts: GuardCounts::default(),
            after: vec![0.0; places.len()],
            start: vec![0.0; places.state()],
            apart: vec![0.0; places.state()],
            rival_kind: 0,
            rival_pace: RivalPace::new(),
            saturation: SaturationWatch::new(),
            budget: OperationBudget::new(spec.config.operations),
            frozen: false,
            scores: [0.0; 2],
            dynamics,
            rewards,
            rng,
            places,
            config: spec.config.clone(),
        }
    }

    /// A copy that answers and plans as the learner would now, without exploration noise and by the mean of what it
    /// knows, and learns nothing any more.
    pub fn frozen(&self) -> Self {
        let mut copy = self.clone();
        copy.freeze();
        copy
    }

    /// From now on it explores and learns nothing, and goes on planning.
    pub fn freeze(&mut self) {
        self.frozen = true;
    }

    /// Answers an observation with a command, in its unit: `u* + K (x - x*)` and noise, within the limits. For the
    /// first observation of an episode it makes another plan first, with a quarter of the tick's operations: the one
    /// at hand begins elsewhere.
    pub fn act(&mut self, observed: &Observed, command: &mut [f64]) {
        self.take_in(observed);
        self.budget.spent = 0;
        if self.planned && (observed.flags.terminated || observed.flags.truncated) {
            self.make_plan_anew();
        }
        let (nx, m) = (self.places.state(), self.places.commands);
        let u = &mut self.command[..m];
        if self.planned {
            let world = Differences(&self.ranges, self.places);
            world.difference(&self.state, self.plan.state(0), &mut self.apart);
            for (j, u) in u.iter_mut().enumerate() {
                let back = dot(&self.plan.gains[j * nx..(j + 1) * nx], &self.apart);
                *u = self.planner.limits.clamp(&self.state, j, self.plan.commands[j] + back);
                self.mean[j] = *u * self.limits[j];
            }
            if !self.frozen {
                let moving = (&self.ranges.wraps[..], self.dynamics.moving);
                self.counts.saturations +=
                    u64::from(self.saturation.watch(&self.state[..self.places.inputs], moving, u));
                self.noise.add(&self.sigma, u);
            }
        } else if self.frozen {
            u.fill(0.0);
        } else {
            self.noise.wander(&self.sigma, self.config.first_noise, 6, u);
        }
        let mut clipped = false;
        for (j, u) in u.iter_mut().enumerate() {
            clipped |= u.abs() >= 1.0;
            *u = self.planner.limits.clamp(&self.state, j, *u);
            command[j] = *u * self.limits[j];
        }
        self.counts.clipped += u64::from(clipped);
        self.tick += 1;
    }

    /// Scales the observation, and makes the state that follows from it.
    fn take_in(&mut self, observed: &Observed) {
        let (n, m, nx) = (self.places.inputs, self.places.commands, self.places.state());
        let usable = observed.inputs.iter().chain(observed.applied).all(|x| x.is_finite());
        self.counts.unusable += u64::from(!usable);
        // The state before, with the command that was applied.
        self.before[..nx].copy_from_slice(&self.state);
        for j in 0..m {
            let u = if usable { observed.applied[j] / self.limits[j] } else { self.command[j] };
            self.before[nx + j] = u.clamp(-1.0, 1.0);
        }
        let flags = observed.flags;
        let fresh = self.tick == 0 || flags.terminated || flags.truncated;
        for i in 0..n {
            // An input that is not known is taken to be where the plan expected it.
            let z = if usable { (observed.inputs[i] - self.middle[i]) / self.half[i] } else { self.plan.state(0)[i] };
            let z = if self.ranges.wraps[i] { wrap(z) } else { z.clamp(-2.0, 2.0) };
            let mut apart = z - self.state[i];
            if self.ranges.wraps[i] {
                apart = wrap(apart);
            }
            self.state[i] = z;
            self.state[n + i] = if fresh || flags.missed { 0.0 } else { apart / CHANGE };
        }
        for j in 0..m {
            self.state[2 * n + m + j] = self.before[2 * n + j];
            self.state[2 * n + j] = self.before[nx + j];
        }
        self.teaches = usable && !fresh && !flags.missed;
        self.boundary = flags.new_target;
        if fresh {
            self.began = self.tick;
        }
        self.reward = observed.reward;
    }

    /// Learns from the last tick and plans the next command: a fixed amount of work, after the command has gone out.
    pub fn improve(&mut self) {
        if self.frozen {
            self.watch();
        } else {
            if self.teaches {
                self.learn();
            }
            self.refit();
        }
        if (self.planned || self.dynamics.fitted()) && self.rewards.iter().all(|r| r.refit.completed > 0) {
            self.make_plan();
        }
    }

    /// The last command, in its unit.
    pub fn command(&self) -> impl Iterator<Item = f64> {
        self.command[..self.places.commands].iter().zip(&self.limits).map(|(command, limit)| command * limit)
    }

    /// How many ticks late rewards come, as far as they show.
    pub fn reward_lateness(&self) -> u64 {
        self.shift
    }

    /// The inputs (bits) that the reward models read as angles measured from the body before.
    pub fn chained(&self) -> u32 {
        self.reading.bits()
    }

    /// The inputs (bits) that are predicted as functions of others.
    pub fn following(&self) -> u32 {
        self.dynamics.dependents.following
    }

    /// The last command without exploration noise, in its unit; 0 before the first plan.
    pub fn mean(&self) -> &[f64] {
        &self.mean[..self.places.commands]
    }

    /// Largest noise of the models of movement, as a part of their prior's scale.
    fn dynamics_noise(&self) -> f64 {
        self.dynamics.models_in_use().map(|model| model.fit.regression.lambda).fold(0.0, f64::max)
    }

    /// Numbers for a record: the plan's predicted sum of rewards (in standard deviations of the reward), the noise of
    /// the models of dynamics and reward as parts of their prior's scale, counts of outliers, alarms, adopted rivals
    /// and clipped commands, and the operations of the tick, in millions.
    pub fn columns(&self) -> [f64; 8] {
        let (counts, reward) = (&self.counts, &self.rewards[self.better()]);
        [
            self.plan.value,
            self.dynamics_noise(),
            reward.fit.regression.lambda,
            (counts.input_outliers + counts.reward_outliers) as f64,
            counts.alarms as f64,
            counts.rivals as f64,
            counts.clipped as f64,
            self.budget.spent as f64 / 1e6,
        ]
    }

    /// Number of refits that were begun.
    pub fn refits(&self) -> u64 {
        self.refits
    }
}

/// Differences of states.
struct Differences<'a>(&'a Ranges, Places);

impl Differences<'_> {
    fn difference(&self, a: &[f64], b: &[f64], out: &mut [f64]) {
        for (i, ((a, b), out)) in a.iter().zip(b).zip(out).enumerate() {
            *out = a - b;
            if i < self.1.inputs && self.0.wraps[i] {
                *out = wrap(*out);
            }
        }
    }
}
