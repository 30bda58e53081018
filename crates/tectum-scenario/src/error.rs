//! Errors in a scenario. Every message names the file, the line or key, the value and the remedy.
//!
//! The readers of these messages edit TOML, not Rust. Therefore this module translates serde's messages about
//! types into TOML's terms. Every text taken from the file is quoted, cut to a readable length and kept on one
//! line.

use std::fmt::{self, Display};

use serde::Deserialize as _;
use serde::de::DeserializeOwned;
use toml::de::{DeTable, DeValue, Deserializer};

use crate::programs::is_shipped_controller;

use super::{
    Scenario,
    source::{ScenarioSource, key_at, line_at, list_for_table},
};

/// Why a scenario cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ScenarioError {
    /// The name is neither a file nor a built-in scenario.
    #[error("there is no scenario {}: {searched}; {remedy}", quoted(.name))]
    UnknownName {
        /// The name that the caller gave.
        name: String,
        /// The places that were searched.
        searched: String,
        /// The nearest names, or all of them.
        remedy: String,
    },
    /// The file does not exist.
    #[error("{file}: there is no such file; check the path")]
    Missing {
        /// The path that the caller gave.
        file: String,
    },
    /// The path is a folder.
    #[error("{file}: this is a folder; name a scenario file in it")]
    Folder {
        /// The path that the caller gave.
        file: String,
    },
    /// The file exists but cannot be read.
    #[error("{file}: the file cannot be read ({source}); check the path and its permissions")]
    Read {
        /// The path that the caller gave.
        file: String,
        /// The operating system's error.
        source: std::io::Error,
    },
    /// The file is larger than [`MAX_FILE_BYTES`](super::MAX_FILE_BYTES).
    #[error("{file}: the file is larger than 1 MiB; a scenario is a short TOML file, so check that this is one")]
    TooLarge {
        /// The path that the caller gave.
        file: String,
    },
    /// The file is not UTF-8.
    #[error("{place}: the text is not UTF-8 here; save the file as UTF-8")]
    NotUtf8 {
        /// The file and the line of the first wrong byte.
        place: FilePosition,
    },
    /// The text is not TOML.
    #[error("{place}: this is not valid TOML ({reason}); correct it here")]
    Syntax {
        /// The file and the line.
        place: FilePosition,
        /// The TOML parser's message.
        reason: String,
    },
    /// A key that no table has.
    #[error("{place}: unknown key {}; {remedy}", quoted(.key))]
    UnknownKey {
        /// The file and the line.
        place: FilePosition,
        /// The key with its table, such as `plant.arm.lenghts`.
        key: String,
        /// The nearest known key, or all of them.
        remedy: String,
    },
    /// A required key is missing.
    #[error("{place}: {key} is missing; {remedy}")]
    MissingKey {
        /// The file and the line of the table.
        place: FilePosition,
        /// The key with its table.
        key: String,
        /// How to correct it.
        remedy: String,
    },
    /// A value of the wrong type.
    #[error("{place}: {key} is {value}; give {expected}")]
    WrongType {
        /// The file and the line.
        place: FilePosition,
        /// The key with its table.
        key: String,
        /// The value, or its type.
        value: String,
        /// The type that the key takes.
        expected: String,
    },
    /// A value out of range, or one that contradicts another key.
    #[error("{place}: {key} {problem}")]
    Invalid {
        /// The file, and the line of the key or of its table.
        place: FilePosition,
        /// The key with its table, such as `encoder.maps[0].units[1]`.
        key: String,
        /// The problem and the remedy.
        problem: String,
    },
}

/// A position in a scenario file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FilePosition {
    /// The file, as the caller named it.
    pub file: String,
    /// The line, counted from 1; `None` if unknown.
    pub line: Option<usize>,
}

impl Display for FilePosition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.line {
            Some(line) => write!(f, "{}:{line}", self.file),
            None => f.write_str(&self.file),
        }
    }
}

/// The problem that a check found: the key, and the rest of the sentence.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Violation {
    pub(super) key: String,
    pub(super) text: String,
}

impl Violation {
    /// `{key} {text}`
    pub(super) fn new(key: impl Display, text: impl Display) -> Self {
        Self { key: key.to_string(), text: text.to_string() }
    }

    /// `{key} is {value}; {remedy}`
    pub(super) fn value(key: impl Display, value: impl Display, remedy: impl Display) -> Self {
        Self::new(key, format_args!("is {value}; {remedy}"))
    }
}

/// Longest text from a file that a message repeats, characters.
const MAX_QUOTE: usize = 60;

/// A text from a file: in quotes, on one line, and cut to [`MAX_QUOTE`].
pub(super) fn quoted(text: &str) -> String {
    if text.chars().nth(MAX_QUOTE).is_none() {
        return format!("{text:?}");
    }
    format!("{:?}...", text.chars().take(MAX_QUOTE).collect::<String>())
}

/// A message of a library, on one line and cut to a readable length.
fn one_line(message: &str) -> String {
    let clean = |c: char| if c.is_control() { ' ' } else { c };
    message.chars().map(clean).take(4 * MAX_QUOTE).collect::<String>().trim().to_owned()
}

/// Reads `table`, which stands under `key` in the scenario of `source`, as settings of type `T`.
pub(super) fn read_table<T: DeserializeOwned>(
    table: toml::Table,
    key: &str,
    source: &ScenarioSource,
) -> Result<T, ScenarioError> {
    // Written and read again, because serde's errors only tell the place of a value in a text.
    let text = toml::to_string(&table).unwrap_or_default();
    toml::from_str(&text).map_err(|error| {
        let document = DeTable::parse(&text).ok();
        let span = error.span().unwrap_or_default();
        let inner = document.and_then(|document| key_at(document.get_ref(), &span)).unwrap_or_default();
        let key = full_key(key, &inner);
        let key = key.trim_end_matches('.').to_owned();
        let place = FilePosition { file: source.name().to_owned(), line: source.line_of(&key) };
        from_serde(error.message(), place, key)
    })
}

/// Takes `[learner]` out of the tables of a scenario whose controller is another program, which reads it by itself.
fn take_own_learner(document: &mut DeTable<'_>, text: &str) -> Option<toml::Table> {
    let DeValue::Table(controller) = document.get("controller")?.get_ref() else { return None };
    let DeValue::String(program) = controller.get("program")?.get_ref() else { return None };
    if is_shipped_controller(program) || !matches!(document.get("learner")?.get_ref(), DeValue::Table(_)) {
        return None;
    }
    document.remove("learner");
    match text.parse::<toml::Table>().ok()?.remove("learner")? {
        toml::Value::Table(table) => Some(table),
        _ => None,
    }
}

/// Parses a text into the scenario's tables.
pub(super) fn tables(source: &ScenarioSource) -> Result<Scenario, ScenarioError> {
    let place =
        |offset: usize| FilePosition { file: source.name().to_owned(), line: Some(line_at(source.text(), offset)) };
    let document = DeTable::parse(source.text()).map_err(|error| {
        let reason = error.message();
        let reason = one_line(reason.strip_suffix(", expected nothing").unwrap_or(reason));
        ScenarioError::Syntax { place: place(error.span().unwrap_or_default().start), reason }
    })?;
    if let Some((key, start)) = list_for_table(document.get_ref()) {
        let (value, expected) = ("a list".to_owned(), expected_in_toml("struct "));
        return Err(ScenarioError::WrongType { place: place(start), key, value, expected });
    }
    let mut read = document.clone();
    let own_learner = take_own_learner(read.get_mut(), source.text());
    let scenario = Scenario::deserialize(Deserializer::from(read)).map_err(|error| {
        let span = error.span().unwrap_or_default();
        let key = key_at(document.get_ref(), &span).unwrap_or_default();
        from_serde(error.message(), place(span.start), key)
    })?;
    Ok(Scenario { own_learner, ..scenario })
}

/// Translates serde's message about the value of `key`.
fn from_serde(message: &str, place: FilePosition, key: String) -> ScenarioError {
    if let Some((unknown, known)) = between(message, "unknown field `", "`, expected ") {
        // The unknown name may contain dots, so the table is the path without the name, not the path up to the
        // last dot.
        let table = key.strip_suffix(unknown).map_or("", |table| table.trim_end_matches('.'));
        let remedy = remedy_for_unknown(table, unknown, &names_in_backticks(known));
        return ScenarioError::UnknownKey { place, key: full_key(table, unknown), remedy };
    }
    if let Some(missing) = message.strip_prefix("missing field `").and_then(|rest| rest.strip_suffix('`')) {
        // A key missing from the root table has no line.
        let place = if key.is_empty() { FilePosition { line: None, ..place } } else { place };
        let remedy = "this key has no default, so add it".to_owned();
        return ScenarioError::MissingKey { place, key: full_key(&key, missing), remedy };
    }
    let key = if key.is_empty() { "the value".to_owned() } else { key };
    if message == "wanted string or table" {
        return ScenarioError::Invalid {
            place,
            key,
            problem: "is not a text; give one of its words in quotes".to_owned(),
        };
    }
    if let Some((value, known)) = between(message, "unknown variant `", "`, expected ") {
        let known: Vec<_> = names_in_backticks(known).into_iter().map(quoted).collect();
        return ScenarioError::WrongType { place, key, value: quoted(value), expected: word_list(&known, "or") };
    }
    let found = between(message, "invalid type: ", ", expected ")
        .or_else(|| between(message, "invalid value: ", ", expected "))
        .map(|(value, expected)| (value_in_toml(value), expected))
        .or_else(|| {
            between(message, "invalid length ", ", expected ").map(|(n, expected)| (format!("a list of {n}"), expected))
        });
    match found {
        Some((value, expected)) => ScenarioError::WrongType { place, key, value, expected: expected_in_toml(expected) },
        None => ScenarioError::Invalid {
            place,
            key,
            problem: format!("cannot be used ({}); correct it here", one_line(message)),
        },
    }
}

/// The text between a prefix and the last separator, and the text after the separator.
fn between<'m>(message: &'m str, prefix: &str, separator: &str) -> Option<(&'m str, &'m str)> {
    let (first, second) = message.strip_prefix(prefix)?.rsplit_once(separator)?;
    Some((first, second))
}

/// The names in backticks in one of serde's lists.
fn names_in_backticks(list: &str) -> Vec<&str> {
    list.split('`').skip(1).step_by(2).collect()
}

/// The names as a list in a sentence: `a, b or c`, where `word` is `or`.
pub fn word_list(names: &[impl AsRef<str>], word: &str) -> String {
    let names: Vec<&str> = names.iter().map(AsRef::as_ref).collect();
    match names.split_last() {
        Some((last, [])) => (*last).to_owned(),
        Some((last, rest)) => format!("{} {word} {last}", rest.join(", ")),
        None => String::new(),
    }
}

fn full_key(table: &str, key: &str) -> String {
    if table.is_empty() { key.to_owned() } else { format!("{table}.{key}") }
}

fn remedy_for_unknown(table: &str, unknown: &str, known: &[&str]) -> String {
    let unknown: String = unknown.chars().take(MAX_QUOTE).collect();
    let nearest = known.iter().map(|known| (distance(&unknown, known), *known)).min();
    match nearest {
        Some((distance, known)) if distance <= 1 + known.len() / 4 => {
            format!("did you mean {:?}?", full_key(table, known))
        }
        _ if known.len() == 1 => format!("the only key here is {}", known[0]),
        _ => format!("the keys here are {}", word_list(known, "and")),
    }
}

/// The name among `names` that is nearest to `name`, if it is near enough to be a misspelling: the first one with the
/// smallest edit distance.
pub fn nearest_name<'n>(name: &str, names: impl Iterator<Item = &'n str>) -> Option<&'n str> {
    /// Limits the cost of the comparisons, which grows with the length. A longer text is not a misspelt name.
    const MAX_CHARS: usize = 60;
    if name.is_empty() || name.chars().count() > MAX_CHARS {
        return None;
    }
    let best = names.map(|known| (distance(name, known), known)).min_by_key(|(edits, _)| *edits);
    best.filter(|(edits, known)| *edits <= 1 + known.len() / 4).map(|(_, known)| known)
}

/// Edit distance of two words. An edit inserts, deletes or replaces a character, or swaps two neighbours.
fn distance(a: &str, b: &str) -> usize {
    let (a, b): (Vec<char>, Vec<char>) = (a.chars().collect(), b.chars().collect());
    let mut rows = vec![vec![0; b.len() + 1]; a.len() + 1];
    for i in 0..=a.len() {
        for j in 0..=b.len() {
            rows[i][j] = if i == 0 || j == 0 {
                i + j
            } else {
                let replace = rows[i - 1][j - 1] + usize::from(a[i - 1] != b[j - 1]);
                let edit = replace.min(rows[i - 1][j] + 1).min(rows[i][j - 1] + 1);
                let swapped = i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1];
                if swapped { edit.min(rows[i - 2][j - 2] + 1) } else { edit }
            };
        }
    }
    rows[a.len()][b.len()]
}

/// Translates serde's description of a value that it found into TOML's terms.
fn value_in_toml(value: &str) -> String {
    match value {
        "sequence" => return "a list".to_owned(),
        // The parser hands a date to serde as a table with one key.
        "map" => return "a table or a date".to_owned(),
        _ => {}
    }
    if let Some(text) = value.strip_prefix("string ") {
        // serde has quoted and escaped the text, but not cut it.
        let cut = text.chars().nth(MAX_QUOTE).is_some();
        return if cut { format!("{}...", text.chars().take(MAX_QUOTE).collect::<String>()) } else { text.to_owned() };
    }
    // "integer `5`", "floating point `1.5`", "integer `99999999999999999999` as i128"
    one_line(value.split('`').nth(1).unwrap_or(value))
}

/// Translates serde's description of the expected type into TOML's terms.
fn expected_in_toml(expected: &str) -> String {
    match expected {
        "f64" => "a number".to_owned(),
        "u64" | "u32" | "usize" => "a whole number from 0, written in digits only, such as 12_000_000".to_owned(),
        "a string" => "a text in quotes".to_owned(),
        "a boolean" => "true or false".to_owned(),
        "a sequence" => "a list, in [ ]".to_owned(),
        "an array of length 2" => "a list of two numbers, such as [-1.0, 1.0]".to_owned(),
        other if other.starts_with("struct ") => {
            "a table of keys and values, under a single [heading] or in { }".to_owned()
        }
        other => one_line(other),
    }
}
