//! Judges from the reports of plant and controller whether a run went well.
//!
//! Each warning has a name, a sentence with its number and what to do, and the counts themselves. Most are hints: a
//! run may be meant that way. Three mean that the run did not do what it was started for, and make it fail: no
//! command was applied, no tick could be learned from because the plant was late in every one, and no reward was
//! ever finite. A learner that stopped makes it fail as well.

use serde::{Deserialize, Serialize};

use super::run_counts::{NotLearned, RunCounts};
use super::{ControllerReport, PlantReport};
use crate::scenario::Plan;
use crate::text::thousands;

/// Ticks before which nothing can be said about a whole run.
const LEAST_TICKS: u64 = 200;
/// Ticks after which a run in which no command came is judged: at its beginning it may wait for something.
const LEAST_MISSED: u64 = 20;

/// Something in a run that did not go well, or may be a mistake.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RunWarning {
    /// What kind of warning, such as `reward-not-finite`.
    pub name: String,
    /// The input or output that it is about, by name; null if it is about none.
    pub signal: Option<String>,
    /// One sentence.
    pub text: String,
    /// How often; null where nothing is counted.
    pub count: Option<u64>,
    /// Of how many.
    pub of: Option<u64>,
    /// Whether the run has failed because of it.
    pub failure: bool,
}

impl RunWarning {
    fn new(name: &str, counts: [u64; 2], text: String) -> Self {
        let [count, of] = counts.map(Some);
        Self { name: name.to_owned(), signal: None, text, count, of, failure: false }
    }

    fn about(self, signal: &str) -> Self {
        Self { signal: Some(signal.to_owned()), ..self }
    }

    fn fails_if(self, failure: bool) -> Self {
        Self { failure, ..self }
    }

    /// A warning about the scenario's settings, in one sentence.
    pub fn of_settings(text: &str) -> Self {
        Self::uncounted("settings", text)
    }

    /// A warning about the log, which is whole, in one sentence.
    pub fn of_log(text: &str) -> Self {
        Self::uncounted("log", text)
    }

    fn uncounted(name: &str, text: &str) -> Self {
        Self { name: name.to_owned(), signal: None, text: text.to_owned(), count: None, of: None, failure: false }
    }

    /// Its name, with that of its signal: unique in a run.
    pub fn key(&self) -> String {
        self.signal.as_ref().map_or_else(|| self.name.clone(), |signal| format!("{}.{signal}", self.name))
    }
}

/// The warnings of a run of `plan` that is over, in order of weight. Without a controller's report little is known.
pub fn judge(plan: &Plan, plant: &PlantReport, controller: Option<&ControllerReport>) -> Vec<RunWarning> {
    let mut warnings = Vec::new();
    warnings.extend(halted(controller));
    warnings.extend(forgotten("plant", plant.forgot_at, "its body began anew"));
    let forgot_at = controller.and_then(|report| report.forgot_at);
    warnings.extend(forgotten("controller", forgot_at, "what it had learned is lost, and it began to learn anew"));
    warnings.extend(missed(plan, plant, controller));
    if let Some(report) = controller {
        let counts = &report.counts;
        warnings.extend(rewards(counts, !plan.scenario.learner.rule.is_linear()));
        if !report.frozen {
            warnings.extend(little_learned(report));
            warnings.extend(weights(report));
        }
        warnings.extend(planner(report));
        warnings.extend(limited(plan, counts));
        warnings.extend(inputs(plan, counts));
    }
    warnings
}

/// A process that was started again found nothing of what it had remembered.
fn forgotten(process: &str, tick: Option<u64>, then: &str) -> Option<RunWarning> {
    let tick = tick?;
    let text = format!(
        "the {process} was started again at tick {} and its memory was gone; {then}; do not remove a run's files in \
         /dev/shm (`tectum doctor` says whether the system does)",
        thousands(tick)
    );
    let name = format!("{process}-forgot");
    Some(RunWarning { count: Some(tick), of: None, failure: true, ..RunWarning::new(&name, [0; 2], text) })
}

/// The learner has stopped.
fn halted(controller: Option<&ControllerReport>) -> Option<RunWarning> {
    let report = controller?;
    let tick = report.diverged_at?;
    let text = format!(
        "the learner diverged at tick {} and has learned nothing since; try smaller steps under [learner]",
        thousands(tick)
    );
    let done = report.ticks + report.unseen;
    Some(RunWarning::new("learner-halted", [done.saturating_sub(tick), done], text).fails_if(true))
}

/// Ticks whose command was not applied: passed over by the plant, or without a command.
fn missed(plan: &Plan, plant: &PlantReport, controller: Option<&ControllerReport>) -> Vec<RunWarning> {
    let mut warnings = Vec::new();
    let total = plant.ticks + plant.skipped;
    let (skipped, missed) = (plant.skipped, plant.missed.saturating_sub(plant.skipped));
    let judged = |counts: &&RunCounts| total >= LEAST_MISSED && counts.observations >= 2;
    let counts = controller.map(|report| &report.counts).filter(judged);
    // The first observation has no tick before it.
    let always =
        counts.is_some_and(|counts| counts.not_learned[NotLearned::Skipped as usize] + 1 >= counts.observations);
    // The first tick has no command before it, and the last tick's may not have been due.
    let none = skipped > 0 && total >= LEAST_MISSED && plant.missed + 1 >= total;
    if always || 2 * skipped >= total.max(LEAST_MISSED) {
        let text = format!(
            "the plant passed over {} of {} ticks{}, because a tick of its own takes longer than the period of {} ms; \
             give it less to do, or a longer period_ms",
            thousands(skipped),
            thousands(total),
            match (none, always) {
                (true, _) => ", and no command was applied",
                (false, true) => ", some before every tick that it began,",
                (false, false) => "",
            },
            plan.scenario.period_ms
        );
        warnings.push(RunWarning::new("ticks-passed-over", [skipped, total], text).fails_if(always || none));
    }
    // For a plant that has commands ahead, they are as good.
    let (begun, missed) = (plant.ticks, missed.saturating_sub(plant.ahead));
    if begun >= LEAST_MISSED && 2 * missed >= begun {
        // The last tick's command may not have been due.
        let all = missed + 1 >= begun;
        let text = format!(
            "{} of {} ticks had no command{}; the controller was too slow or away",
            thousands(missed),
            thousands(begun),
            if all { ", which means that none was applied" } else { "" }
        );
        warnings.push(RunWarning::new("commands-missed", [missed, begun], text).fails_if(all));
    }
    warnings
}

/// What is wrong with the rewards. A planner doubts single rewards now and then, which is no matter for a warning.
fn rewards(counts: &RunCounts, planner: bool) -> Vec<RunWarning> {
    let mut warnings = Vec::new();
    let (finite, wrong) = (counts.rewards, counts.rewards_not_finite);
    if wrong > 0 {
        let none = finite == 0;
        let text = format!(
            "{} of {} rewards were not finite{}; let the plant return a number in every tick",
            thousands(wrong),
            thousands(finite + wrong),
            if none { ", so nothing could be learned" } else { ", and nothing was learned from them" }
        );
        warnings.push(RunWarning::new("reward-not-finite", [wrong, finite + wrong], text).fails_if(none));
    }
    if finite >= LEAST_TICKS && !counts.rewards_differed {
        let text = format!("the reward had the same value in all {} ticks, which teaches nothing", thousands(finite));
        warnings.push(RunWarning::new("reward-constant", [finite, finite], text));
    }
    if counts.outliers > if planner { finite / 50 } else { 0 } {
        let text = format!(
            "the learner took {} of {} rewards for outliers and left them out; they are far from what all others let \
             it expect",
            thousands(counts.outliers),
            thousands(finite)
        );
        warnings.push(RunWarning::new("reward-outliers", [counts.outliers, finite], text));
    }
    warnings
}

/// Most ticks taught nothing; by cause, the most frequent first.
fn little_learned(report: &ControllerReport) -> Option<RunWarning> {
    let first = report.counts.not_learned[NotLearned::First as usize];
    let done = (report.counts.observations + report.unseen).saturating_sub(first);
    let mut causes: Vec<_> = NotLearned::ALL.into_iter().zip(report.counts.not_learned).skip(1).collect();
    // The controller never saw these.
    causes.iter_mut().filter(|(cause, _)| *cause == NotLearned::Unseen).for_each(|(_, n)| *n += report.unseen);
    let sum: u64 = causes.iter().map(|(_, n)| n).sum();
    if done < LEAST_TICKS || 2 * sum <= done {
        return None;
    }
    causes.sort_by_key(|&(_, n)| std::cmp::Reverse(n));
    let causes = causes.iter().filter(|(_, n)| *n > 0);
    let causes: Vec<_> = causes.map(|(cause, n)| format!("{} {}", cause.in_words(), thousands(*n))).collect();
    let text =
        format!("nothing was learned from {} of {} ticks: {}", thousands(sum), thousands(done), causes.join(", "));
    Some(RunWarning::new("little-learned", [sum, done], text))
}

fn weights(report: &ControllerReport) -> Option<RunWarning> {
    let ticks = report.counts.observations;
    (report.counts.weights_zero && ticks >= LEAST_TICKS).then(|| {
        let text = format!("all weights are still 0 after {} ticks: the policy is noise alone", thousands(ticks));
        RunWarning::new("weights-zero", [ticks, ticks], text)
    })
}

/// A planner that never planned, or whose commands were always at a limit.
fn planner(report: &ControllerReport) -> Vec<RunWarning> {
    let (ticks, counted) = (report.counts.observations, |name: &str| report.learner.get(name).copied());
    let mut warnings = Vec::new();
    if ticks < LEAST_TICKS {
        return warnings;
    }
    if counted("plans") == Some(0) {
        let text = format!(
            "no model was fitted in {} ticks, so that nothing was planned: all commands are noise; look at inputs and \
             reward, or give more under `learner.budget_ms`",
            thousands(ticks)
        );
        warnings.push(RunWarning::new("never-planned", [ticks, ticks], text));
    }
    if let Some(clipped) = counted("clipped").filter(|clipped| 10 * clipped >= 9 * ticks) {
        let text = format!(
            "commands were planned to be at their limit in {} of {} ticks; allow more under [gate], if the plant does",
            thousands(clipped),
            thousands(ticks)
        );
        warnings.push(RunWarning::new("plan-limited", [clipped, ticks], text));
    }
    warnings
}

fn limited(plan: &Plan, counts: &RunCounts) -> Vec<RunWarning> {
    let ticks = counts.observations;
    let outputs = plan.outputs.iter().zip(&counts.limited);
    let often = outputs.filter(|(_, limited)| ticks >= LEAST_TICKS && 10 * **limited >= 9 * ticks);
    often
        .map(|(output, &limited)| {
            let text = format!(
                "output {} was at a limit of the gate or the plant in {} of {} ticks; allow more under [gate], or give \
                 smaller weights and noise",
                output.name,
                thousands(limited),
                thousands(ticks)
            );
            RunWarning::new("command-limited", [limited, ticks], text).about(&output.name)
        })
        .collect()
}

fn inputs(plan: &Plan, counts: &RunCounts) -> Vec<RunWarning> {
    let mut warnings = Vec::new();
    let ticks = counts.observations;
    for (signal, input) in plan.inputs.iter().zip(&counts.inputs) {
        let (name, unit) = (&signal.name, &signal.unit);
        if input.outside > 0 {
            let text = format!(
                "input {name} was outside its range of {} to {} {unit} in {} of {} ticks, between {} and {}; declare \
                 the range that it has",
                signal.min,
                signal.max,
                thousands(input.outside),
                thousands(ticks),
                input.least,
                input.greatest
            );
            warnings.push(RunWarning::new("input-outside-range", [input.outside, ticks], text).about(name));
        }
        if ticks >= LEAST_TICKS && input.least.to_bits() == input.greatest.to_bits() {
            let text = format!("input {name} was {} {unit} in all {} ticks", input.least, thousands(ticks));
            warnings.push(RunWarning::new("input-constant", [ticks, ticks], text).about(name));
        }
    }
    warnings
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::runtime::run_counts::InputCounts;
    use crate::scenario::{LearnerConfig, Rule, Scenario};

    fn plan() -> Plan {
        let mut scenario = Scenario::find("arm").unwrap();
        scenario.learner = LearnerConfig::preset(Rule::LearnedReward);
        scenario.plan().unwrap()
    }

    /// The reports of a run of 1,000 ticks in which all went well.
    fn well() -> (PlantReport, ControllerReport) {
        let counts = RunCounts {
            observations: 1000,
            inputs: vec![InputCounts { least: -0.9, greatest: 0.9, outside: 0 }; 6],
            limited: vec![0, 20, 0, 0],
            rewards: 999,
            rewards_differed: true,
            not_learned: [1, 0, 0, 0, 0, 5, 0, 0, 0, 0],
            ..RunCounts::default()
        };
        let controller = ControllerReport { ticks: 1000, learned: 994, counts, ..ControllerReport::default() };
        (PlantReport { ticks: 1000, missed: 5, ..PlantReport::default() }, controller)
    }

    /// Names, counts and failures of a run of 1,000 ticks that `change` makes go wrong.
    fn judged(change: impl Fn(&mut PlantReport, &mut ControllerReport)) -> Vec<(String, u64, bool)> {
        let (mut plant, mut controller) = well();
        change(&mut plant, &mut controller);
        let warnings = judge(&plan(), &plant, Some(&controller));
        for warning in &warnings {
            // By name, and with its number.
            assert!(warning.text.contains(&thousands(warning.count.unwrap())) || warning.name == "learner-halted");
            assert!(warning.signal.as_ref().is_none_or(|signal| warning.text.contains(signal)), "{warning:?}");
        }
        warnings.iter().map(|warning| (warning.key(), warning.count.unwrap(), warning.failure)).collect()
    }

    fn one(name: &str, count: u64, failure: bool) -> Vec<(String, u64, bool)> {
        vec![(name.to_owned(), count, failure)]
    }

    #[test]
    fn a_run_that_went_well_has_no_warnings() {
        assert_eq!(judged(|_, _| ()), []);
        // A short one says nothing about what never happens.
        let (plant, _) = well();
        assert_eq!(judge(&plan(), &PlantReport { ticks: 10, ..plant }, None), []);
        let short = judged(|plant, controller| {
            (plant.ticks, controller.counts.observations, controller.counts.rewards) = (150, 150, 149);
            controller.counts.inputs[0] = InputCounts::default();
            (controller.counts.weights_zero, controller.counts.rewards_differed) = (true, false);
            controller.counts.limited[0] = 150;
        });
        assert_eq!(short, []);
    }

    #[test]
    fn ticks_passed_over_and_missed_are_told_apart() {
        let skipped = NotLearned::Skipped as usize;
        let few = |plant: &mut PlantReport, _: &mut ControllerReport| (plant.skipped, plant.missed) = (300, 305);
        assert_eq!(judged(few), []);
        let stalled = |plant: &mut PlantReport, _: &mut ControllerReport| (plant.skipped, plant.missed) = (1000, 1005);
        assert_eq!(judged(stalled), one("ticks-passed-over", 1000, false));
        let every = judged(|plant, controller| {
            (plant.skipped, plant.missed) = (1000, 1999);
            controller.counts.not_learned[skipped] = 999;
        });
        let all = [one("ticks-passed-over", 1000, true), one("commands-missed", 999, true)].concat();
        assert_eq!(every[..2], all);
        assert_eq!(every[2], ("little-learned".to_owned(), 1004, false));
        assert_eq!(judged(|plant, _| plant.missed = 600), one("commands-missed", 600, false));
        assert_eq!(judged(|plant, _| plant.missed = 999), one("commands-missed", 999, true));
        let ahead = |plant: &mut PlantReport, _: &mut ControllerReport| (plant.missed, plant.ahead) = (999, 900);
        assert_eq!(judged(ahead), []);
    }

    #[test]
    fn rewards_are_judged() {
        let few = |_: &mut PlantReport, c: &mut ControllerReport| {
            (c.counts.rewards, c.counts.rewards_not_finite) = (989, 10);
        };
        assert_eq!(judged(few), one("reward-not-finite", 10, false));
        let none = |_: &mut PlantReport, c: &mut ControllerReport| {
            (c.counts.rewards, c.counts.rewards_not_finite, c.counts.rewards_differed) = (0, 999, false);
        };
        assert_eq!(judged(none), one("reward-not-finite", 999, true));
        assert_eq!(judged(|_, c| c.counts.rewards_differed = false), one("reward-constant", 999, false));
        assert_eq!(judged(|_, c| c.counts.outliers = 3), one("reward-outliers", 3, false));
        let (plant, mut controller) = well();
        controller.counts.outliers = 3;
        let planner = Scenario::find("arm").unwrap().plan().unwrap();
        assert_eq!(judge(&planner, &plant, Some(&controller)), [], "a planner doubts now and then");
        controller.counts.outliers = 30;
        assert_eq!(judge(&planner, &plant, Some(&controller))[0].name, "reward-outliers");
    }

    #[test]
    fn a_planner_without_plans_or_at_its_limits_is_named() {
        let counted = |name: &'static str, count: u64| {
            judged(move |_, c| c.learner = [(name.to_owned(), count)].into_iter().collect())
        };
        assert_eq!(counted("plans", 0), one("never-planned", 1000, false));
        assert_eq!(counted("clipped", 950), one("plan-limited", 950, false));
        assert_eq!((counted("plans", 900), counted("clipped", 500)), (vec![], vec![]));
    }

    #[test]
    fn a_learner_that_does_not_learn_is_said_with_the_causes() {
        assert_eq!(judged(|_, c| c.counts.weights_zero = true), one("weights-zero", 1000, false));
        assert_eq!(judged(|_, c| c.diverged_at = Some(300)), one("learner-halted", 700, true));
        let (plant, mut controller) = well();
        controller.counts.not_learned = [1, 0, 0, 0, 0, 100, 0, 0, 700, 0];
        controller.unseen = 20;
        let warnings = judge(&plan(), &plant, Some(&controller));
        assert_eq!(
            warnings[0].text,
            "nothing was learned from 820 of 1,019 ticks: reward not finite 700, command missed 100, observation \
             missed 20"
        );
    }

    #[test]
    fn signals_are_named() {
        assert_eq!(judged(|_, c| c.counts.limited[1] = 900), one("command-limited.rate_2", 900, false));
        assert_eq!(judged(|_, c| c.counts.limited[1] = 899), []);
        let still = |_: &mut PlantReport, c: &mut ControllerReport| c.counts.inputs[3] = InputCounts::default();
        assert_eq!(judged(still), one("input-constant.theta_2", 1000, false));
        let outside = |_: &mut PlantReport, c: &mut ControllerReport| {
            c.counts.inputs[0] = InputCounts { least: -1.5, greatest: 0.5, outside: 1 };
        };
        assert_eq!(judged(outside), one("input-outside-range.target_x", 1, false));
    }
}
