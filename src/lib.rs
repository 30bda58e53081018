//! Tectum is a control runtime in which a controller learns on line, while it controls.
//!
//! Plant, controller and logger run as separate processes and exchange fixed-size samples through shared memory
//! (iceoryx2) at a fixed period, on the real clock or in lockstep. Both give the same numbers as long as no
//! deadline is missed. The library is for people who study learning controllers and need numbers that they can
//! repeat. With it you connect a plant or a tracker of your own to a run, read logs, and run experiments inside
//! one process. The programs (`tectum` and the processes that it starts) are thin shells around it.
//!
//! | module | what it is for |
//! |---|---|
//! | [`scenario`] | TOML files that describe a run, and the validated [`Plan`](scenario::Plan) |
//! | [`agent`] | the trait [`Agent`](agent::Agent), which your controller implements |
//! | [`plant`] | the trait [`Plant`](plant::Plant), which your plant implements; the simulated arm and eye |
//! | [`process`] | the `main` function of a process that joins a run: arguments, errors, exit codes |
//! | [`runtime`] | the processes' loops, [`Tracker`](runtime::Tracker), [`in_process`](runtime::in_process()) |
//! | [`wire`] | the samples that processes exchange, and their flags |
//! | [`supervise`] | runs as a library call, with a handle: start, look, stop, checkpoint |
//! | [`log`] | the reader of a run's log |
//! | [`study`] | experiments of many runs, replay and analysis |
//! | [`state`], [`seed`] | what a plant saves for a restart; named random streams |
//! | [`encoder`], [`policy`], [`learner`] | the controller's pure computation: features, commands, learning rules |
//!
//! A plant of your own needs two traits. Here it runs in one process, with the same ticks as three processes in
//! lockstep. To run it as a process, hand it to [`runtime::run_plant`] in a program whose `main` is
//! [`process::main`], and name that program under `[plant]` in the scenario. `tectum new plant NAME` writes a project
//! that does; the crate `tectum-testkit` tests such processes.
//!
//! ```
//! use tectum::plant::{Outcome, Plant};
//! use tectum::runtime::in_process;
//! use tectum::scenario::{Scenario, ScenarioError};
//! use tectum::state::{Persist, StateVisitor};
//!
//! /// A point on a line, displaced every 40 ticks. It has to return to 0.
//! struct Point {
//!     position: f32,
//! }
//!
//! impl Persist for Point {
//!     fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
//!         visitor.number("position", &mut self.position);
//!     }
//! }
//!
//! impl Plant for Point {
//!     fn sense(&mut self, tick: u64, inputs: &mut [f32]) -> bool {
//!         let displaced = tick % 40 == 0;
//!         if displaced {
//!             self.position = if tick % 80 == 0 { 0.8 } else { -0.8 };
//!         }
//!         inputs[0] = self.position;
//!         displaced
//!     }
//!
//!     fn advance(&mut self, _tick: u64, applied: &[f32]) -> Outcome {
//!         self.position = (self.position + 0.2 * applied[0]).clamp(-1.0, 1.0);
//!         Outcome { reward: -self.position * self.position, ..Outcome::default() }
//!     }
//! }
//!
//! fn main() -> Result<(), ScenarioError> {
//!     let text = r#"
//!         name = "point"
//!         ticks = 8000
//!         plant.program = "point"
//!         plant.inputs = [{ name = "position", unit = "m", min = -1.0, max = 1.0 }]
//!         plant.outputs = [{ name = "speed", unit = "0.2 m a tick", min = -1.0, max = 1.0 }]
//!         encoder.maps = [{ inputs = ["position"], radius = 0.2 }]
//!         policy.sigma = 0.2
//!         gate.max_command = 1.0
//!     "#;
//!     let plan = Scenario::parse(text, "point.toml")?.plan()?;
//!     let result = in_process(&plan, Point { position: 0.0 }, |_, _| true);
//!     let loss: Vec<f64> = result.controller.windows.iter().map(|window| window.loss).collect();
//!     assert!(loss[loss.len() - 1] < 0.5 * loss[0], "the point learns to return: {loss:?}");
//!     Ok(())
//! }
//! ```
//!
//! A program can launch runs itself, in processes of their own, and have a handle on each. The programs
//! `tectum-simulator`, `tectum-controller` and `tectum-logger` must lie beside it, or in `PATH`:
//!
//! ```no_run
//! use std::path::Path;
//! use std::time::Duration;
//!
//! use tectum::runtime::Mode;
//! use tectum::scenario::Scenario;
//! use tectum::supervise::{Launch, LaunchError, RunHandle};
//!
//! fn main() -> Result<(), LaunchError> {
//!     let plan = Scenario::find(Path::new("arm"))?.plan()?;
//!     let run = RunHandle::start(Launch::new(plan, Mode::Realtime))?;
//!     while !run.is_over() && run.look().ticks < 1000 {
//!         std::thread::sleep(Duration::from_millis(100));
//!     }
//!     run.checkpoint();
//!     run.stop();
//!     let summary = run.wait()?;
//!     println!("{}, exit code {}", summary.to_text(), summary.exit_code());
//!     Ok(())
//! }
//! ```

#![warn(missing_docs)]

pub mod process;
pub mod study;
pub mod supervise;

pub use tectum_core::{agent, learner, plant, policy, seed, state};
pub use tectum_encoder as encoder;
pub use tectum_runtime::{BUILD, log, runtime, wire};
pub use tectum_scenario as scenario;

// The programs, tests and benches of this package are crates of their own and need the following modules, so
// they are public. They are hidden because a plant, a tracker or a study of your own does not need them. They
// may change at any time.
#[doc(hidden)]
pub use tectum_encoder::simd;
use tectum_report::text;
#[doc(hidden)]
pub use tectum_report::{self as report, stats};
use tectum_runtime::run_folder;
#[doc(hidden)]
pub use tectum_runtime::{channel, checkpoint, clock, reference, timing};

#[doc(hidden)]
pub mod bench;
#[doc(hidden)]
pub mod doctor;
#[doc(hidden)]
pub mod new_project;
#[doc(hidden)]
pub mod servo;
#[doc(hidden)]
pub mod watch;
