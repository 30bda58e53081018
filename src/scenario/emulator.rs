//! `[plant.emulator]`: what the emulated chain of servos is like, and the checks of it. Left out, it is ideal: as fast as it is told to
//! be, without delay, noise or faults.

use serde::{Deserialize, Serialize};

use super::error::{Violation, quoted};
use super::limits;
use super::validate::{number, show};
use crate::servo::model::MODELS;

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
    /// How likely it is, above 0 and up to 1: for every answer, or with what befalls a whole servo for every second. Left out, certain.
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
    /// Neither power nor signals reach the servo and those behind it; when they come back it starts anew, without torque.
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

/// Checks what the types cannot say.
pub(super) fn check(emulator: &EmulatorConfig) -> Result<(), Violation> {
    let key = |name: &str| format!("plant.emulator.{name}");
    if let Some(name) = &emulator.model
        && !MODELS.iter().any(|model| model.name == name)
    {
        let known: Vec<_> = MODELS.iter().map(|model| model.name).collect();
        return Err(Violation::value(key("model"), quoted(name), format!("give one of {}", known.join(", "))));
    }
    for (name, value) in [("speed", emulator.speed), ("acceleration", emulator.acceleration)] {
        if let Some(value) = value {
            let remedy = "give 0.001 to 1e6, or leave it out if there is no limit";
            number(key(name), value, limits::SERVO_RATE, remedy)?;
        }
    }
    for (name, value) in [("latency_us", emulator.latency_us), ("jitter_us", emulator.jitter_us)] {
        number(key(name), value, limits::SERVO_LATENCY_US, "give 0 to 1e6 us")?;
    }
    number(key("noise"), emulator.noise, limits::SERVO_NOISE, "give 0 to 1000 steps")?;
    if emulator.faults.len() > limits::MAX_FAULTS {
        return Err(Violation::new(
            key("faults"),
            format_args!("has {} entries; give at most 16", emulator.faults.len()),
        ));
    }
    emulator.faults.iter().enumerate().try_for_each(|(i, one)| fault(&key(&format!("faults[{i}]")), one))
}

fn fault(key: &str, fault: &ServoFault) -> Result<(), Violation> {
    if fault.probability.is_none() && fault.from_s.is_none() && fault.until_s.is_none() {
        let text = "says neither how likely it is nor when; give probability, or from_s and until_s, or all of them";
        return Err(Violation::new(key, text));
    }
    if let Some(id) = fault.servo
        && id > 253
    {
        return Err(Violation::value(format_args!("{key}.servo"), id, "ids are 0 to 253"));
    }
    if let Some(probability) = fault.probability
        && !(probability > 0.0 && probability <= 1.0)
    {
        return Err(Violation::value(
            format_args!("{key}.probability"),
            show(probability),
            "give more than 0, up to 1",
        ));
    }
    let from = fault.from_s.unwrap_or(0.0);
    number(format_args!("{key}.from_s"), from, limits::SERVO_SECONDS, "give 0 to 1e9 s")?;
    if let Some(until) = fault.until_s {
        number(format_args!("{key}.until_s"), until, limits::SERVO_SECONDS, "give 0 to 1e9 s")?;
        if until <= from {
            let remedy = format!("give more than from_s, which is {}", show(from));
            return Err(Violation::value(format_args!("{key}.until_s"), show(until), remedy));
        }
    }
    match fault.delay_ms {
        Some(_) if fault.kind != ServoFaultKind::Slow => {
            Err(Violation::new(format_args!("{key}.delay_ms"), "is given and belongs to slow alone; take it out"))
        }
        Some(ms) => number(format_args!("{key}.delay_ms"), ms, limits::SERVO_DELAY_MS, "give 0.001 to 60000 ms"),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(text: &str) -> String {
        let table: EmulatorConfig = toml::from_str(text).expect("a table");
        let problem = check(&table).expect_err("a problem");
        format!("{problem:?}")
    }

    #[test]
    fn what_cannot_be_is_refused_by_key_value_and_remedy() {
        let fault = |rest: &str| refused(&format!("[[faults]]\nkind = \"slow\"\n{rest}"));
        for (text, said) in [
            (refused("model = \"MX-28\""), "plant.emulator.model"),
            (refused("speed = 0.0"), "plant.emulator.speed"),
            (refused("acceleration = nan"), "plant.emulator.acceleration"),
            (refused("noise = -1.0"), "plant.emulator.noise"),
            (refused("latency_us = inf"), "plant.emulator.latency_us"),
            (fault(""), "faults[0]"),
            (fault("servo = 254\nprobability = 0.1"), "faults[0].servo"),
            (fault("probability = 0.0"), "faults[0].probability"),
            (fault("from_s = 5.0\nuntil_s = 5.0"), "faults[0].until_s"),
            (fault("from_s = 5.0\ndelay_ms = 0.0"), "faults[0].delay_ms"),
            (refused("[[faults]]\nkind = \"hot\"\nfrom_s = 1.0\ndelay_ms = 2.0"), "faults[0].delay_ms"),
        ] {
            assert!(text.contains(said), "{said}: {text}");
        }
        assert!(toml::from_str::<EmulatorConfig>("latency = 1.0").is_err());
        let good = "speed = 5.0\nnoise = 0.5\n[[faults]]\nkind = \"cable-out\"\nservo = 3\nfrom_s = 1.0\nuntil_s = 2.0";
        check(&toml::from_str(good).expect("a table")).expect("no problem");
    }
}
