//! What can be wrong with a scenario, in words: every message names the file, the line or key, the value and the remedy.
//!
//! The messages are read by people who edit TOML, not Rust, so that what `serde` says about types is put in TOML's words
//! here, and every text taken from the file is quoted, cut to a readable length and kept on one line.

use std::fmt::{self, Display};

use toml::de::DeTable;

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
        /// The name as it was given.
        name: String,
        /// Where it was searched for.
        searched: String,
        /// The nearest names, or all of them.
        remedy: String,
    },
    /// The file does not exist.
    #[error("{file}: there is no such file; check the path")]
    Missing {
        /// The path as it was given.
        file: String,
    },
    /// The path is a folder.
    #[error("{file}: this is a folder; name a scenario file in it")]
    Folder {
        /// The path as it was given.
        file: String,
    },
    /// The operating system refuses to give the file.
    #[error("{file}: the file cannot be read ({source}); check the path and its permissions")]
    Read {
        /// The path as it was given.
        file: String,
        /// What the operating system says.
        source: std::io::Error,
    },
    /// The file is larger than [`MAX_FILE_BYTES`](super::MAX_FILE_BYTES).
    #[error("{file}: the file is larger than 1 MiB; a scenario is a short TOML file, so check that this is one")]
    TooLarge {
        /// The path as it was given.
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
        /// What the TOML parser says.
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
    /// A key that has to be there is not.
    #[error("{place}: {key} is missing; {remedy}")]
    MissingKey {
        /// The file and the line of the table.
        place: FilePosition,
        /// The key with its table.
        key: String,
        /// What to do.
        remedy: String,
    },
    /// A value of the wrong type.
    #[error("{place}: {key} is {value}; give {expected}")]
    WrongType {
        /// The file and the line.
        place: FilePosition,
        /// The key with its table.
        key: String,
        /// The value, or what kind of value it is.
        value: String,
        /// What would be right.
        expected: String,
    },
    /// A value out of range, or one that does not fit the others.
    #[error("{place}: {key} {problem}")]
    Invalid {
        /// The file, and the line where the key or its table stands.
        place: FilePosition,
        /// The key with its table, such as `encoder.maps[0].units[1]`.
        key: String,
        /// What is wrong with it, and the remedy.
        problem: String,
    },
}

/// A place in a scenario file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FilePosition {
    /// The file as it was named.
    pub file: String,
    /// The line, from 1, where it is known.
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

/// What a check found: the key, and the rest of the sentence.
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

/// Longest piece of a file that a message repeats, in characters.
const MAX_QUOTE: usize = 60;

/// A text from a file in quotes, on one line and at a readable length.
pub(super) fn quoted(text: &str) -> String {
    if text.chars().nth(MAX_QUOTE).is_none() {
        return format!("{text:?}");
    }
    format!("{:?}...", text.chars().take(MAX_QUOTE).collect::<String>())
}

/// A message from elsewhere on one line and at a readable length.
fn one_line(message: &str) -> String {
    let clean = |c: char| if c.is_control() { ' ' } else { c };
    message.chars().map(clean).take(4 * MAX_QUOTE).collect::<String>().trim().to_owned()
}

/// Reads the tables out of a text.
pub(super) fn tables(source: &ScenarioSource) -> Result<Scenario, ScenarioError> {
    let place =
        |offset: usize| FilePosition { file: source.name().to_owned(), line: Some(line_at(source.text(), offset)) };
    let document = DeTable::parse(source.text()).map_err(|error| {
        let reason = error.message();
        let reason = one_line(reason.strip_suffix(", expected nothing").unwrap_or(reason));
        ScenarioError::Syntax { place: place(error.span().unwrap_or_default().start), reason }
    })?;
    if let Some((key, start)) = list_for_table(document.get_ref()) {
        let (value, expected) = ("a list".to_owned(), expected_in_words("struct "));
        return Err(ScenarioError::WrongType { place: place(start), key, value, expected });
    }
    toml::from_str(source.text()).map_err(|error| {
        let span = error.span().unwrap_or_default();
        let key = key_at(document.get_ref(), &span).unwrap_or_default();
        refused(error.message(), place(span.start), key)
    })
}

/// Puts what serde says about the value at a key into our words.
fn refused(message: &str, place: FilePosition, key: String) -> ScenarioError {
    if let Some((unknown, known)) = between(message, "unknown field `", "`, expected ") {
        // The name may hold dots of its own, so that the table is what is left of the path without it.
        let table = key.strip_suffix(unknown).map_or("", |table| table.trim_end_matches('.'));
        let remedy = remedy_for_unknown(table, unknown, &listed(known));
        return ScenarioError::UnknownKey { place, key: joined(table, unknown), remedy };
    }
    if let Some(missing) = message.strip_prefix("missing field `").and_then(|rest| rest.strip_suffix('`')) {
        // The root has no line of its own.
        let place = if key.is_empty() { FilePosition { line: None, ..place } } else { place };
        let remedy = "this key has no default, so add it".to_owned();
        return ScenarioError::MissingKey { place, key: joined(&key, missing), remedy };
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
        let known: Vec<_> = listed(known).into_iter().map(quoted).collect();
        return ScenarioError::WrongType { place, key, value: quoted(value), expected: either(&known, "or") };
    }
    let found = between(message, "invalid type: ", ", expected ")
        .or_else(|| between(message, "invalid value: ", ", expected "))
        .map(|(value, expected)| (found_in_words(value), expected))
        .or_else(|| {
            between(message, "invalid length ", ", expected ").map(|(n, expected)| (format!("a list of {n}"), expected))
        });
    match found {
        Some((value, expected)) => {
            ScenarioError::WrongType { place, key, value, expected: expected_in_words(expected) }
        }
        None => ScenarioError::Invalid {
            place,
            key,
            problem: format!("cannot be used ({}); correct it here", one_line(message)),
        },
    }
}

/// What stands between a prefix and the last separator, and what follows the separator.
fn between<'m>(message: &'m str, prefix: &str, separator: &str) -> Option<(&'m str, &'m str)> {
    let (first, second) = message.strip_prefix(prefix)?.rsplit_once(separator)?;
    Some((first, second))
}

/// The names in backticks in one of serde's lists.
fn listed(list: &str) -> Vec<&str> {
    list.split('`').skip(1).step_by(2).collect()
}

/// `a, b or c`
pub(super) fn either(names: &[impl AsRef<str>], word: &str) -> String {
    let names: Vec<&str> = names.iter().map(AsRef::as_ref).collect();
    match names.split_last() {
        Some((last, [])) => (*last).to_owned(),
        Some((last, rest)) => format!("{} {word} {last}", rest.join(", ")),
        None => String::new(),
    }
}

fn joined(table: &str, key: &str) -> String {
    if table.is_empty() { key.to_owned() } else { format!("{table}.{key}") }
}

fn remedy_for_unknown(table: &str, unknown: &str, known: &[&str]) -> String {
    let unknown: String = unknown.chars().take(MAX_QUOTE).collect();
    let nearest = known.iter().map(|known| (distance(&unknown, known), *known)).min();
    match nearest {
        Some((distance, known)) if distance <= 1 + known.len() / 4 => {
            format!("did you mean {:?}?", joined(table, known))
        }
        _ if known.len() == 1 => format!("the only key here is {}", known[0]),
        _ => format!("the keys here are {}", either(known, "and")),
    }
}

/// Edits (insert, delete, replace, swap of neighbours) between two words.
pub(super) fn distance(a: &str, b: &str) -> usize {
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

/// serde's name of a value that it found, in TOML's words.
fn found_in_words(value: &str) -> String {
    match value {
        "sequence" => return "a list".to_owned(),
        // A date reaches serde as a table of one.
        "map" => return "a table or a date".to_owned(),
        _ => {}
    }
    if let Some(text) = value.strip_prefix("string ") {
        // In quotes and escaped already, but of any length.
        let cut = text.chars().nth(MAX_QUOTE).is_some();
        return if cut { format!("{}...", text.chars().take(MAX_QUOTE).collect::<String>()) } else { text.to_owned() };
    }
    // "integer `5`", "floating point `1.5`", "integer `99999999999999999999` as i128"
    one_line(value.split('`').nth(1).unwrap_or(value))
}

/// serde's name of what it expected, in TOML's words.
fn expected_in_words(expected: &str) -> String {
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
