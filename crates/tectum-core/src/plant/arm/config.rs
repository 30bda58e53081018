//! `[plant.arm]`: the configuration of the arm: geometry, task, reward, and changes during the run.

use serde::{Deserialize, Serialize};

use crate::serde_pairs::{pair, pairs};

/// `[plant.arm]`: the planar arm of section 4.2.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ArmConfig {
    /// Lengths of the segments, m; 1 to 8 of them.
    pub lengths: Vec<f64>,
    /// Position of the first joint, m.
    #[serde(deserialize_with = "pair")]
    pub base: [f64; 2],
    /// Reference direction of joint angles.
    pub angles: Angles,
    /// Least and greatest angle of each joint, rad, with 0 between them; if empty, joints turn freely and
    /// angles wrap.
    #[serde(deserialize_with = "pairs", skip_serializing_if = "Vec::is_empty")]
    pub limits: Vec<[f64; 2]>,
    /// Whether the inputs' ranges are those of joints that turn freely, -pi to pi, and say nothing of `limits`.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub hidden_limits: bool,
    /// Each tick is one trial (the open-loop setup of section 4.2): every tick begins with all angles 0 and
    /// moves for one period, so that a command `u` gives the posture `gain * period * u`. The only inputs are
    /// those of the target.
    pub open_loop: bool,
    /// Angular rate for a command of 1, rad/s.
    pub gain: f64,
    /// Targets lie in the square from `arena[0]` to `arena[1]` on both axes, m.
    #[serde(deserialize_with = "pair")]
    pub arena: [f64; 2],
    /// Number of ticks between new targets; 1 in an open loop.
    pub target_every: u64,
    /// List of targets, m, used in turn and repeated. If empty, targets are drawn uniformly from the region
    /// that the arm, with its lengths at that tick, can reach with joints that turn freely.
    #[serde(deserialize_with = "pairs", skip_serializing_if = "Vec::is_empty")]
    pub targets: Vec<[f64; 2]>,
    /// The reward of a tick.
    pub reward: ArmRewardConfig,
    /// Joints that block during the run.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub block: Vec<BlockConfig>,
    /// Segments whose length changes during the run.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub shorten: Vec<ShortenConfig>,
    /// Coordinates of the target that are reported with the opposite sign.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub mirror: Vec<MirrorConfig>,
    /// Loads that the end-effector carries.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub payload: Vec<PayloadConfig>,
}

/// Reference direction of joint angles.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Angles {
    /// The x axis: an angle is the direction of the joint's segment.
    Absolute,
    /// The previous segment, or the x axis for the first one: directions are running sums of angles.
    Relative,
}

/// `[plant.arm.reward]`: `r = -scale (|e|^2 + speed |theta_dot|^2 + angle |theta|^2 + collision c)`, with the
/// error `e` in m, rates in rad/s, angles in rad, and the number `c` of pairs of segments that cross. With
/// `near`, `max(0, near^2 - |e|^2)` replaces the term `-|e|^2`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ArmRewardConfig {
    /// Factor of the whole reward.
    pub scale: f64,
    /// Weight of the squared angular rates.
    pub speed: f64,
    /// Weight of the squared angles.
    pub angle: f64,
    /// Weight of the number of pairs of segments that cross or touch; neighbours, which share a joint, are not
    /// counted.
    pub collision: f64,
    /// If given, the error counts only within this distance from the target, m, as a positive reward (section 5).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub near: Option<f64>,
    /// Whether the rate that is asked of a blocked joint costs as if it turned. The paper's sum goes over the angular
    /// rates, and a blocked joint has none; in this other reading the command is what costs.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub blocked_pays: bool,
}

/// `[[plant.arm.block]]`: from a tick on, a joint stays at an angle and ignores commands.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BlockConfig {
    /// Joint, counted from 1 at the base.
    pub joint: usize,
    /// First tick of the block.
    pub tick: u64,
    /// Angle that the joint is held at, rad.
    #[serde(default)]
    pub angle: f64,
}

/// `[[plant.arm.shorten]]`: from a tick on, a segment has another length.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ShortenConfig {
    /// Segment, counted from 1 at the base.
    pub segment: usize,
    /// First tick with the new length.
    pub tick: u64,
    /// The new length, m.
    pub length: f64,
}

/// `[[plant.arm.mirror]]`: from a tick on, a coordinate of the target is reported with the opposite sign. The
/// target itself, and with it reward and error, does not change.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MirrorConfig {
    /// The coordinate.
    pub axis: MirrorAxis,
    /// First tick with the opposite sign; a second entry for the same axis restores the sign.
    pub tick: u64,
}

/// `[[plant.arm.payload]]`: from a tick on, the end-effector carries a load, and gravity pulls it along `-y`. Each
/// motor turns slower against the torque and faster with it, in proportion, as a direct-current motor does.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PayloadConfig {
    /// First tick with this load; it replaces the one before.
    pub tick: u64,
    /// The load, kg; 0 for none.
    pub mass: f64,
    /// How much slower a motor turns for its torque, rad/s per N m.
    #[serde(default = "default_droop")]
    pub droop: f64,
}

fn default_droop() -> f64 {
    0.5
}

/// The coordinates of a target.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MirrorAxis {
    /// `target_x`.
    X,
    /// `target_y`.
    Y,
}

impl ArmConfig {
    /// The length of `segment`, counted from 0, in `tick`, m.
    pub fn length(&self, segment: usize, tick: u64) -> f64 {
        let changes = self.shorten.iter().filter(|s| s.segment == segment + 1 && s.tick <= tick);
        changes.max_by_key(|s| s.tick).map_or(self.lengths[segment], |s| s.length)
    }

    /// The configuration with the lengths of `tick`.
    pub fn at(&self, tick: u64) -> Self {
        let lengths = (0..self.lengths.len()).map(|segment| self.length(segment, tick)).collect();
        Self { lengths, shorten: Vec::new(), ..self.clone() }
    }

    /// How much slower a joint turns in `tick` for each metre of its lever under the load, rad/s per m.
    pub fn droop(&self, tick: u64) -> f64 {
        const GRAVITY: f64 = 9.81;
        let loads = self.payload.iter().filter(|load| load.tick <= tick);
        loads.max_by_key(|load| load.tick).map_or(0.0, |load| GRAVITY * load.mass * load.droop)
    }

    /// Whether x and y of the target are reported with the opposite sign in `tick`.
    pub fn mirrored(&self, tick: u64) -> [bool; 2] {
        [MirrorAxis::X, MirrorAxis::Y]
            .map(|axis| self.mirror.iter().filter(|m| m.axis == axis && m.tick <= tick).count() % 2 == 1)
    }

    /// How the target at `target`, m, is reported in `tick`; of one that is reported, where it is.
    pub fn reported_target(&self, tick: u64, target: [f32; 2]) -> [f32; 2] {
        let mirrored = self.mirrored(tick);
        [0, 1].map(|axis| if mirrored[axis] { -target[axis] } else { target[axis] })
    }
}

impl Default for ArmConfig {
    fn default() -> Self {
        Self {
            lengths: vec![0.5; 4],
            base: [0.0, -1.0],
            angles: Angles::Absolute,
            limits: Vec::new(),
            hidden_limits: false,
            open_loop: false,
            gain: 200.0 * std::f64::consts::PI,
            arena: [-1.0, 1.0],
            target_every: 80,
            targets: Vec::new(),
            reward: ArmRewardConfig::default(),
            block: Vec::new(),
            shorten: Vec::new(),
            mirror: Vec::new(),
            payload: Vec::new(),
        }
    }
}

impl Default for ArmRewardConfig {
    fn default() -> Self {
        Self { scale: 0.1, speed: 0.025, angle: 0.01, collision: 0.0, near: None, blocked_pays: false }
    }
}
