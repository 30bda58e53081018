//! What `tectum bench learner` and the criterion bench `tick` time: the paper's rule by itself in every version
//! and size, and the whole tick of a controller.

use std::hint::black_box;

use super::calls::{CallCase, GrowthKey};
use super::{SCENARIO, TimingError};
use crate::learner::PaperRule;
use crate::learner::naive::NaivePaperRule;
use crate::policy::{LinearPolicy, Outputs};
use crate::runtime::Simulation;
use crate::scenario::{LearnerConfig, Plan, Rule, Scenario};
use crate::simd::SimdPath;
use crate::wire::Observation;

/// The exploration noise of every tick.
const NOISE: Outputs = [0.003, -0.002, 0.001, -0.004, 0.002, -0.001, 0.004, -0.003];
/// Decay and rate of the paper's rule, as in the paper's scenario.
const PAPER: (f32, f32) = (0.9, 0.01);
/// The version of [`tick_cases`] that times a whole tick, after the rule's name.
pub const WHOLE_TICK: &str = "whole tick, with plant";

/// Two vectors of features as an encoder makes them: positive, of unit norm.
fn features(len: usize) -> [Vec<f32>; 2] {
    let norm = (len as f32 / 3.0).sqrt();
    [0.37, 0.73].map(|k| (0..len).map(|i| (i as f32 * k).fract() / norm).collect())
}

/// Learns from one tick and computes the mean command of the next in one pass.
fn one_pass<K>(key: K, outputs: usize, len: usize, path: SimdPath) -> CallCase<'static, K> {
    let [now, next] = features(len);
    let mut policy = LinearPolicy::new(len, (0..len).collect(), outputs).on(path);
    let mut rule = PaperRule::new(len, outputs, PAPER.0, PAPER.1);
    let mut mean = Outputs::default();
    CallCase::new(key, move || {
        rule.step_and_answer(&mut policy, black_box([&now, &next]), &NOISE, -0.1, &mut mean);
        black_box(&mean);
    })
}

/// The paper's rule for 4 outputs and 320 features: the textbook's loops, learning and mean command in two
/// passes, and both in one pass. The keys are (what is called, version).
pub fn rule_versions() -> Vec<CallCase<'static, (String, String)>> {
    let key = |version: String| ("learn and answer, 4 x 320".to_owned(), version);
    let [now, next] = features(320);
    let mut textbook = NaivePaperRule::new(320, 4, PAPER.0, PAPER.1);
    let mut cases = vec![CallCase::new(key("textbook".to_owned()), {
        let (now, next) = (now.clone(), next.clone());
        move || {
            textbook.step(black_box(&now), &NOISE, -0.1);
            black_box(textbook.mean(black_box(&next)));
        }
    })];
    for path in SimdPath::all() {
        let (now, next) = (now.clone(), next.clone());
        let mut policy = LinearPolicy::new(320, (0..320).collect(), 4).on(path);
        let mut rule = PaperRule::new(320, 4, PAPER.0, PAPER.1);
        cases.push(CallCase::new(key(format!("two passes, {path}")), move || {
            rule.step(&mut policy, black_box(&now), &NOISE, -0.1);
            black_box(policy.mean(black_box(&next)));
        }));
    }
    cases.extend(SimdPath::all().map(|path| one_pass(key(format!("final, {path}")), 4, 320, path)));
    cases
}

/// The paper's rule for 2^`power` features on every path. The cost is linear in features times outputs, as long
/// as weights and trace stay in a cache.
pub fn rule_growth(outputs: usize, power: u32) -> Vec<CallCase<'static, GrowthKey>> {
    let case = |path| {
        let what = format!("learn and answer, {outputs} outputs");
        let key = GrowthKey { what, path, features: 1 << power, outputs: outputs as u64 };
        one_pass(key, outputs, 1 << power, path)
    };
    SimdPath::all().map(case).collect()
}

/// A plant and its controller in the middle of a run, and the observations of the ticks before.
pub struct ControlLoop {
    simulation: Simulation,
    /// A power of two many.
    ring: Vec<Observation>,
    tick: u64,
}

impl ControlLoop {
    /// Number of observations in the ring that a controller is given; a power of two.
    const RING: u64 = 512;

    /// Runs `plan` for as many ticks as fill the ring.
    ///
    /// # Errors
    /// When the plant of `plan` is not simulated.
    pub fn new(plan: &Plan, path: SimdPath) -> Result<Self, TimingError> {
        let simulation = Simulation::new(plan, plan.simulated_plant().ok_or(TimingError::NotSimulated)?).on(path);
        let mut control_loop = Self { simulation, ring: Vec::with_capacity(Self::RING as usize), tick: 0 };
        for _ in 0..Self::RING {
            control_loop.step();
            control_loop.ring.push(*control_loop.simulation.observation());
        }
        Ok(control_loop)
    }

    /// The part of the controller's tick that the command waits for, on an observation of the ring.
    pub fn respond(&mut self) {
        let mut observation = self.ring[(self.tick % Self::RING) as usize];
        observation.header.tick = self.tick;
        observation.header.flags = 0;
        self.tick += 1;
        black_box(self.simulation.answer_to(black_box(&observation)));
    }

    /// The part of the controller's tick after the command: statistics and learning record.
    pub fn after_command(&mut self) {
        let observation = &self.ring[(self.tick % Self::RING) as usize];
        self.tick += 1;
        black_box(self.simulation.improve_after(black_box(observation)));
    }

    /// A whole tick, including the plant. A rule that learns a model of the plant detects when observations do
    /// not result from its commands, and then learns nothing; so the ring does not serve here.
    pub fn step(&mut self) {
        self.simulation.sense();
        black_box(self.simulation.answer());
        self.simulation.improve();
        black_box(self.simulation.record());
        self.simulation.advance();
        self.tick += 1;
    }

    /// A tick of the plant alone, with the last command.
    fn step_plant(&mut self) {
        black_box(self.simulation.sense());
        self.simulation.advance();
        self.tick += 1;
    }
}

/// The controller of the arm with every rule that has a policy; the paper's rule and learned-reward on every path.
/// `name_of` names a rule. The keys are (rule and part of the tick, path).
///
/// # Errors
/// [`TimingError::Scenario`], though the scenarios are built in.
pub fn tick_cases(name_of: &dyn Fn(Rule) -> String) -> Result<Vec<CallCase<'static, (String, String)>>, TimingError> {
    let mut cases = Vec::new();
    // A planner's tick takes so long that filling the ring alone would take minutes; `tectum tasks` measures it.
    for rule in Rule::ALL.into_iter().filter(|rule| rule.is_linear()) {
        let plan = plan(rule)?;
        let on_all = matches!(rule, Rule::Paper | Rule::LearnedReward);
        let paths: Vec<SimdPath> = if on_all { SimdPath::all().collect() } else { vec![SimdPath::best()] };
        for path in paths {
            let key = |part: &str| (format!("{}: {part}", name_of(rule)), path.to_string());
            let mut control_loop = ControlLoop::new(&plan, path)?;
            cases.push(CallCase::new(key("learn, encode, act"), move || control_loop.respond()));
            let mut control_loop = ControlLoop::new(&plan, path)?;
            cases.push(CallCase::new(key(WHOLE_TICK), move || control_loop.step()));
        }
    }
    let mut control_loop = ControlLoop::new(&plan(Rule::Paper)?, SimdPath::best())?;
    cases.push(CallCase::new(("the arm alone".to_owned(), String::new()), move || control_loop.step_plant()));
    Ok(cases)
}

/// The paper's scenario for the paper's rule, and the scenario `arm` with the preset of any other rule.
fn plan(rule: Rule) -> Result<Plan, TimingError> {
    if rule == Rule::Paper {
        return Ok(Scenario::built_in(SCENARIO)?.plan()?);
    }
    let mut scenario = Scenario::built_in("arm")?;
    scenario.learner = LearnerConfig::preset(rule);
    Ok(scenario.plan()?)
}
