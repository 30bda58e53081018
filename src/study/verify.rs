//! `tectum compare --verify`: whether two results of a study are equal bit for bit, or whether one is what this machine
//! makes of it.
//!
//! Results are compared run by run, as the rows of the files hold them: exact numbers, and whatever hash the study
//! keeps, but no times. Of one result alone a share of the seeds is made again. Which seeds follows from the study's
//! definition: two checks make the same ones, and a check of a larger share makes them, too.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::{Value, json};
use xxhash_rust::xxh3::xxh3_64;

use super::merge::study_of;
use super::study_rows::{ROWS_FILE, StudyRow, first_difference, read, rows_file, without_times};
use super::{SeedRange, StudyError, StudyHead, StudyPlace};
use crate::runtime::exit;

/// Most differing runs that are listed.
const LISTED: usize = 20;

/// What a verification found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Verification {
    /// The study.
    pub study: String,
    /// The builds that made the two results.
    pub builds: [String; 2],
    /// Seeds that were made again; empty where two results were given.
    pub made_again: Vec<u64>,
    /// Runs that are in both results.
    pub compared: usize,
    /// Those of them that are equal, bit for bit.
    pub equal: usize,
    /// Runs that only the first result has, and runs that only the second has.
    pub alone: [usize; 2],
    /// The first runs that differ, and where.
    pub differences: Vec<RunDifference>,
}

/// A run whose two results differ.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct RunDifference {
    /// Name of the run.
    pub run: String,
    /// Where its results part first, with both values.
    pub at: String,
}

impl Verification {
    /// Whether all runs that were compared are equal.
    pub fn holds(&self) -> bool {
        self.compared == self.equal
    }

    /// One JSON object.
    pub fn to_json(&self) -> String {
        let mut object = json!(self);
        object["holds"] = Value::Bool(self.holds());
        object.to_string()
    }

    /// Some lines for people.
    pub fn to_text(&self) -> String {
        let Self { study, compared, equal, alone: [first, second], .. } = self;
        let mut text = format!("{study}: {equal} of {compared} runs are equal, bit for bit");
        match &self.made_again[..] {
            [] if first + second > 0 => {
                text += &format!("; {first} runs are only in the first result, {second} only in the second");
            }
            [] => {}
            seeds => {
                let seeds: Vec<_> = seeds.iter().map(u64::to_string).collect();
                text += &format!("; made again: seeds {}", seeds.join(", "));
            }
        }
        text += "\n";
        for RunDifference { run, at } in &self.differences {
            text += &format!("{run}: {at}\n");
        }
        let more = compared - equal - self.differences.len();
        text + &if more > 0 { format!("and {more} more\n") } else { String::new() }
    }
}

/// Compares the result in the first of `files` with the runs in all others; with no others, with `share` of its seeds
/// (at least one) made again here. A study's folder stands for its rows.
///
/// # Errors
/// When a file cannot be read or is damaged, the files are of different studies or have no run in common, or the share
/// is not between 0 and 1; when runs are made again, as for the study itself.
pub fn verify(files: &[PathBuf], share: f64, progress: bool) -> Result<Verification, StudyError> {
    let files: Vec<PathBuf> = files.iter().map(|path| rows_file(path)).collect();
    let (path, others) = files.split_first().ok_or_else(|| StudyError::Asked("there is no file to verify".into()))?;
    let (head, rows) = read(path)?;
    let first = results(rows);
    if others.is_empty() {
        let folder = tempfile::tempdir().map_err(|error| StudyError::Write { path: std::env::temp_dir(), error })?;
        let again = folder.path().join(ROWS_FILE);
        let seeds = sample(&head, share)?;
        make_again(&head, &seeds, &again, progress)?;
        let (other, rows) = read(&again)?;
        let second = results(rows);
        return Ok(Verification { made_again: seeds, alone: [0, 0], ..compare([&head, &other], &first, &second)? });
    }
    let (mut second, mut build) = (BTreeMap::new(), String::new());
    for other in others {
        let (found, rows) = read(other)?;
        let any_build = StudyHead { build: head.build.clone(), ..found.clone() };
        if let Some(difference) = head.difference(&any_build) {
            let text = format!("{} is not of the study of {}: {difference}", other.display(), path.display());
            return Err(StudyError::Asked(text));
        }
        build = found.build;
        second.extend(results(rows));
    }
    compare([&head, &StudyHead { build, ..head.clone() }], &first, &second)
}

/// Results by run, without times.
fn results(rows: Vec<StudyRow>) -> BTreeMap<String, Value> {
    rows.into_iter().map(|row| (row.job, without_times(&row.result))).collect()
}

/// The seeds that are made again, in order: those with the least hashes.
fn sample(head: &StudyHead, share: f64) -> Result<Vec<u64>, StudyError> {
    if !(share > 0.0 && share <= 1.0) {
        return Err(StudyError::Asked(format!(
            "--sample is {share}; give a share of the seeds, above 0 and at most 1"
        )));
    }
    let mut seeds = head.seeds.seeds();
    let count = ((seeds.len() as f64 * share).ceil() as usize).clamp(1, seeds.len().max(1));
    seeds.sort_by_key(|seed| xxh3_64(format!("{} {seed}", head.hash).as_bytes()));
    seeds.truncate(count);
    seeds.sort_unstable();
    Ok(seeds)
}

/// Makes the runs of some seeds again, into the file `path`.
fn make_again(head: &StudyHead, seeds: &[u64], path: &Path, progress: bool) -> Result<(), StudyError> {
    for &seed in seeds {
        let one = StudyHead { seeds: SeedRange { first: seed, end: seed + 1 }, ..head.clone() };
        study_of(&one, StudyPlace::Part(path.to_owned()), None, progress).map_err(|error| match error {
            // The rows go away with their folder.
            StudyError::Interrupted { signal, .. } | StudyError::Signal(signal) => {
                let message = format!("ended by signal {signal}: nothing has been verified");
                StudyError::Run { code: exit::by_signal(signal), message }
            }
            error => error,
        })?;
    }
    Ok(())
}

fn compare(
    heads: [&StudyHead; 2],
    first: &BTreeMap<String, Value>,
    second: &BTreeMap<String, Value>,
) -> Result<Verification, StudyError> {
    let both = || first.iter().filter_map(|(run, a)| Some((run, a, second.get(run)?)));
    let differences =
        both().filter_map(|(run, a, b)| Some(RunDifference { run: run.clone(), at: first_difference("", a, b)? }));
    let mut differences: Vec<_> = differences.collect();
    let compared = both().count();
    if compared == 0 {
        return Err(StudyError::Asked("the results have no run in common, so there is nothing to compare".to_owned()));
    }
    let equal = compared - differences.len();
    differences.truncate(LISTED);
    let alone = [first.len() - compared, second.len() - compared];
    let builds = heads.map(|head| head.build.clone());
    Ok(Verification {
        study: heads[0].study.clone(),
        builds,
        made_again: Vec::new(),
        compared,
        equal,
        alone,
        differences,
    })
}
