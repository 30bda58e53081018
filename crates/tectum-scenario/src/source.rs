//! The origin of a scenario (file name and text), and the line of a key in that text, for error messages.

use std::path::{Path, PathBuf};
use std::{fmt, ops::Range, sync::Arc};

use toml::de::{DeTable, DeValue};

/// The origin of a scenario: the name of its file and its text, kept for messages.
///
/// It is not part of the scenario's content: it takes no part in comparisons, and is neither written by
/// [`to_toml`](super::Scenario::to_toml) nor hashed.
#[derive(Clone)]
pub struct ScenarioSource {
    name: Arc<str>,
    text: Arc<str>,
    /// The folder of the file, absolute; `None` for a scenario that was not read from a file.
    folder: Option<Arc<Path>>,
}

impl ScenarioSource {
    pub(super) fn new(name: &str, text: &str) -> Self {
        Self { name: name.into(), text: text.into(), folder: None }
    }

    /// The folder against which the scenario's paths are resolved, absolute.
    pub fn folder(&self) -> Option<&Path> {
        self.folder.as_deref()
    }

    /// The same origin with another folder.
    pub fn in_folder(mut self, folder: Option<&Path>) -> Self {
        self.set_folder(folder);
        self
    }

    pub(super) fn set_folder(&mut self, folder: Option<&Path>) {
        self.folder = folder.map(Into::into);
    }

    /// The file that the scenario calls `path`. A relative path begins at the scenario's folder. If nothing is there,
    /// it may begin at the working folder, as it does for a scenario that was not read from a file. `~/` is the user's
    /// home.
    pub fn resolve(&self, path: &str) -> PathBuf {
        let home = path.strip_prefix("~/").and_then(|rest| Some(Path::new(&std::env::var_os("HOME")?).join(rest)));
        let path = home.unwrap_or_else(|| path.into());
        let beside = self.folder.as_deref().map_or_else(|| path.clone(), |folder| folder.join(&path));
        let found = if !beside.exists() && path.exists() { path } else { beside };
        std::path::absolute(&found).unwrap_or(found)
    }

    /// The places in which [`resolve`](Self::resolve) looks for `path`, for messages.
    pub fn places(&self, path: &str) -> String {
        let first = self.resolve(path);
        match std::path::absolute(path) {
            Ok(here) if here != first && !path.starts_with("~/") => {
                format!("{} and {}", first.display(), here.display())
            }
            _ => first.display().to_string(),
        }
    }

    /// The file, as the caller named it; `scenario` for a scenario built in memory.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The text of the file when it was read. It does not have the caller's changes. Empty for a scenario built
    /// in memory.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// The line of a key such as `encoder.maps[0].units[1]`. If the text does not have the key, the line of the
    /// innermost table around it that the text has.
    pub(super) fn line_of(&self, key: &str) -> Option<usize> {
        let document = DeTable::parse(&self.text).ok()?;
        let (start, _, _) = follow(document.get_ref(), key)?;
        Some(line_at(&self.text, start))
    }

    /// The value of a top-level whole number in the text.
    pub(super) fn whole_number(&self, key: &str) -> Option<u64> {
        let document = DeTable::parse(&self.text).ok()?;
        let number = document.get_ref().get(key)?.get_ref().as_integer()?;
        u64::from_str_radix(number.as_str(), number.radix()).ok()
    }
}

/// Whether a program is given by its path, and not by a name that is looked for in `PATH`.
fn is_path(program: &str) -> bool {
    program.contains('/')
}

impl super::Scenario {
    /// Locates a program that the scenario names: by its path, beside this program, or in `PATH`.
    ///
    /// # Errors
    ///
    /// A sentence that says where it was looked for.
    pub fn find_program(&self, program: &str) -> Result<PathBuf, String> {
        let found = if is_path(program) {
            Some(self.source.resolve(program)).filter(|path| path.is_file())
        } else {
            crate::programs::find(program)
        };
        found.ok_or_else(|| match is_path(program) {
            true => format!("no such file; looked for {}", self.source.places(program)),
            false => "no such program beside `tectum` or in PATH; build all of them with `cargo build --release`, or \
                      name your own program by its path"
                .to_owned(),
        })
    }

    /// Arguments of a program. Those that are files beside the scenario get their whole path.
    pub fn resolve_arguments(&self, arguments: &[String]) -> Vec<String> {
        let resolved = |argument: &String| {
            let path = self.source.folder()?.join(argument);
            (!argument.is_empty() && path.is_file()).then(|| path.to_str().map(str::to_owned))?
        };
        arguments.iter().map(|argument| resolved(argument).unwrap_or_else(|| argument.clone())).collect()
    }
}

impl Default for ScenarioSource {
    fn default() -> Self {
        Self::new("scenario", "")
    }
}

impl PartialEq for ScenarioSource {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl fmt::Debug for ScenarioSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Source").field(&self.name).finish()
    }
}

/// Follows a path such as `encoder.maps[0].units[1]` as far as it exists in the document. Returns the byte
/// offset of the last key found, its value, and whether it is the end of the path. `None` if the first key does
/// not exist.
fn follow<'d, 'i>(document: &'d DeTable<'i>, path: &str) -> Option<(usize, &'d DeValue<'i>, bool)> {
    let mut steps = path.split(['.', '[']);
    let (first, value) = document.get_key_value(steps.next()?)?;
    let (mut start, mut value) = (first.span().start, value.get_ref());
    for step in steps {
        let next = match (value, step.strip_suffix(']')) {
            (DeValue::Array(items), Some(index)) => {
                index.parse().ok().and_then(|i: usize| items.get(i)).map(|item| (item.span().start, item.get_ref()))
            }
            (DeValue::Table(table), None) => {
                table.get_key_value(step).map(|(key, value)| (key.span().start, value.get_ref()))
            }
            _ => None,
        };
        match next {
            Some(next) => (start, value) = next,
            None => return Some((start, value, false)),
        }
    }
    Some((start, value, true))
}

/// The first list in place of a table, as path and byte offset. serde would accept it and assign its entries to
/// the table's keys in the order of their declaration, which is never intended.
pub(super) fn list_for_table(document: &DeTable<'_>) -> Option<(String, usize)> {
    const TABLES: [&str; 24] = [
        "plant",
        "plant.arm",
        "plant.arm.reward",
        "plant.eye",
        "plant.pendulum",
        "plant.cart-pole",
        "plant.reacher",
        "plant.furuta",
        "plant.point-mass",
        "plant.so101",
        "plant.leader",
        "plant.timing",
        "controller",
        "encoder",
        "policy",
        "learner",
        "learner.baseline",
        "learner.critic",
        "learner.model",
        "gate",
        "log",
        "channels",
        "overrun",
        "faults",
    ];
    const LISTS_OF_TABLES: [&str; 9] = [
        "plant.inputs",
        "plant.outputs",
        "plant.arm.block",
        "plant.arm.shorten",
        "plant.arm.mirror",
        "plant.arm.payload",
        "encoder.maps",
        "faults.channel",
        "faults.process",
    ];
    let table = TABLES.iter().find_map(|path| match follow(document, path)? {
        (start, DeValue::Array(_), true) => Some(((*path).to_owned(), start)),
        _ => None,
    });
    table.or_else(|| {
        LISTS_OF_TABLES.iter().find_map(|path| {
            let (_, DeValue::Array(items), true) = follow(document, path)? else { return None };
            let i = items.iter().position(|item| matches!(item.get_ref(), DeValue::Array(_)))?;
            Some((format!("{path}[{i}]"), items[i].span().start))
        })
    })
}

/// The line of a byte offset, counted from 1. For an offset past the end, the last line.
pub(super) fn line_at(text: &str, offset: usize) -> usize {
    let before = &text.as_bytes()[..offset.min(text.len())];
    1 + before.iter().filter(|&&byte| byte == b'\n').count()
}

/// The path of the key or value with this span. If several have it, the innermost one.
pub(super) fn key_at(table: &DeTable<'_>, span: &Range<usize>) -> Option<String> {
    table.iter().find_map(|(key, value)| {
        let inner = key_in(value.get_ref(), span);
        match inner {
            Some(inner) if inner.starts_with('[') => Some(format!("{}{inner}", key.get_ref())),
            Some(inner) => Some(format!("{}.{inner}", key.get_ref())),
            None => (key.span() == *span || value.span() == *span).then(|| key.get_ref().to_string()),
        }
    })
}

fn key_in(value: &DeValue<'_>, span: &Range<usize>) -> Option<String> {
    match value {
        DeValue::Table(table) => key_at(table, span),
        DeValue::Array(items) => items.iter().enumerate().find_map(|(i, item)| match key_in(item.get_ref(), span) {
            Some(inner) if inner.starts_with('[') => Some(format!("[{i}]{inner}")),
            Some(inner) => Some(format!("[{i}].{inner}")),
            None => (item.span() == *span).then(|| format!("[{i}]")),
        }),
        _ => None,
    }
}
