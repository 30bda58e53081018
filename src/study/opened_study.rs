//! A study with its file of rows and its folder, from before its first run until its results are written.

use std::path::Path;

use super::StudyError;
use super::study_rows::{ROWS_FILE, StudyHead, StudyPlace, StudyRows};
use crate::supervise::RunFolder;

/// The rows of a study, and its folder, unless it is only a part.
#[derive(Debug)]
pub(super) struct OpenedStudy {
    pub rows: StudyRows,
    pub folder: Option<RunFolder>,
}

impl OpenedStudy {
    /// Opens rows and folder. Without `out` the folder is `runs/<name>-<n>`.
    ///
    /// # Errors
    /// When one of them cannot be used, or the rows are those of another study.
    pub fn open(place: &StudyPlace, out: Option<&Path>, name: &str, head: StudyHead) -> Result<Self, StudyError> {
        if let StudyPlace::Part(path) = place {
            return Ok(Self { rows: StudyRows::open(path, head)?, folder: None });
        }
        // Before the rows are read: a place that cannot be written is reported at once.
        let folder = RunFolder::create(out, None, name)?;
        let rows = match place {
            StudyPlace::Merge(paths) => StudyRows::merged(paths)?,
            _ => StudyRows::open(&folder.path().join(ROWS_FILE), head)?,
        };
        Ok(Self { rows, folder: Some(folder) })
    }
}

impl Drop for OpenedStudy {
    /// A folder with rows stays, so that the study can go on. One without any leaves nothing behind.
    fn drop(&mut self) {
        let Some(folder) = self.folder.as_ref().filter(|_| self.rows.is_open()) else { return };
        if self.rows.count() > 0 {
            folder.keep();
        } else {
            let _ = std::fs::remove_file(self.rows.path());
        }
    }
}
