//! From a run's scenario to the facts that a view needs.

use std::path::Path;

use tectum_view::{ArmFrame, RunFacts, SignalRange};

use crate::runtime::{Mode, RunManifest};
use crate::scenario::{ArmConfig, Plan, SignalConfig};
use crate::supervise::body_changes;
use crate::wire::flag;

/// Room around an arm, as a share of its reach.
const MARGIN: f64 = 1.08;

/// The flags of samples that are worth an event, and what they say.
const EVENTS: [(u32, &str); 12] = [
    (flag::MISSED, "a command was missed: the hold policy chose"),
    (flag::SKIPPED, "the plant was late itself and passed over ticks"),
    (flag::LATE, "a command came after its tick"),
    (flag::NON_FINITE, "a command held a value that is not finite"),
    (flag::CLAMPED, "the gate limited a command"),
    (flag::INVALID, "an input was not a number or out of range, so the command was zero"),
    (flag::DIVERGED, "learning gave a number that is not finite, and the learner has stopped"),
    (flag::UNHEARD, "the controller received no observation of a tick"),
    (flag::UNARMED, "the arm is not armed: nothing is applied"),
    (flag::TRIPPED, "the arm's own safety has turned torque off"),
    (flag::BLIND, "the arm cannot be read, or its tracker has nothing new enough"),
    (flag::TERMINATED, "an episode ended"),
];

/// The facts of the run in `folder`.
pub(super) fn facts(folder: &Path, manifest: &RunManifest, plan: &Plan) -> RunFacts {
    let range = |signal: &SignalConfig| SignalRange {
        name: signal.name.clone(),
        unit: signal.unit.clone(),
        min: signal.min as f32,
        max: signal.max as f32,
    };
    let arm = plan.drawable_arm();
    let name = folder.file_name().map(|name| name.to_string_lossy().into_owned());
    RunFacts {
        name: name.unwrap_or_else(|| folder.display().to_string()),
        scenario: plan.scenario.name.clone(),
        seed: plan.scenario.seed,
        realtime: manifest.mode == Mode::Realtime,
        period_ns: plan.period_ns,
        ticks: plan.scenario.ticks,
        inputs: plan.inputs.iter().map(range).collect(),
        outputs: plan.outputs.iter().map(range).collect(),
        measures: plan.measures.clone(),
        error: plan.error,
        error_unit: plan.error_unit().to_owned(),
        arm: arm.map(arm_frame),
        changes: arm.map_or_else(Vec::new, |arm| {
            body_changes(arm).into_iter().map(|change| (change.tick, change.label)).collect()
        }),
        flags: EVENTS.iter().map(|(bit, text)| (*bit, (*text).to_owned())).collect(),
    }
}

/// The square that holds the arm's targets and its base with half its reach around: it seldom bends further.
fn arm_frame(arm: &ArmConfig) -> ArmFrame {
    let reach: f64 = arm.lengths.iter().sum();
    let ends = |axis: usize| {
        let [low, high] = [arm.base[axis] - reach, arm.base[axis] + reach];
        let [near_low, near_high] = [arm.base[axis] - 0.5 * reach, arm.base[axis] + 0.5 * reach];
        [low.max(arm.arena[0].min(near_low)), high.min(arm.arena[1].max(near_high))]
    };
    let [[left, right], [bottom, top]] = [ends(0), ends(1)];
    let half = MARGIN * 0.5 * (right - left).max(top - bottom);
    ArmFrame { centre: [0.5 * (left + right) as f32, 0.5 * (bottom + top) as f32], half: half as f32 }
}
