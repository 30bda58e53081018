//! `tectum bench learner`: the paper's rule by version and path, the controller's whole tick (encode, act, learn) with every
//! rule, and how learning and answering grow with features and outputs.

use std::hint::black_box;

use super::calls::{CallCase, in_turns};
use super::costs::{CallCost, CallsSettings, CostsOutcome, Growth};
use super::encoder::POWERS;
use super::{BenchError, Machine};
use crate::clock::{TerminationSignals, monotonic_ns};
use crate::learner::PaperRule;
use crate::learner::naive::NaivePaperRule;
use crate::plant::SimulatedPlant;
use crate::policy::{LinearPolicy, Outputs};
use crate::runtime::{Controller, PlantSide};
use crate::scenario::{LearnerConfig, Plan, Rule, Scenario};
use crate::simd::SimdPath;
use crate::study::compare::{LEARNERS, name_of};
use crate::supervise::{LaunchError, ProgressLine, RunFolder};
use crate::wire::{Command, Learning, Observation};

const NOISE: Outputs = [0.003, -0.002, 0.001, -0.004, 0.002, -0.001, 0.004, -0.003];
/// Observations of the ring that controllers are given, from a run of their own; a power of two.
const RING: u64 = 512;
/// Decay and rate of the paper's rule, as in the paper's scenario.
const PAPER: (f32, f32) = (0.9, 0.01);

/// Features as an encoder makes them: positive, of unit norm.
fn features(len: usize) -> [Vec<f32>; 2] {
    let norm = (len as f32 / 3.0).sqrt();
    [0.37, 0.73].map(|k| (0..len).map(|i| (i as f32 * k).fract() / norm).collect())
}

/// Learns from one tick and answers the next in one pass, on `path`.
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

/// The paper's rule for 4 outputs and 320 features: the textbook's loops, learning and answering apart, and both in one pass.
fn versions() -> Vec<CallCase<'static, (String, String)>> {
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

/// A plant and its controller in the middle of things, and the observations that brought them there.
struct Running {
    plant: PlantSide<SimulatedPlant>,
    controller: Controller,
    notify: Vec<Observation>,
    tick: u64,
    observation: Observation,
    command: Command,
    learning: Learning,
}

impl Running {
    fn new(plan: &Plan, path: SimdPath) -> Result<Self, BenchError> {
        let body =
            SimulatedPlant::of(plan).ok_or_else(|| LaunchError::NotSimulated(plan.scenario.plant.program.clone()))?;
        let mut running = Self {
            plant: PlantSide::new(body, plan),
            controller: Controller::new(plan).on(path),
            notify: Vec::with_capacity(RING as usize),
            tick: 0,
            observation: Observation::default(),
            command: Command::default(),
            learning: Learning::default(),
        };
        for _ in 0..RING {
            running.step();
            running.notify.push(running.observation);
        }
        Ok(running)
    }

    /// What a command waits for, on an observation of the ring.
    fn respond(&mut self) {
        let mut observation = self.notify[(self.tick % RING) as usize];
        observation.header.tick = self.tick;
        observation.header.flags = 0;
        self.tick += 1;
        self.controller.respond(black_box(&observation), &mut self.command);
        black_box(&self.command);
    }

    /// A whole tick. The plant is in it: a rule that learns what its body does finds out when observations do not come of
    /// its commands, and then does nothing.
    fn step(&mut self) {
        self.plant.observe(self.tick, 0, 0, &mut self.observation);
        self.controller.respond(&self.observation, &mut self.command);
        self.controller.after_command(&self.observation);
        self.controller.record(&self.observation, &mut self.learning);
        self.plant.step(self.tick, Some(&self.command));
        self.tick += 1;
        black_box((&self.command, &self.learning));
    }

    /// The plant alone, with the last command again and again.
    fn plant(&mut self) {
        self.plant.observe(self.tick, 0, 0, &mut self.observation);
        self.plant.step(self.tick, Some(black_box(&self.command)));
        self.tick += 1;
        black_box(&self.observation);
    }
}

/// What the whole ticks of [`ticks`] are called, behind the rule's name.
pub(super) const WHOLE: &str = "whole tick, with plant";

/// The controller of the arm with every rule, and the paper's on every path.
fn ticks() -> Result<Vec<CallCase<'static, (String, String)>>, BenchError> {
    let mut cases = Vec::new();
    for rule in LEARNERS {
        let plan = plan(rule)?;
        let paths: Vec<SimdPath> = if rule == Rule::Paper { SimdPath::all().collect() } else { vec![SimdPath::best()] };
        for path in paths {
            let key = |what: &str| (format!("{}: {what}", name_of(rule)), path.to_string());
            let mut running = Running::new(&plan, path)?;
            cases.push(CallCase::new(key("learn, encode, act"), move || running.respond()));
            let mut running = Running::new(&plan, path)?;
            cases.push(CallCase::new(key(WHOLE), move || running.step()));
        }
    }
    let mut running = Running::new(&plan(Rule::Paper)?, SimdPath::best())?;
    cases.push(CallCase::new(("the arm alone".to_owned(), String::new()), move || running.plant()));
    Ok(cases)
}

/// The paper's own scenario for its rule, and the arm's with the preset of the others.
fn plan(rule: Rule) -> Result<Plan, BenchError> {
    if rule == Rule::Paper {
        return Ok(Scenario::built_in("paper")?.plan()?);
    }
    let mut scenario = Scenario::built_in("arm")?;
    scenario.learner = LearnerConfig::preset(rule);
    Ok(scenario.plan()?)
}

/// Measures.
///
/// # Errors
/// When the folder cannot be used, or a signal ends it.
pub fn learner(asked: &CallsSettings) -> Result<CostsOutcome, BenchError> {
    asked.check()?;
    let signals = TerminationSignals::install().map_err(LaunchError::Signals)?;
    let folder = RunFolder::create(asked.out.as_deref(), None, "bench-learner")?;
    let began = monotonic_ns();
    let machine = Machine::now(folder.path());
    let mut progress = ProgressLine::new(asked.progress);
    progress.show("learner: versions and rules");
    let mut costs = in_turns(versions(), asked.batches, &signals)?;
    costs.extend(in_turns(ticks()?, asked.batches, &signals)?);
    let costs = costs.into_iter().map(|((what, version), ns)| CallCost { what, version, ns }).collect();
    progress.show("learner: growth");
    let sizes = [4, 8].into_iter().flat_map(|outputs| POWERS.map(move |power| (outputs, power)));
    let sizes = sizes.flat_map(|(outputs, power)| SimdPath::all().map(move |path| (outputs, power, path)));
    let cases = sizes.map(|(outputs, power, path)| one_pass((outputs, power, path), outputs, 1 << power, path));
    let mut growth: Vec<Growth> = in_turns(cases.collect(), asked.batches, &signals)?
        .into_iter()
        .map(|((outputs, power, path), ns)| Growth {
            what: format!("learn and answer, {outputs} outputs"),
            path: path.to_string(),
            features: 1 << power,
            outputs: outputs as u64,
            ns,
            ns_each: ns.median / (outputs as f64 * f64::from(1_u32 << power)),
        })
        .collect();
    growth.sort_by(|a, b| (&a.what, &a.path, a.features).cmp(&(&b.what, &b.path, b.features)));
    let outcome = CostsOutcome {
        what: "learner",
        costs,
        growth,
        machine,
        seconds: (monotonic_ns() - began) as f64 / 1e9,
        folder: folder.path().to_owned(),
    };
    folder.keep();
    outcome.write()?;
    Ok(outcome)
}
