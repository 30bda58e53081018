//! Names of the installed programs that the launcher starts. The scenario's checks must recognise simulator and
//! controller, because some tables belong to them.

use std::path::Path;

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
