//! The names of the programs that the package installs and that other parts of it start or recognise.

use std::path::Path;

/// The simulated plant.
pub(crate) const SIMULATOR: &str = "tectum-simulator";
/// The controller.
pub(crate) const CONTROLLER: &str = "tectum-controller";
/// The logger.
pub(crate) const LOGGER: &str = "tectum-logger";

/// Whether the plant's program is the package's simulator, in whatever folder it is installed.
pub(crate) fn is_simulator(program: &str) -> bool {
    Path::new(program).file_name().is_some_and(|name| name == SIMULATOR)
}
