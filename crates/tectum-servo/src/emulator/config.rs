//! `[plant.emulator]`: the configuration of an emulated chain of servos. The default is an ideal chain, without
//! limits of speed, delay, noise or faults.

use serde::de::IntoDeserializer as _;
use serde::de::value::{Error as ValueError, StrDeserializer};
use serde::{Deserialize, Serialize};

/// `[plant.emulator]`: an emulated chain of servos.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EmulatorConfig {
    /// Model of all servos, by the manufacturer's name; by default XL330-M288 or STS3215, depending on the
    /// protocol.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub model: Option<String>,
    /// Greatest speed, rad/s; by default, only the registers limit it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub speed: Option<f64>,
    /// Greatest acceleration, rad/s^2; by default, speeds change at once.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub acceleration: Option<f64>,
    /// Delay of answers in addition to the transmission time, us.
    pub latency_us: f64,
    /// Largest additional random delay, uniformly distributed, us.
    pub jitter_us: f64,
    /// Standard deviation of the measured position, steps (4096 per turn).
    pub noise: f64,
    /// Whether the adapter sends back what it is sent.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub echo: bool,
    /// Injected faults.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub faults: Vec<ServoFault>,
}

/// `[[plant.emulator.faults]]`: a fault of the bus or of a servo.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ServoFault {
    /// Kind of the fault.
    pub kind: ServoFaultKind,
    /// Id of the servo; by default all servos. `cable-out` also affects the servos behind it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub servo: Option<u8>,
    /// Start of the fault, s after the start of the emulator; by default 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from_s: Option<f64>,
    /// End of the fault, s after the start of the emulator; by default it does not end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until_s: Option<f64>,
    /// Probability, above 0 and at most 1, per answer, or per second for a fault of a whole servo; by default 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub probability: Option<f64>,
    /// Delay of `slow` answers, ms; by default 20.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub delay_ms: Option<f64>,
}

impl ServoFault {
    /// The fault that a text describes: `KIND[:SERVO[:FROM_S[:UNTIL_S]]]`.
    ///
    /// # Errors
    /// What is wrong with the text.
    pub fn parse(text: &str) -> Result<Self, String> {
        let wrong = |what: &str| format!("{what}; give KIND[:SERVO[:FROM_S[:UNTIL_S]]], as in no-reply:2:5:6");
        let mut parts = text.split(':');
        let word: StrDeserializer<'_, ValueError> = parts.next().unwrap_or_default().into_deserializer();
        let kind = ServoFaultKind::deserialize(word).map_err(|_| {
            wrong("there are no-reply, bad-checksum, wrong-id, slow, cable-out, overload, brown-out and hot")
        })?;
        let mut number = |name: &str| match parts.next().filter(|part| !part.is_empty()) {
            None => Ok(None),
            Some(part) => match part.parse::<f64>() {
                Ok(value) if (0.0..1e9).contains(&value) => Ok(Some(value)),
                _ => Err(wrong(&format!("\"{part}\" is no {name}"))),
            },
        };
        let (servo, from, until_s) = (number("id")?, number("instant")?, number("instant")?);
        if parts.next().is_some() {
            return Err(wrong("there is more than four parts"));
        }
        let servo = match servo {
            Some(id) if id > 253.0 || id.fract() != 0.0 => return Err(wrong(&format!("\"{id}\" is no id"))),
            id => id.map(|id| id as u8),
        };
        let from = from.unwrap_or(0.0);
        if let Some(until) = until_s.filter(|&until| until <= from) {
            return Err(wrong(&format!("it ends at {until} s and begins at {from} s")));
        }
        Ok(Self { kind, servo, from_s: Some(from), until_s, probability: None, delay_ms: None })
    }
}

/// Kinds of servo faults.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ServoFaultKind {
    /// An answer is lost; the instruction is executed.
    NoReply,
    /// An answer has a wrong checksum.
    BadChecksum,
    /// An answer has the id of another servo, the next one.
    WrongId,
    /// An answer comes `delay_ms` later.
    Slow,
    /// The servo and those behind it lose power and signals; when they return, the servos restart without torque.
    CableOut,
    /// The joint is held fixed; with torque on, the servo's overload protection trips after some time.
    Overload,
    /// The voltage drops below the servo's limit; at the end the servo restarts without torque.
    BrownOut,
    /// The servo is hotter than its limit.
    Hot,
}

impl ServoFaultKind {
    /// Whether the fault affects a whole servo for some time, rather than single answers.
    pub fn affects_servo(self) -> bool {
        matches!(self, Self::CableOut | Self::Overload | Self::BrownOut | Self::Hot)
    }
}
