//! `tectum merge` and `--continue`: studies from the rows that they have left.

use std::path::{Path, PathBuf};

use super::compare::{Comparison, compare};
use super::reproduce::{ReproduceSettings, arm, eye, open_loop, outlook};
use super::study_rows::{ROWS_FILE, StudyRows, read, rows_file};
use super::sweep::{Sweep, sweep};
use super::{StudyEnd, StudyError, StudyHead, StudyPlace};

/// A study that is done, as it is printed.
#[derive(Debug, Clone, PartialEq)]
pub struct MergedStudy {
    /// The result as one JSON object.
    pub json: String,
    /// The result as a table for people.
    pub text: String,
}

/// Makes the result of a study from the rows in `files`: the tables and figures that one process would have made.
/// Without `out` they are in a folder of the study's own.
///
/// # Errors
/// When the files are of different studies or builds, have different results of a run, or do not have all runs.
pub fn merge(files: &[PathBuf], out: Option<&Path>) -> Result<MergedStudy, StudyError> {
    let files: Vec<PathBuf> = files.iter().map(|path| rows_file(path)).collect();
    let head = StudyRows::merged(&files)?.head;
    study_of(&head, StudyPlace::Merge(files), out, true)
}

/// Goes on with the study in `folder`, which a signal ended, or whose machine went down.
///
/// # Errors
/// When there is no such study, or as for the study itself.
pub fn continue_study(folder: &Path, study: &str, progress: bool) -> Result<MergedStudy, StudyError> {
    let folder = crate::run_folder::find(folder, |folder| folder.join(ROWS_FILE).exists());
    let path = folder.join(ROWS_FILE);
    if !path.exists() {
        let text =
            format!("{} is not the folder of a study that was interrupted; it has no {ROWS_FILE}", folder.display());
        return Err(StudyError::Asked(text));
    }
    let (head, _) = read(&path)?;
    if head.study.split(' ').next() != Some(study) {
        let text = format!("{} is the folder of tectum {}, not of tectum {study}", folder.display(), head.study);
        return Err(StudyError::Asked(text));
    }
    study_of(&head, StudyPlace::Folder, Some(&folder), progress)
}

/// Makes the study whose rows have the first line `head`.
pub(super) fn study_of(
    head: &StudyHead,
    place: StudyPlace,
    out: Option<&Path>,
    progress: bool,
) -> Result<MergedStudy, StudyError> {
    let out = out.map(Path::to_owned);
    let end = match head.study.split_once(' ') {
        None if head.study == "compare" => {
            let comparison = Comparison { out, progress, ..Comparison::of_head(head, place)? };
            compare(&comparison)?.map(|r| MergedStudy { json: r.to_json(), text: r.to_text() })
        }
        None if head.study == "sweep" => {
            let wanted = Sweep { out, progress, ..Sweep::of_head(head, place)? };
            sweep(&wanted)?.map(|r| MergedStudy { json: r.to_json(), text: r.to_text() })
        }
        Some(("reproduce", experiment)) => {
            let settings = ReproduceSettings { out, progress, ..ReproduceSettings::of_head(head, place)? };
            match experiment {
                "arm" => arm(&settings)?.map(|r| MergedStudy { json: r.to_json(), text: r.to_text() }),
                "eye" => eye(&settings)?.map(|r| MergedStudy { json: r.to_json(), text: r.to_text() }),
                "open-loop" => open_loop(&settings)?.map(|r| MergedStudy { json: r.to_json(), text: r.to_text() }),
                "outlook" => outlook(&settings)?.map(|r| MergedStudy { json: r.to_json(), text: r.to_text() }),
                _ => return Err(unknown(&head.study)),
            }
        }
        _ => return Err(unknown(&head.study)),
    };
    Ok(match end {
        StudyEnd::Whole(merged) => merged,
        StudyEnd::Part(part) => MergedStudy { json: part.to_json(), text: part.to_text() },
    })
}

fn unknown(study: &str) -> StudyError {
    StudyError::Asked(format!("there is no study {study:?}; the rows are of another version of tectum"))
}
