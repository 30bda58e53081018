//! Names of the installed programs that the launcher starts, and of the simulator, which the scenario's checks
//! must recognise.

use std::path::Path;

/// The simulated plant.
pub(crate) const SIMULATOR: &str = "tectum-simulator";
/// The controller.
pub(crate) const CONTROLLER: &str = "tectum-controller";
/// The logger.
pub(crate) const LOGGER: &str = "tectum-logger";

/// Whether the plant's program is the package's simulator. Only the file name counts, not the folder.
pub(crate) fn is_simulator(program: &str) -> bool {
    Path::new(program).file_name().is_some_and(|name| name == SIMULATOR)
}
