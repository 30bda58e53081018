//! The leader: a second chain of servos without torque, which a user moves by hand, and whose joints the follower's
//! joints follow.
//!
//! It is read once in every tick, just before the follower. A tick in which it does not answer is *blind*: the follower
//! holds its position. After as many ticks as count for the follower's own bus (`lost_after`), or at once when its port
//! is gone or one of its servos reports an error, the follower's torque goes off.

use super::checks::{self, BridgeError};
use super::{Bridge, TripCause, chain};
use crate::plant::{JointState, Outcome};
use crate::scenario::{JointConfig, JointMapping, LeaderConfig};
use crate::servo::bus::{Bus, BusError};
use crate::wire::{MAX_MEASURES, MAX_OUTPUTS, OutputValues};

/// The task of a follower: to have the leader's angles.
pub(super) struct FollowTask {
    joints: usize,
    period: f32,
    /// The angles that it is to have, rad.
    goals: OutputValues,
    theta: OutputValues,
}

impl FollowTask {
    /// The task of `joints` joints, for ticks of `period_s`, s.
    pub fn new(joints: usize, period_s: f64) -> Self {
        Self { joints, period: period_s as f32, goals: [0.0; MAX_OUTPUTS], theta: [0.0; MAX_OUTPUTS] }
    }

    pub fn set_goals(&mut self, goals: &[f32]) {
        self.goals[..goals.len()].copy_from_slice(goals);
    }

    pub fn stands(&mut self, theta: &[f32]) {
        self.theta[..self.joints].copy_from_slice(&theta[..self.joints]);
    }

    /// Reward: the negated sum of the squared differences, rad^2. Measure: the largest difference, rad.
    pub fn measured(&mut self, theta: &[f32]) -> Outcome {
        self.stands(theta);
        let apart = |i: usize| self.goals[i] - self.theta[i];
        let mut measures = [0.0; MAX_MEASURES];
        measures[0] = (0..self.joints).map(|i| apart(i).abs()).fold(0.0, f32::max);
        Outcome { reward: -(0..self.joints).map(|i| apart(i) * apart(i)).sum::<f32>(), measures }
    }

    /// Inputs: the angles that it is to have, then those that it has, rad.
    pub fn sense(&self, inputs: &mut [f32]) -> bool {
        let n = self.joints.min(inputs.len() / 2);
        inputs[..n].copy_from_slice(&self.goals[..n]);
        inputs[n..2 * n].copy_from_slice(&self.theta[..n]);
        false
    }

    pub fn joints(&self) -> JointState {
        JointState { position: self.theta, travel: [self.period; MAX_OUTPUTS] }
    }
}

/// The leader's chain.
pub(super) struct Leader {
    bus: Bus,
    ids: Vec<u8>,
    joints: Vec<JointConfig>,
    /// The follower's joints, in the same order.
    followers: Vec<JointConfig>,
    mapping: JointMapping,
    /// Ticks in a row without an answer of all servos.
    missed: u32,
    /// Whether it was read in this tick, without an error of a servo.
    pub sees: bool,
    /// Why the first read since the last good one failed.
    pub silence: Option<BusError>,
    /// Since when the port is gone, ns.
    gone_since: Option<u64>,
    /// Duration of the tick's read, ns.
    pub read_ns: u64,
}

/// The result of a tick's read.
enum LeaderReading {
    Angles(OutputValues),
    Silent,
    /// A servo reports an error.
    Fault,
}

impl Leader {
    /// Turns the leader's torque off, and checks that its servos are those of the calibration.
    fn new(mut bus: Bus, config: &LeaderConfig, followers: &[JointConfig]) -> Result<Self, BridgeError> {
        let ids: Vec<u8> = config.joints.iter().map(|joint| joint.id).collect();
        bus.torque_off(&ids);
        checks::patiently(&mut bus, |bus| checks::identify(bus, &config.joints))?;
        for joint in &config.joints {
            let recorded = |kept: &crate::servo::model::KeptSetting| joint.registers.get(kept.name).copied();
            checks::patiently(&mut bus, |bus| checks::check_registers(bus, joint.id, recorded))?;
        }
        Ok(Self {
            bus,
            ids,
            joints: config.joints.clone(),
            followers: followers.to_vec(),
            mapping: config.mapping,
            missed: 0,
            sees: false,
            silence: None,
            gone_since: None,
            read_ns: 0,
        })
    }

    /// Reads all servos.
    fn read(&mut self) -> LeaderReading {
        let (state, position) = (self.bus.series().state, self.bus.series().position);
        let (answers, took) = self.bus.sync_read(&self.ids, state);
        self.read_ns = took;
        let answers = match answers {
            Ok(answers) => answers,
            Err(error) => {
                self.silence.get_or_insert(error);
                return LeaderReading::Silent;
            }
        };
        self.silence = None;
        if answers.iter().any(|answer| answer.error != 0) {
            return LeaderReading::Fault;
        }
        let mut goals = [0.0; MAX_OUTPUTS];
        for (i, answer) in answers.iter().enumerate() {
            let (leader, follower) = (&self.joints[i], &self.followers[i]);
            let angle = chain::angle(leader, state.decode(position, &answer.bytes).unwrap_or(0));
            goals[i] = self.mapping.map(leader, follower, angle) as f32;
        }
        LeaderReading::Angles(goals)
    }

    /// Opens the port again if it is back. Its servos may have any torque then, so it is turned off first.
    fn look_for_port(&mut self) -> Result<(), (u64, BusError)> {
        let now = self.bus.now();
        let since = *self.gone_since.get_or_insert(now);
        self.bus.reopen().map_err(|error| (now.saturating_sub(since), error))?;
        self.gone_since = None;
        self.bus.torque_off(&self.ids);
        Ok(())
    }
}

impl Bridge {
    /// Sets the bus of the leader, for a scenario with `[plant.leader]`. Without it the follower gets no torque.
    ///
    /// # Errors
    /// When the scenario has no leader, or its servos are not those of the scenario.
    pub fn set_leader(&mut self, bus: Bus) -> Result<(), BridgeError> {
        let Some(config) = self.leader_config.clone() else { return Err(BridgeError::NoServos) };
        let mut leader = Leader::new(bus, &config, &self.joints[..self.moving])?;
        let until = leader.bus.now() + checks::PATIENCE;
        while let LeaderReading::Silent = leader.read() {
            if leader.bus.now() >= until {
                let why = leader.silence.as_ref().map_or_else(String::new, BusError::to_string);
                return Err(BridgeError::NoAnswer(why));
            }
        }
        self.leader = Some(leader);
        self.read_leader(0);
        Ok(())
    }

    /// Whether the leader's angles are known, or none is needed.
    pub(super) fn knows_leader(&self) -> bool {
        self.leader_config.is_none() || self.leader.as_ref().is_some_and(|leader| leader.sees)
    }

    /// Reads the leader at the beginning of a tick. Turns the follower's torque off if it is lost.
    pub(super) fn read_leader(&mut self, tick: u64) {
        let Some(leader) = &mut self.leader else { return };
        if leader.bus.is_gone() {
            match leader.look_for_port() {
                Ok(()) => (self.notify)(&format!("tick {tick}: the leader's port is open again")),
                Err((gone, error)) => {
                    let limit = self.config.reopen_within_ns();
                    self.presence.give_up_after(gone, limit, &format!("the leader's port was gone: {error}"));
                }
            }
        }
        let reading = leader.read();
        leader.sees = matches!(reading, LeaderReading::Angles(_));
        leader.missed = if leader.sees { 0 } else { leader.missed.saturating_add(1) };
        match reading {
            LeaderReading::Angles(goals) => self.task.set_goals(&goals[..self.moving]),
            LeaderReading::Silent if leader.missed >= self.config.lost_after || leader.bus.is_gone() => {
                self.safety.trip(TripCause::LeaderLost);
            }
            LeaderReading::Silent => {}
            LeaderReading::Fault => self.safety.trip(TripCause::LeaderFault),
        }
    }
}
