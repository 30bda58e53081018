//! What is going on in a run, as state apart from view, and three faces of it: a screen for a terminal, a page for a
//! browser, and metrics for Prometheus.
//!
//! [`RunView`] takes plain numbers: samples, boards and messages, as a watcher finds them, and the watcher's time in
//! seconds. It uses no transport, no clock and no files, and its size is bounded however long the run is.
//! [`draw_screen`] draws it into the cells of a terminal; [`page`] has the page and the messages that it is sent;
//! [`metrics`] is a text.

mod counts;
mod curve;
mod event;
mod facts;
mod metrics;
pub mod page;
mod run_view;
mod sample;
mod screen;
mod stage;
mod text;

pub use counts::{SeenProcess, WatchedState};
pub use curve::Curve;
pub use event::{EventLog, RunEvent, RunEventKind};
pub use facts::{ArmFrame, RunFacts, SignalRange};
pub use metrics::metrics;
pub use run_view::RunView;
pub use sample::{SeenCommand, SeenLearning, SeenObservation, TargetOutcome, TickRecord};
pub use screen::{ScreenOptions, draw_notice, draw_screen};
pub use stage::{Stage, StageTimes};
pub use text::{duration, thousands};

/// The drawing library, so that whoever owns a terminal need not name its version.
pub use ratatui_core as ratatui;
