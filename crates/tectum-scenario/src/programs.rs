//! Names of the installed programs that the launcher starts. The scenario's checks must recognise simulator and
//! controller, because some tables belong to them.

use std::path::{Path, PathBuf};

/// The simulated plant.
pub const SIMULATOR: &str = "tectum-simulator";
/// The controller.
pub const CONTROLLER: &str = "tectum-controller";
/// The logger.
pub const LOGGER: &str = "tectum-logger";

/// Whether the plant's program is the package's simulator. Only the file name counts, not the folder.
pub fn is_simulator(program: &str) -> bool {
    is_named(program, SIMULATOR)
}

/// Whether the controller's program is the package's own. Only the file name counts, not the folder.
pub fn is_shipped_controller(program: &str) -> bool {
    is_named(program, CONTROLLER)
}

fn is_named(program: &str, name: &str) -> bool {
    Path::new(program).file_name().is_some_and(|file| file == name)
}

/// Locates a program: given by path, beside this program, or in `PATH`. Cargo puts tests and examples into folders of
/// their own below that of the programs; for these, beside is there.
pub fn find(name: &str) -> Option<PathBuf> {
    if name.contains('/') {
        return Some(PathBuf::from(name)).filter(|p| p.is_file());
    }
    let exe = std::env::current_exe().ok();
    let folder = exe.as_deref().and_then(Path::parent).map(|folder| match folder.file_name() {
        Some(last) if last == "deps" || last == "examples" => folder.parent().unwrap_or(folder),
        _ => folder,
    });
    let beside = folder.map(|folder| folder.join(name));
    let path = std::env::var_os("PATH").unwrap_or_default();
    beside.into_iter().chain(std::env::split_paths(&path).map(|folder| folder.join(name))).find(|p| p.is_file())
}
