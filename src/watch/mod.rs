//! Watching runs from outside: finds them, reads what they leave in shared memory, and shows it in a terminal, in a
//! browser or in Foxglove.
//!
//! A watcher opens nothing of iceoryx2. It maps the log rings to read and reads the launcher's copy of the boards, so
//! that no process of the run can notice it, whatever it does: there may be any number of watchers, and they may be
//! stopped or killed. [`tectum_view`] has the state and the faces; this module has clocks, files, sockets and
//! terminals.

mod address;
mod error;
mod facts;
mod follower;
#[cfg(feature = "foxglove")]
mod foxglove;
mod living;
mod run_watcher;
mod screen_session;
mod snapshot;
mod socket_server;
mod terminal;
mod watched_run;
mod web;

pub use error::WatchError;
pub use follower::{Follower, WatchTarget};
#[cfg(feature = "foxglove")]
pub use foxglove::watch_by_foxglove;
pub use snapshot::snapshot;
pub use terminal::{FaceEnd, watch_in_terminal};
pub use watched_run::{WatchedRun, end_with_parent, launch_and_watch};
pub use web::{serve_metrics, serve_metrics_of_own_run, watch_in_browser};
