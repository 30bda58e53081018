//! Exports that the Python package makes: it has pyarrow, which is too large for this program.

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use tectum::runtime::exit;

/// The environment variable that names the interpreter.
const PYTHON_VARIABLE: &str = "TECTUM_PYTHON";

/// What is exported.
pub enum PythonExport {
    /// A LeRobotDataset.
    LeRobot,
    /// The table of the channel with this name.
    Parquet(String),
}

/// Exports the log `given`, whose files are `segments`, to `out`. The exit code is that of the Python program.
///
/// # Errors
/// One sentence, if there is no Python, or it has no package `tectum`.
pub fn export_with_python(
    given: &Path,
    segments: &[PathBuf],
    export: &PythonExport,
    out: &Path,
) -> Result<ExitCode, String> {
    let python = std::env::var_os(PYTHON_VARIABLE).unwrap_or_else(|| "python3".into());
    let needs = format!(
        "this export needs the Python packages tectum and pyarrow, and {} lacks them; install them with pip install \
         ./python pyarrow, or name another interpreter in {PYTHON_VARIABLE}",
        python.display()
    );
    let has_package = Command::new(&python).args(["-c", "import pyarrow, tectum.export_lerobot"]).output();
    if !has_package.is_ok_and(|output| output.status.success()) {
        return Err(needs);
    }
    // The package finds a run by the same rules, but reads a single file where one is given.
    let log = if given.is_file() { given } else { segments[0].parent().unwrap_or(given) };
    let mut command = Command::new(&python);
    match export {
        PythonExport::LeRobot => command.args(["-m", "tectum.export_lerobot"]).arg(log).arg(out),
        PythonExport::Parquet(channel) => command.args(["-m", "tectum.export_parquet"]).arg(log).arg(out).arg(channel),
    };
    let status = command.status().map_err(|error| format!("{} cannot be started: {error}", python.display()))?;
    Ok(match status.code() {
        Some(0) => ExitCode::SUCCESS,
        Some(2) => ExitCode::from(exit::INPUT),
        _ => ExitCode::from(exit::ERROR),
    })
}
