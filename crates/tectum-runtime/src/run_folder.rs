//! Finds a run's folder. Runs are stored in `runs/` in the working directory, unless the user gives another
//! folder.

use std::path::{Path, PathBuf};

/// The folder of all runs for which the user gives no folder.
pub const RUNS: &str = "runs";

/// Finds the run called `given`, which is a path or a name under `runs/`. The result is `runs/<given>` if only
/// that one satisfies `exists`, and otherwise `given` itself.
pub fn find(given: &Path, exists: impl Fn(&Path) -> bool) -> PathBuf {
    let under_runs = Path::new(RUNS).join(given);
    if !exists(given) && exists(&under_runs) { under_runs } else { given.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_existing_path_takes_precedence_over_a_name_under_runs() {
        let find_among = |paths: &[&str]| find(Path::new("demo"), |path| paths.iter().any(|p| Path::new(p) == path));
        assert_eq!(find_among(&["demo", "runs/demo"]), Path::new("demo"));
        assert_eq!(find_among(&["runs/demo"]), Path::new("runs/demo"));
        assert_eq!(find_among(&[]), Path::new("demo"));
    }
}
