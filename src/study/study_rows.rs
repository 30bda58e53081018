//! The runs of a study that are done, as rows of a file: what is kept when a study is interrupted, and what the parts
//! of a study on many machines are put together from.
//!
//! A file of rows is JSON lines. The first line says of which study it is ([`StudyHead`]). Each other line is a run
//! that is done: its name, the machine, the seconds that it took, its result, and a checksum. A row is synced to the
//! disk before the next run begins on its core. A row that was cut off, because the machine or the process died while
//! it was written, is dropped when the file is opened again; every other damage is an error that names the line.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read as _, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use xxhash_rust::xxh3::xxh3_64;

use super::StudyError;
use crate::clock::machine_facts;

/// Name of the file of rows in a study's folder.
pub(super) const ROWS_FILE: &str = "rows.jsonl";
/// Version of the format.
const FORMAT: u32 = 1;
/// The field of a result that holds times, as of [`compare`](super::compare).
const TIMES: &str = "costs";

/// The file of rows that `path` stands for: a study's folder stands for its rows.
pub(super) fn rows_file(path: &Path) -> PathBuf {
    if path.is_dir() { path.join(ROWS_FILE) } else { path.to_owned() }
}

/// Seeds from the first to before the last.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct SeedRange {
    /// The first seed.
    pub first: u64,
    /// The seed behind the last.
    pub end: u64,
}

impl SeedRange {
    /// The seeds in order.
    pub fn seeds(self) -> Vec<u64> {
        (self.first..self.end).collect()
    }

    /// `A..B`, as on the command line.
    pub fn text(self) -> String {
        format!("{}..{}", self.first, self.end)
    }
}

/// Which study a file of rows belongs to: its first line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StudyHead {
    /// Version of the format.
    pub(super) format: u32,
    /// The study: `compare`, `reproduce arm`, `sweep`, ...
    pub study: String,
    /// Everything that its results depend on beside the seeds, with the scenarios in full.
    pub definition: Value,
    /// Hash of the definition, hexadecimal.
    pub hash: String,
    /// Where scenarios stand on the machine that made the file: needed to go on with it, and no part of the study.
    pub origin: Value,
    /// The seeds that this file is to have.
    pub seeds: SeedRange,
    /// Build of the program that makes the runs.
    pub build: String,
}

impl StudyHead {
    pub(super) fn new(study: &str, definition: Value, origin: Value, seeds: SeedRange) -> Self {
        let hash = format!("{:016x}", xxh3_64(definition.to_string().as_bytes()));
        let build = crate::BUILD.to_owned();
        Self { format: FORMAT, study: study.to_owned(), definition, hash, origin, seeds, build }
    }

    /// What makes rows of `other` no rows of this study; `None` if nothing does. The seeds may be others.
    pub(super) fn difference(&self, other: &Self) -> Option<String> {
        let pair = [("study", &self.study, &other.study), ("build", &self.build, &other.build)];
        let of = |what, a, b| format!("its {what} is {b}, and not {a}");
        if let Some((what, a, b)) = pair.into_iter().find(|(_, a, b)| a != b) {
            return Some(of(what, a, b));
        }
        if self.definition == other.definition {
            return None;
        }
        let empty = serde_json::Map::new();
        let [ours, theirs] = [self, other].map(|head| head.definition.as_object().unwrap_or(&empty));
        let keys = ours.keys().chain(theirs.keys());
        let key = keys.into_iter().find(|key| ours.get(*key) != theirs.get(*key));
        Some(match key {
            Some(key) => {
                let [a, b] = [ours, theirs].map(|map| map.get(key).map_or("none".to_owned(), short));
                of(key, &a, &b)
            }
            None => "it has other settings".to_owned(),
        })
    }
}

/// A value for a message; a long one by its hash.
fn short(value: &Value) -> String {
    let text = value.to_string();
    if text.len() <= 60 { text } else { format!("another one (hash {:016x})", xxh3_64(text.as_bytes())) }
}

/// A run that is done.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct StudyRow {
    /// Name of the run: learner or variant, and seed.
    pub job: String,
    /// The machine on which it ran.
    host: String,
    /// Seconds that it took there.
    seconds: f64,
    /// What came of it.
    pub result: Value,
    /// Checksum over name and result, hexadecimal.
    check: String,
}

impl StudyRow {
    fn sum(job: &str, result: &Value) -> String {
        format!("{:016x}", xxh3_64(format!("{job}\n{result}").as_bytes()))
    }
}

/// The runs of a study that are done.
#[derive(Debug)]
pub(crate) struct StudyRows {
    pub head: StudyHead,
    path: PathBuf,
    /// The file, open for more rows; `None` for rows that were put together from several files.
    file: Option<Mutex<File>>,
    host: String,
    done: Mutex<BTreeMap<String, Value>>,
}

impl StudyRows {
    /// Opens the file of rows at `path` to go on with it, or makes it.
    ///
    /// # Errors
    /// When it is of another study, or damaged, or cannot be written, or another process writes to it.
    pub fn open(path: &Path, head: StudyHead) -> Result<Self, StudyError> {
        let failed = |error| StudyError::Write { path: path.to_owned(), error };
        let mut file =
            File::options().read(true).write(true).create(true).truncate(false).open(path).map_err(failed)?;
        match file.try_lock() {
            Err(std::fs::TryLockError::WouldBlock) => {
                let text = format!("{}: another process writes to it; give each a file of its own", path.display());
                return Err(StudyError::Asked(text));
            }
            // A file system without locks has none.
            Ok(()) | Err(std::fs::TryLockError::Error(_)) => {}
        }
        let mut text = Vec::new();
        file.read_to_end(&mut text).map_err(failed)?;
        let (found, rows, whole) = parse(path, &text)?;
        let mut head = head;
        match found {
            Some(found) => {
                if let Some(difference) = head.difference(&found) {
                    let text = format!("{} is of another study: {difference}; give another file", path.display());
                    return Err(StudyError::Asked(text));
                }
                head.seeds = SeedRange {
                    first: head.seeds.first.min(found.seeds.first),
                    end: head.seeds.end.max(found.seeds.end),
                };
                // Behind the last whole row.
                file.set_len(whole as u64).map_err(failed)?;
                file.seek(SeekFrom::Start(whole as u64)).map_err(failed)?;
            }
            None => {
                file.set_len(0).map_err(failed)?;
                file.rewind().map_err(failed)?;
                let line = serde_json::to_string(&head).unwrap_or_default() + "\n";
                file.write_all(line.as_bytes()).and_then(|()| file.sync_all()).map_err(failed)?;
            }
        }
        let done = rows.into_iter().map(|row| (row.job, row.result)).collect();
        let host = machine_facts().remove("host").unwrap_or_default();
        Ok(Self { head, path: path.to_owned(), file: Some(Mutex::new(file)), host, done: Mutex::new(done) })
    }

    /// Reads the rows of several files, which must be of one study. A run may be in more than one of them if the
    /// results are the same.
    ///
    /// # Errors
    /// When a file cannot be read, is damaged, or is of another study or build, or when two results of a run differ.
    pub fn merged(paths: &[PathBuf]) -> Result<Self, StudyError> {
        let mut merged: Option<Self> = None;
        let mut from: BTreeMap<String, PathBuf> = BTreeMap::new();
        for path in paths {
            let (head, rows) = read(path)?;
            let all = merged.get_or_insert_with(|| Self {
                head: head.clone(),
                path: path.clone(),
                file: None,
                host: String::new(),
                done: Mutex::default(),
            });
            if let Some(difference) = all.head.difference(&head) {
                let (path, first) = (path.display(), all.path.display());
                return Err(StudyError::Asked(format!("{path} does not belong to {first}: {difference}")));
            }
            all.head.seeds.first = all.head.seeds.first.min(head.seeds.first);
            all.head.seeds.end = all.head.seeds.end.max(head.seeds.end);
            let done = all.done.get_mut().unwrap_or_else(std::sync::PoisonError::into_inner);
            for StudyRow { job, result, .. } in rows {
                let other = done.get(&job).map(without_times);
                if let Some(other) = other.filter(|other| *other != without_times(&result)) {
                    let (a, b) = (from[&job].display(), path.display());
                    let where_ = first_difference("", &other, &without_times(&result)).unwrap_or_default();
                    let text = format!("{a} and {b} have different results of {job}: {where_}; one of them is wrong");
                    return Err(StudyError::Asked(text));
                }
                from.insert(job.clone(), path.clone());
                done.insert(job, result);
            }
        }
        let mut merged = merged.ok_or_else(|| StudyError::Asked("there is no file to merge".to_owned()))?;
        if merged.head.build != crate::BUILD {
            let (theirs, ours) = (&merged.head.build, crate::BUILD);
            let text = format!("{} is of build {theirs}, and this is {ours}; merge with that", merged.path.display());
            return Err(StudyError::Asked(text));
        }
        merged.host = String::new();
        Ok(merged)
    }

    /// The result of a run, if it is done.
    pub fn get<T: DeserializeOwned>(&self, job: &str) -> Result<Option<T>, StudyError> {
        let done = self.done.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let Some(result) = done.get(job) else { return Ok(None) };
        serde_json::from_value(result.clone()).map(Some).map_err(|error| {
            StudyError::Asked(format!("{}: the result of {job} cannot be read: {error}", self.path.display()))
        })
    }

    /// Keeps the result of a run that took `seconds`: it is on the disk when this returns.
    pub fn put<T: Serialize>(&self, job: &str, seconds: f64, result: &T) -> Result<(), StudyError> {
        let Some(file) = &self.file else { return Ok(()) };
        let failed = |error: std::io::Error| StudyError::Write { path: self.path.clone(), error };
        let result = serde_json::to_value(result).map_err(|error| failed(error.into()))?;
        let check = StudyRow::sum(job, &result);
        let row = StudyRow { job: job.to_owned(), host: self.host.clone(), seconds, result, check };
        let line = serde_json::to_string(&row).map_err(|error| failed(error.into()))? + "\n";
        let mut file = file.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        file.write_all(line.as_bytes()).and_then(|()| file.sync_data()).map_err(failed)?;
        self.done.lock().unwrap_or_else(std::sync::PoisonError::into_inner).insert(row.job, row.result);
        Ok(())
    }

    /// Whether more runs can be made for it.
    pub fn is_open(&self) -> bool {
        self.file.is_some()
    }

    /// Number of runs that are done.
    pub fn count(&self) -> usize {
        self.done.lock().unwrap_or_else(std::sync::PoisonError::into_inner).len()
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

/// The head and the rows of a file.
pub(super) fn read(path: &Path) -> Result<(StudyHead, Vec<StudyRow>), StudyError> {
    let text = std::fs::read(path)
        .map_err(|error| StudyError::Asked(format!("{} cannot be read: {error}", path.display())))?;
    let (head, rows, _) = parse(path, &text)?;
    let none = || StudyError::Asked(format!("{} holds no rows of a study", path.display()));
    Ok((head.ok_or_else(none)?, rows))
}

/// The head, the rows, and the number of bytes up to the end of the last whole row. No head in an empty file, or in one
/// whose first line was cut off.
fn parse(path: &Path, text: &[u8]) -> Result<(Option<StudyHead>, Vec<StudyRow>, usize), StudyError> {
    let mut head = None;
    let (mut rows, mut whole) = (Vec::new(), 0);
    for (number, line) in text.split_inclusive(|&byte| byte == b'\n').enumerate() {
        if line.last() != Some(&b'\n') {
            break;
        }
        let damaged = |why: String| {
            let (path, line) = (path.display(), number + 1);
            StudyError::Asked(format!("{path}:{line} is damaged: {why}; take the line out, and the run is made again"))
        };
        if number == 0 {
            let found: StudyHead = serde_json::from_slice(line).map_err(|_| {
                StudyError::Asked(format!("{} holds no rows of a study of this version of tectum", path.display()))
            })?;
            head = Some(found);
        } else {
            let row: StudyRow = serde_json::from_slice(line).map_err(|error| damaged(error.to_string()))?;
            if row.check != StudyRow::sum(&row.job, &row.result) {
                return Err(damaged("its checksum does not fit".to_owned()));
            }
            rows.push(row);
        }
        whole += line.len();
    }
    Ok((head, rows, whole))
}

/// A result without what the clock has said, which differs from machine to machine.
pub(super) fn without_times(result: &Value) -> Value {
    let mut result = result.clone();
    if let Some(fields) = result.as_object_mut() {
        fields.remove(TIMES);
    }
    result
}

/// Where two results part first: a path and both values.
pub(super) fn first_difference(at: &str, a: &Value, b: &Value) -> Option<String> {
    if a == b {
        return None;
    }
    match (a, b) {
        (Value::Object(x), Value::Object(y)) if x.keys().eq(y.keys()) => {
            x.iter().find_map(|(key, value)| first_difference(&format!("{at}.{key}"), value, &y[key]))
        }
        (Value::Array(x), Value::Array(y)) if x.len() == y.len() => {
            x.iter().zip(y).enumerate().find_map(|(i, (x, y))| first_difference(&format!("{at}[{i}]"), x, y))
        }
        _ => Some(format!("{} is {a} and {b}", at.trim_start_matches('.'))),
    }
}

/// Where the rows of a study come from and go to.
#[derive(Debug, Clone, Default)]
pub enum StudyPlace {
    /// Into the study's folder, which then has the results, too.
    #[default]
    Folder,
    /// Into this file, and no results are made of them.
    Part(PathBuf),
    /// From these files, all of them: no run is made.
    Merge(Vec<PathBuf>),
}

/// How a study ended: with its result, or with a part of its runs.
#[derive(Debug)]
pub enum StudyEnd<R> {
    /// All of it is done.
    Whole(R),
    /// A part is done.
    Part(StudyPart),
}

impl<R> StudyEnd<R> {
    /// The same end with another result.
    pub fn map<S>(self, change: impl FnOnce(R) -> S) -> StudyEnd<S> {
        match self {
            Self::Whole(result) => StudyEnd::Whole(change(result)),
            Self::Part(part) => StudyEnd::Part(part),
        }
    }
}

/// A part of a study that is done.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StudyPart {
    /// The study.
    pub study: String,
    /// Its file of rows.
    pub part: PathBuf,
    /// The seeds in it.
    pub seeds: SeedRange,
    /// Number of runs in it.
    pub runs: usize,
}

impl StudyPart {
    pub(super) fn of(rows: &StudyRows) -> Self {
        let StudyHead { study, seeds, .. } = &rows.head;
        Self { study: study.clone(), part: rows.path.clone(), seeds: *seeds, runs: rows.count() }
    }

    /// One JSON object.
    pub fn to_json(&self) -> String {
        json!(self).to_string()
    }

    /// One line for people.
    pub fn to_text(&self) -> String {
        let (seeds, part) = (self.seeds.text(), self.part.display());
        format!("{}, seeds {seeds}: {} runs in {part}; tectum merge puts parts together\n", self.study, self.runs)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn head(seeds: (u64, u64)) -> StudyHead {
        StudyHead::new("test", json!({"ticks": 5}), Value::Null, SeedRange { first: seeds.0, end: seeds.1 })
    }

    #[test]
    fn rows_are_there_when_the_file_is_opened_again_and_a_torn_one_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("rows.jsonl");
        let rows = StudyRows::open(&path, head((1, 3))).unwrap();
        rows.put("a 1", 0.5, &json!({"x": 1.5})).unwrap();
        rows.put("a 2", 0.5, &json!({"x": 2.5})).unwrap();
        assert!(StudyRows::open(&path, head((1, 3))).unwrap_err().to_string().contains("another process writes to it"));
        drop(rows);
        let whole = std::fs::read(&path).unwrap();
        for cut in 0..whole.len() {
            std::fs::write(&path, &whole[..cut]).unwrap();
            let rows = StudyRows::open(&path, head((1, 3))).unwrap();
            let lines = whole[..cut].iter().filter(|&&byte| byte == b'\n').count();
            assert_eq!(rows.count(), lines.saturating_sub(1), "cut at {cut}");
            rows.put("a 9", 0.1, &json!(1)).unwrap();
            assert_eq!(read(&path).unwrap().1.len(), lines.saturating_sub(1) + 1);
        }
        let mut flipped = whole.clone();
        let at = flipped.len() - 40;
        flipped[at] ^= 1;
        std::fs::write(&path, flipped).unwrap();
        let error = StudyRows::open(&path, head((1, 3))).unwrap_err().to_string();
        assert!(error.contains("rows.jsonl:3 is damaged"), "{error}");
        std::fs::write(&path, whole).unwrap();
        let other = StudyHead::new("test", json!({"ticks": 6}), Value::Null, SeedRange { first: 1, end: 3 });
        let error = StudyRows::open(&path, other).unwrap_err().to_string();
        assert!(error.contains("is of another study: its ticks is 5, and not 6"), "{error}");
    }

    #[test]
    fn rows_of_several_files_are_put_together_if_they_agree() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str, seeds, x: f64| {
            let path = folder.path().join(name);
            let rows = StudyRows::open(&path, head(seeds)).unwrap();
            (seeds.0..seeds.1).for_each(|seed| rows.put(&format!("a {seed}"), 0.1, &json!({"x": x})).unwrap());
            path
        };
        let (a, b, c) = (file("a", (1, 3), 1.5), file("b", (2, 5), 1.5), file("c", (2, 3), 2.5));
        let merged = StudyRows::merged(&[a.clone(), b]).unwrap();
        assert_eq!((merged.count(), merged.head.seeds.text()), (4, "1..5".to_owned()));
        assert_eq!(merged.get::<Value>("a 4").unwrap(), Some(json!({"x": 1.5})));
        let error = StudyRows::merged(&[a, c]).unwrap_err().to_string();
        assert!(error.contains("have different results of a 2: x is 1.5 and 2.5; one of them is wrong"), "{error}");
    }
}
