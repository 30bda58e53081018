//! `[plant.emulator]`: the settings of an emulated chain of servos. Left out, it is ideal: as fast as it is
//! told to be, without delay, noise or faults.

use serde::{Deserialize, Serialize};

/// `[plant.emulator]`: an emulated chain of servos.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EmulatorConfig {
    /// The model of all servos, as its maker writes it; left out, XL330-M288 or STS3215, as the protocol says.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub model: Option<String>,
    /// Greatest speed, rad/s; left out, there is no limit but that of the registers.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub speed: Option<f64>,
    /// Greatest acceleration, rad/s^2; left out, speeds change at once.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub acceleration: Option<f64>,
    /// By how much answers are late beyond the wire's own time, us.
    pub latency_us: f64,
    /// And by how much more at most, evenly distributed, us.
    pub jitter_us: f64,
    /// Standard deviation of the measured position, steps of 4096 a turn.
    pub noise: f64,
    /// What goes wrong.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub faults: Vec<ServoFault>,
}

/// `[[plant.emulator.faults]]`: something that goes wrong on the bus or in a servo.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ServoFault {
    /// What goes wrong.
    pub kind: ServoFaultKind,
    /// The id of the servo; left out, any of them. With `cable-out` the servos behind it are off as well.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub servo: Option<u8>,
    /// The first second in which it happens, counted from the emulator's start; left out, 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from_s: Option<f64>,
    /// The second from which on it no longer happens; left out, never.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until_s: Option<f64>,
    /// How likely it is, above 0 and up to 1: for every answer, or with what befalls a whole servo for every
    /// second. Left out, certain.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub probability: Option<f64>,
    /// How much later `slow` answers come, ms; left out, 20.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub delay_ms: Option<f64>,
}

/// What can go wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ServoFaultKind {
    /// An answer does not come; the instruction is carried out.
    NoReply,
    /// An answer's checksum does not fit.
    BadChecksum,
    /// An answer says that it comes from the servo with the next id.
    WrongId,
    /// An answer comes `delay_ms` later.
    Slow,
    /// Neither power nor signals reach the servo and those behind it; when they come back it starts anew,
    /// without torque.
    CableOut,
    /// The joint is held fast; with torque on, the servo's own protection trips after a while.
    Overload,
    /// The voltage drops below the servo's limit; at the end the servo starts anew, without torque.
    BrownOut,
    /// The servo is hotter than its limit.
    Hot,
}

impl ServoFaultKind {
    /// Whether it befalls a whole servo for a while, not one answer.
    pub fn lasts(self) -> bool {
        matches!(self, Self::CableOut | Self::Overload | Self::BrownOut | Self::Hot)
    }
}
