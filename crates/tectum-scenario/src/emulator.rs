//! Checks of `[plant.emulator]`, the properties of an emulated chain of servos. By default the chain is ideal:
//! it follows any commanded speed, without delay, noise or faults.

use tectum_servo::model::MODELS;

use super::check::{number, show};
use super::error::{Violation, quoted};
use super::{EmulatorConfig, ServoFault, ServoFaultKind, limits};

/// Checks ranges and the model's name.
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
    emulator.faults.iter().enumerate().try_for_each(|(i, fault)| check_fault(&key(&format!("faults[{i}]")), fault))
}

fn check_fault(key: &str, fault: &ServoFault) -> Result<(), Violation> {
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

    /// The violation that `check` reports for this table.
    fn violation(text: &str) -> String {
        let table: EmulatorConfig = toml::from_str(text).expect("a table");
        format!("{:?}", check(&table).expect_err("a violation"))
    }

    #[test]
    fn an_invalid_value_is_reported_with_its_key() {
        let fault = |rest: &str| violation(&format!("[[faults]]\nkind = \"slow\"\n{rest}"));
        for (message, key) in [
            (violation("model = \"MX-28\""), "plant.emulator.model"),
            (violation("speed = 0.0"), "plant.emulator.speed"),
            (violation("acceleration = nan"), "plant.emulator.acceleration"),
            (violation("noise = -1.0"), "plant.emulator.noise"),
            (violation("latency_us = inf"), "plant.emulator.latency_us"),
            (fault(""), "faults[0]"),
            (fault("servo = 254\nprobability = 0.1"), "faults[0].servo"),
            (fault("probability = 0.0"), "faults[0].probability"),
            (fault("from_s = 5.0\nuntil_s = 5.0"), "faults[0].until_s"),
            (fault("from_s = 5.0\ndelay_ms = 0.0"), "faults[0].delay_ms"),
            (violation("[[faults]]\nkind = \"hot\"\nfrom_s = 1.0\ndelay_ms = 2.0"), "faults[0].delay_ms"),
        ] {
            assert!(message.contains(key), "{key}: {message}");
        }
        assert!(toml::from_str::<EmulatorConfig>("latency = 1.0").is_err());
        let good = "speed = 5.0\nnoise = 0.5\n[[faults]]\nkind = \"cable-out\"\nservo = 3\nfrom_s = 1.0\nuntil_s = 2.0";
        check(&toml::from_str(good).expect("a table")).expect("a valid table");
    }
}
