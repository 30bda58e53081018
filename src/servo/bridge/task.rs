//! The task of an arm on servos, as pure computation: what it is to reach, and reward and measures of what it did, from
//! its measured angles.

use super::leader::FollowTask;
use crate::plant::{Arm, JointState, Outcome, Plant as _, So101};
use crate::scenario::{Angles, Plan};
use crate::state::{Persist, StateVisitor};

/// The task: that of a model of the arm, or to follow a leader.
pub(super) enum ArmTask {
    /// `[plant.arm]`.
    Planar(Box<Arm>),
    /// `[plant.so101]`.
    So101(Box<So101>),
    /// `[plant.leader]`.
    Follow(FollowTask),
}

impl ArmTask {
    /// The task of `plan`; `None` without a model and without a leader.
    pub fn new(plan: &Plan) -> Option<Self> {
        let (plant, seed) = (&plan.scenario.plant, plan.scenario.seed);
        let period_s = plan.scenario.period_ms / 1000.0;
        match (&plant.arm, &plant.so101, &plant.leader) {
            (Some(arm), ..) => Some(Self::Planar(Box::new(Arm::new(arm, period_s, seed)))),
            (_, Some(so101), _) => Some(Self::So101(Box::new(So101::new(so101, period_s, seed)))),
            (.., Some(leader)) => Some(Self::Follow(FollowTask::new(leader.joints.len(), period_s))),
            (None, None, None) => None,
        }
    }

    /// Angular rate for a command of 1, rad/s.
    pub fn gain(plan: &Plan) -> f32 {
        let plant = &plan.scenario.plant;
        let gain = plant.arm.as_ref().map(|arm| arm.gain).or(plant.so101.as_ref().map(|so101| so101.gain));
        gain.unwrap_or(1.0) as f32
    }

    /// What the angles of its outputs are.
    pub fn angles(plan: &Plan) -> Angles {
        plan.scenario.plant.arm.as_ref().map_or(Angles::Relative, |arm| arm.angles)
    }

    /// Number of its measures.
    pub fn measures(plan: &Plan) -> usize {
        plan.scenario.plant.body().map_or(1, |body| body.signals().measures.len())
    }

    /// Sets the measured angles, rad.
    pub fn stands(&mut self, theta: &[f32]) {
        match self {
            Self::Planar(arm) => arm.stands(theta),
            Self::So101(arm) => arm.stands(theta),
            Self::Follow(task) => task.stands(theta),
        }
    }

    /// The outcome of a tick, from the measured angles, rad, and rates, rad/s. A tracker may have `seen` the
    /// end-effector of a planar arm, m.
    pub fn measured(&mut self, tick: u64, theta: &[f32], rates: &[f32], seen: Option<[f32; 2]>) -> Outcome {
        match self {
            Self::Planar(arm) => arm.measured(tick, theta, rates, seen),
            Self::So101(arm) => arm.measured(theta, rates),
            Self::Follow(task) => task.measured(theta),
        }
    }

    /// Writes the inputs, and returns whether a new target begins.
    pub fn sense(&mut self, tick: u64, inputs: &mut [f32]) -> bool {
        match self {
            Self::Planar(arm) => arm.sense(tick, inputs),
            Self::So101(arm) => arm.sense_measured(tick, inputs),
            Self::Follow(task) => task.sense(inputs),
        }
    }

    /// Writes the inputs with a target that a tracker reports, m; without one, with the last target. Only planar arms
    /// have trackers.
    pub fn sense_seen(&mut self, tick: u64, target: Option<[f32; 2]>, inputs: &mut [f32]) {
        match self {
            Self::Planar(arm) => arm.sense_seen(tick, target.unwrap_or(arm.target()), inputs),
            other => drop(other.sense(tick, inputs)),
        }
    }

    /// The leader's angles, as the follower is to have them, rad.
    pub fn set_goals(&mut self, goals: &[f32]) {
        if let Self::Follow(task) = self {
            task.set_goals(goals);
        }
    }

    /// The joints, for the gate.
    pub fn joints(&self) -> Option<JointState> {
        match self {
            Self::Planar(arm) => arm.joints(),
            Self::So101(arm) => Some(arm.measured_joints()),
            Self::Follow(task) => Some(task.joints()),
        }
    }
}

impl Persist for ArmTask {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        match self {
            Self::Planar(arm) => arm.visit_state(visitor),
            Self::So101(arm) => arm.visit_state(visitor),
            // It has no memory: both arms are measured in every tick.
            Self::Follow(_) => {}
        }
    }
}
