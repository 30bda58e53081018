//! What the checks of all tables share: numbers in a range, names, lists, and how a value is shown in a message.

use std::{collections::HashSet, fmt::Display, ops::RangeInclusive};

use super::{SignalConfig, error::Violation, error::either, error::quoted, limits};

/// A number in a range; NaN is in none.
pub(super) fn number(
    key: impl Display,
    value: f64,
    range: RangeInclusive<f64>,
    remedy: impl Display,
) -> Result<(), Violation> {
    if range.contains(&value) { Ok(()) } else { Err(Violation::value(key, show(value), remedy)) }
}

/// A whole number of ticks.
pub(super) fn ticks(key: impl Display, value: u64, least: u64) -> Result<(), Violation> {
    if (least..=limits::MAX_TICK).contains(&value) {
        return Ok(());
    }
    Err(Violation::value(key, value, format_args!("give {least} to 1000000000000 ticks")))
}

/// Two ends of a range, `[low, high]`.
pub(super) fn ordered(key: &str, [low, high]: [f64; 2], most: f64) -> Result<(), Violation> {
    let ends = -most..=most;
    if ends.contains(&low) && ends.contains(&high) && low < high {
        return Ok(());
    }
    let value = format!("[{}, {}]", show(low), show(high));
    let remedy = format!("give the lower end and then the upper one, between {} and {}", show(-most), show(most));
    Err(Violation::value(key, value, remedy))
}

pub(super) fn range_end(key: impl Display, value: f64) -> Result<(), Violation> {
    number(key, value, -limits::RANGE..=limits::RANGE, "give a number from -1e9 to 1e9")
}

pub(super) fn signal_name(key: &str, name: &str) -> Result<(), Violation> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || "_-./".contains(c);
    named(key, name, limits::NAME_CHARS, allowed, "letters, digits, _, -, . and /")
}

pub(super) fn named(
    key: impl Display,
    name: &str,
    most: usize,
    allowed: impl Fn(char) -> bool,
    words: &str,
) -> Result<(), Violation> {
    if !name.is_empty() && name.chars().count() <= most && name.chars().all(allowed) {
        return Ok(());
    }
    Err(Violation::value(key, quoted(name), format_args!("give 1 to {most} characters out of {words}")))
}

/// Names in a list that must all differ.
pub(super) fn different(list: &str, suffix: &str, names: &[impl AsRef<str>]) -> Result<(), Violation> {
    let mut seen = HashSet::new();
    for (i, name) in names.iter().enumerate() {
        let name = name.as_ref();
        if !seen.insert(name) {
            let key = format!("{list}[{i}]{suffix}");
            return Err(Violation::value(
                key,
                quoted(name),
                "this name is in the list already, and each may occur once",
            ));
        }
    }
    Ok(())
}

/// Three significant digits, for numbers that we worked out and nobody wrote.
pub(super) fn rounded(value: f64) -> f64 {
    format!("{value:.2e}").parse().unwrap_or(value)
}

/// A number as TOML writes it, short even if it is huge.
pub(super) fn show(value: f64) -> String {
    let text = format!("{value:?}");
    // `inf` and `NaN` are Rust's words; TOML says `nan`.
    if value.is_nan() { "nan".to_owned() } else { text.strip_suffix(".0").map(str::to_owned).unwrap_or(text) }
}

/// The number of the input that has this name.
pub(super) fn known_input(key: impl Display, name: &str, inputs: &[SignalConfig]) -> Result<usize, Violation> {
    inputs.iter().position(|input| input.name == name).ok_or_else(|| {
        let names: Vec<_> = inputs.iter().map(|input| &input.name).collect();
        Violation::value(key, quoted(name), format!("the plant's inputs are {}", either(&names, "and")))
    })
}
