//! Finds Tectum's programs: `tectum` itself and the processes that it starts.

use std::path::{Path, PathBuf};

use thiserror::Error;

/// The environment variable that names the folder of Tectum's programs, or the program `tectum` in it.
pub const PROGRAMS_VARIABLE: &str = "TECTUM_BIN";

/// A program was not found.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum ProgramNotFound {
    /// [`TECTUM_BIN`](PROGRAMS_VARIABLE) names a place where the program is not.
    #[error(
        "{PROGRAMS_VARIABLE} is {named:?}, and there is no program {name:?}; name the folder that has Tectum's \
         programs, or take the variable away"
    )]
    NotWhereNamed {
        /// The program.
        name: String,
        /// The value of the variable.
        named: PathBuf,
    },
    /// It is in none of the places where it could be.
    #[error(
        "there is no program {name:?} in {places} or PATH; build Tectum's programs with `cargo build --locked` in \
         its folder and name the folder of the programs in {PROGRAMS_VARIABLE}, or install them with `cargo install \
         tectum --locked`"
    )]
    Nowhere {
        /// The program.
        name: String,
        /// The folders that were searched before `PATH`, separated by commas.
        places: String,
    },
}

/// Finds a program of Tectum, such as `tectum` or `tectum-controller`. The first of these places that has it:
///
/// 1. `TECTUM_BIN`, a folder or the path of `tectum`; if it is set, nothing else counts;
/// 2. `CARGO_BIN_EXE_<name>`, with which cargo names the programs of the package under test;
/// 3. the target folder of the running test: its own profile, then `release` and `debug`;
/// 4. the target folder of the checkout from which this crate was built;
/// 5. `PATH`.
///
/// # Errors
///
/// [`ProgramNotFound`] states what to do.
pub fn find_program(name: &str) -> Result<PathBuf, ProgramNotFound> {
    if let Some(named) = std::env::var_os(PROGRAMS_VARIABLE).map(PathBuf::from) {
        return in_named_place(&named, name);
    }
    if let Some(path) = std::env::var_os(format!("CARGO_BIN_EXE_{name}")) {
        return Ok(PathBuf::from(path));
    }
    let folders = target_folders();
    let path = std::env::var_os("PATH").unwrap_or_default();
    let found = folders.iter().cloned().chain(std::env::split_paths(&path)).map(|folder| folder.join(name));
    found.into_iter().find(|program| program.is_file()).ok_or_else(|| {
        let places: Vec<_> = folders.iter().map(|folder| folder.display().to_string()).collect();
        ProgramNotFound::Nowhere { name: name.to_owned(), places: places.join(", ") }
    })
}

/// Finds a program as [`find_program`] does.
///
/// # Panics
///
/// With the error's text if there is none. A test without its programs cannot do anything else.
#[track_caller]
pub fn program(name: &str) -> PathBuf {
    find_program(name).unwrap_or_else(|error| panic!("{error}"))
}

/// The program `name` where the value of [`PROGRAMS_VARIABLE`] says that programs are.
fn in_named_place(named: &Path, name: &str) -> Result<PathBuf, ProgramNotFound> {
    let folder = if named.is_file() { named.parent().unwrap_or(named) } else { named };
    // The launcher is started in the test's folder, where a relative path would be another.
    let program = std::path::absolute(folder.join(name)).unwrap_or_default();
    let missing = || ProgramNotFound::NotWhereNamed { name: name.to_owned(), named: named.to_owned() };
    if program.is_file() { Ok(program) } else { Err(missing()) }
}

/// The folders of target folders in which cargo puts programs, the most likely one first.
fn target_folders() -> Vec<PathBuf> {
    let mut folders = Vec::new();
    let mut add = |folder: PathBuf| {
        if !folders.contains(&folder) {
            folders.push(folder);
        }
    };
    let profile = test_profile_folder();
    if let Some(profile) = &profile {
        add(profile.clone());
    }
    let checkout = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target");
    let targets = [target_folder(), checkout.canonicalize().ok()];
    let own = profile.as_deref().and_then(Path::file_name);
    for target in targets.into_iter().flatten() {
        for profile in own.into_iter().chain(["release".as_ref(), "debug".as_ref()]) {
            add(target.join(profile));
        }
    }
    folders
}

/// The profile's folder in the running test's target folder: `target/debug` of `target/debug/deps/test-1234`. `None`
/// if cargo did not build it.
fn test_profile_folder() -> Option<PathBuf> {
    let test = std::env::current_exe().ok()?;
    let folder = test.parent()?;
    let inner = folder.file_name().is_some_and(|name| name == "deps" || name == "examples");
    inner.then(|| folder.parent()).flatten().map(Path::to_owned)
}

/// The target folder of the running test.
pub(crate) fn target_folder() -> Option<PathBuf> {
    test_profile_folder()?.parent().map(Path::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_named_place_may_be_the_folder_or_the_program() {
        let folder = tempfile::tempdir().unwrap();
        let tectum = folder.path().join("tectum");
        std::fs::write(&tectum, "").unwrap();
        assert_eq!(in_named_place(folder.path(), "tectum").as_ref(), Ok(&tectum));
        assert_eq!(in_named_place(&tectum, "tectum").as_ref(), Ok(&tectum));
        let error = in_named_place(&tectum, "tectum-logger").unwrap_err().to_string();
        assert!(error.starts_with("TECTUM_BIN is ") && error.contains("\"tectum-logger\""), "{error}");
    }

    #[test]
    fn a_program_that_is_nowhere_is_an_error_that_says_what_to_do() {
        let error = find_program("tectum-nonesuch").unwrap_err().to_string();
        assert!(error.contains("\"tectum-nonesuch\"") && error.contains("cargo install"), "{error}");
    }

    #[test]
    fn the_profile_of_the_running_test_comes_first() {
        let folders = target_folders();
        assert_eq!(std::env::current_exe().unwrap().parent().unwrap().parent().unwrap(), folders[0]);
        assert!(target_folder().is_some_and(|target| folders[0].starts_with(target)));
    }
}
