//! Helpers that the checks of all tables share: numbers in a range, names, lists, and the text of a value in a
//! message.

use std::{collections::HashSet, fmt::Display, ops::RangeInclusive};

use super::{SignalConfig, error::Violation, error::quoted, error::word_list, limits};

/// Checks that a number is in a range. NaN is in no range.
pub(super) fn number(
    key: impl Display,
    value: f64,
    range: RangeInclusive<f64>,
    remedy: impl Display,
) -> Result<(), Violation> {
    if range.contains(&value) { Ok(()) } else { Err(Violation::value(key, show(value), remedy)) }
}

/// Checks a number of ticks, from `least` to [`limits::MAX_TICK`].
pub(super) fn ticks(key: impl Display, value: u64, least: u64) -> Result<(), Violation> {
    if (least..=limits::MAX_TICK).contains(&value) {
        return Ok(());
    }
    Err(Violation::value(key, value, format_args!("give {least} to 1000000000000 ticks")))
}

/// Checks the two ends of a range: `low` below `high`, both at most `limit` in magnitude.
pub(super) fn range_ends(key: &str, [low, high]: [f64; 2], limit: f64) -> Result<(), Violation> {
    let ends = -limit..=limit;
    if ends.contains(&low) && ends.contains(&high) && low < high {
        return Ok(());
    }
    let value = format!("[{}, {}]", show(low), show(high));
    let remedy = format!("give the lower end and then the upper one, between {} and {}", show(-limit), show(limit));
    Err(Violation::value(key, value, remedy))
}

/// Checks one end of a signal's range.
pub(super) fn range_end(key: impl Display, value: f64) -> Result<(), Violation> {
    number(key, value, -limits::RANGE..=limits::RANGE, "give a number from -1e9 to 1e9")
}

/// Checks the name of a signal or measure.
pub(super) fn signal_name(key: &str, name: &str) -> Result<(), Violation> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || "_-./".contains(c);
    checked_name(key, name, limits::NAME_CHARS, allowed, "letters, digits, _, -, . and /")
}

/// Checks a name: 1 to `max_chars` characters, all of them `allowed`. The message describes these as
/// `allowed_text`.
pub(super) fn checked_name(
    key: impl Display,
    name: &str,
    max_chars: usize,
    allowed: impl Fn(char) -> bool,
    allowed_text: &str,
) -> Result<(), Violation> {
    if !name.is_empty() && name.chars().count() <= max_chars && name.chars().all(allowed) {
        return Ok(());
    }
    Err(Violation::value(key, quoted(name), format_args!("give 1 to {max_chars} characters out of {allowed_text}")))
}

/// Checks that no name occurs twice in a list. The key of entry `i` is `{list}[{i}]{suffix}`.
pub(super) fn unique_names(list: &str, suffix: &str, names: &[impl AsRef<str>]) -> Result<(), Violation> {
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

/// Checks `program` and `args` of the table `table`.
pub(super) fn program(table: &str, program: &str, args: &[String]) -> Result<(), Violation> {
    if program.trim().is_empty() {
        let remedy = "give the name or the path of a program";
        return Err(Violation::value(format_args!("{table}.program"), quoted(program), remedy));
    }
    let args = args.iter().enumerate().map(|(i, arg)| (format!("{table}.args[{i}]"), arg.as_str()));
    for (key, text) in std::iter::once((format!("{table}.program"), program)).chain(args) {
        // A zero character would end the string for the operating system.
        if text.contains('\0') || text.chars().count() > limits::PROGRAM_CHARS {
            let remedy = "give at most 4096 characters, none of them a zero character";
            return Err(Violation::value(key, quoted(text), remedy));
        }
    }
    Ok(())
}

/// Rounds to three significant digits, for computed numbers in a message.
pub(super) fn rounded(value: f64) -> f64 {
    format!("{value:.2e}").parse().unwrap_or(value)
}

/// A number in TOML's notation. Huge numbers have an exponent.
pub(super) fn show(value: f64) -> String {
    let text = format!("{value:?}");
    // Rust writes `NaN`, TOML `nan`; both write `inf`.
    if value.is_nan() { "nan".to_owned() } else { text.strip_suffix(".0").map(str::to_owned).unwrap_or(text) }
}

/// The index of the input with this name, or a message that lists the plant's inputs.
pub(super) fn known_input(key: impl Display, name: &str, inputs: &[SignalConfig]) -> Result<usize, Violation> {
    inputs.iter().position(|input| input.name == name).ok_or_else(|| {
        let names: Vec<_> = inputs.iter().map(|input| &input.name).collect();
        Violation::value(key, quoted(name), format!("the plant's inputs are {}", word_list(&names, "and")))
    })
}
