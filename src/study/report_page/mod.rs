//! The page of a run, or of several side by side: one HTML file that needs nothing else.
//!
//! What the page shows is collected here as plain JSON: the summary, the scenario, the figure, and from the log curves,
//! movements of an arm and histograms of latency. The page's script, which is in the file, draws it. So a page can be
//! sent to somebody who has neither Tectum nor a network.

mod log_digest;
mod run_content;

use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::{Value, json};

use crate::log::LogError;
use crate::run_folder;
use crate::text::thousands;

/// Why there is no page.
#[derive(Debug, thiserror::Error)]
pub enum ReportPageError {
    /// The folder holds no run.
    #[error("there is no run in {}: it has neither a summary.json nor a log; give the folder of a run, or its name \
             under runs/", path.display())]
    NoRun {
        /// The folder.
        path: PathBuf,
    },
    /// The log.
    #[error(transparent)]
    Log(#[from] LogError),
    /// The page cannot be written.
    #[error("{} cannot be written: {error}; choose another --out", path.display())]
    Write {
        /// The page's file.
        path: PathBuf,
        /// The error of the operating system.
        error: std::io::Error,
    },
}

/// A page that was written.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct WrittenPage {
    /// The file.
    pub file: PathBuf,
    /// Its size.
    pub bytes: usize,
    /// The folders of the runs on it.
    pub runs: Vec<PathBuf>,
}

impl WrittenPage {
    /// The object of `--json`.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    /// The result for people.
    pub fn to_text(&self) -> String {
        format!("report  {} ({} bytes)\n", self.file.display(), thousands(self.bytes as u64))
    }
}

/// Writes the page of the runs `given`, by their folders or names under `runs/`, to `out`. Without `out` it is
/// `report.html` in the run's folder, or `compare.html` in the working folder for several runs.
///
/// # Errors
/// [`ReportPageError`] if one of them is no run, its log cannot be read from the beginning, or the page cannot be
/// written.
pub fn write_page(given: &[PathBuf], out: Option<&Path>) -> Result<WrittenPage, ReportPageError> {
    let runs: Vec<PathBuf> = given.iter().map(|given| folder_of(given)).collect();
    let content = runs.iter().map(|folder| run_content::collect(folder)).collect::<Result<Vec<_>, _>>()?;
    let page = page(content);
    let file = match (out, &runs[..]) {
        (Some(out), _) => out.to_owned(),
        (None, [run]) => run.join("report.html"),
        (None, _) => PathBuf::from("compare.html"),
    };
    std::fs::write(&file, &page).map_err(|error| ReportPageError::Write { path: file.clone(), error })?;
    Ok(WrittenPage { file, bytes: page.len(), runs })
}

/// The folder of a run that is given by its folder, its name or its log.
fn folder_of(given: &Path) -> PathBuf {
    let path = run_folder::find(given, Path::exists);
    match path.parent() {
        Some(folder) if path.is_file() && folder.as_os_str().is_empty() => PathBuf::from("."),
        Some(folder) if path.is_file() => folder.to_owned(),
        _ => path,
    }
}

/// The HTML of a page that shows these runs.
fn page(runs: Vec<Value>) -> String {
    let names: Vec<&str> = runs.iter().filter_map(|run| run["name"].as_str()).collect();
    let title = escaped(&names.join(", "));
    // A text in the data must not end the script that holds it.
    let data = json!({ "build": crate::BUILD, "runs": runs }).to_string().replace('<', "\\u003c");
    // In this order: the data may hold the marks of what was replaced before.
    include_str!("page.html")
        .replacen("/*page.css*/", include_str!("page.css"), 1)
        .replacen("/*charts.js*/", include_str!("charts.js"), 1)
        .replacen("/*page.js*/", include_str!("page.js"), 1)
        .replacen("page-title", &title, 1)
        .replacen("page-data", &data, 1)
}

/// Text as HTML shows it.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_in_the_data_is_taken_for_markup() {
        let text = page(vec![json!({"name": "</script><b>&", "notes": ["/*page.js*/ page-data"]})]);
        assert_eq!(text.matches("</script>").count(), 2, "the data's and the script's");
        assert!(text.contains("<title>&lt;/script&gt;&lt;b&gt;&amp;</title>"));
        assert!(text.contains("\\u003c/script>\\u003cb>&") && text.contains("\"/*page.js*/ page-data\""));
        let policy = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'";
        assert!(text.contains(policy), "the page can ask for nothing");
    }

    #[test]
    fn what_is_no_run_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let error = write_page(&[folder.path().to_owned()], None).unwrap_err().to_string();
        assert!(error.contains("there is no run in") && error.lines().count() == 1, "{error}");
    }
}
