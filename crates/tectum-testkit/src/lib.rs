//! Starts the real programs of a Tectum run in a test: your plant, your controller, and all that belongs to a run.
//!
//! A test makes a [`TestFolder`], starts `tectum run` in it, waits for what it wants to see, kills or stops processes,
//! and looks at the outcome: exit code, summary, log, and what is left in shared memory. Every run has an iceoryx2
//! domain of its own, so tests run in parallel. No wait sleeps and hopes: each looks for the event itself. A watchdog
//! ends a test that hangs, and a test that fails prints what the processes wrote.
//!
//! ```no_run
//! use tectum_testkit::{ScenarioFile, TestFolder};
//!
//! let folder = TestFolder::new();
//! let scenario = ScenarioFile::read("scenario.toml")
//!     .set("plant.program", "target/debug/my-plant") // in a test: env!("CARGO_BIN_EXE_my-plant")
//!     .set("restart.backoff_ms", 1);
//! let scenario = folder.write_scenario(&scenario);
//!
//! let mut run = folder.run(&[&scenario, "--ticks", "20000", "--json"]);
//! run.wait_until_tick(1000);
//! run.kill_child("my-plant");
//! let outcome = run.wait().expect(0);
//!
//! assert_eq!(outcome.json()["restarts"][0]["process"], "plant");
//! assert_eq!(folder.log().unwrap().observations.len(), 20000);
//! folder.assert_no_debris();
//! ```
//!
//! | item | what it is for |
//! |---|---|
//! | [`TestFolder`] | a fresh folder; starts runs and other programs in it |
//! | [`ScenarioFile`] | a scenario with other values for some keys |
//! | [`Process`] | a started program: waits, signals, its children |
//! | [`ProcessOutcome`] | exit code and output |
//! | [`LogContent`] | all samples of a log |
//! | [`check_plant`] | what every run relies on in a plant, checked in this process |
//! | [`find_program`] | where Tectum's programs are looked for: in short, build or install them, or set `TECTUM_BIN` |
//!
//! For tests of the numbers alone no process is needed: [`tectum::runtime::in_process()`] runs the same ticks in one
//! thread.
//!
//! Helpers panic with a message that says what to do, because a test can do nothing else.

#![warn(missing_docs)]

mod log_content;
mod plant_check;
mod process;
mod programs;
mod scenario_file;
mod shared_memory;
mod signals;
mod test_folder;

pub use log_content::LogContent;
pub use plant_check::check_plant;
pub use process::{Process, ProcessOutcome};
pub use programs::{PROGRAMS_VARIABLE, ProgramNotFound, find_program, program};
pub use scenario_file::ScenarioFile;
pub use shared_memory::{assert_no_debris, domain, shared_memory};
pub use signals::{children, has_ended, signal_process, stop_process_for};
pub use test_folder::{KEEP_VARIABLE, TestFolder, WATCHDOG, read_json};
