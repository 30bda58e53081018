//! The loops of plant, controller and logger: they join the pure halves of a tick to channels and time.
//!
//! Plant and controller each have an inner half without transport and clock ([`PlantSide`], [`Controller`]),
//! which contains the whole logic of a tick, and a loop around it that waits, receives and sends. The loops run
//! in real or stepped time. [`in_process`] joins the same two halves directly. That is why all three ways give
//! the same numbers.
//!
//! The contract of a tick (`ARCHITECTURE.md` has the reasons): at tick k the plant takes the command of tick
//! k-1, or the hold policy's when there is none. The gate limits it, and the plant advances through tick k-1
//! with it. Observation k contains the current inputs and the reward of tick k-1. The controller learns from
//! that reward, encodes, draws command k and sends it.

mod budget;
mod checkpoint_schedule;
mod command_inbox;
mod commands_ahead;
mod controller;
mod controller_loop;
mod error;
mod faults;
mod gate;
mod in_process;
mod log_rotator;
mod logger;
mod merge;
mod participant;
mod peer_monitor;
mod pipe;
mod plant;
mod plant_loop;
mod policy_snapshots;
mod reports;
mod run_counts;
mod run_warnings;
mod statistics;
mod stopwatch;
mod target_statistics;
mod tracker;
mod wire_manifest;

pub use crate::channel::{ChannelError, DomainName};
pub use crate::stats::Window;
pub use budget::{SlackPercentiles, TickBudget};
pub use commands_ahead::CommandAhead;
pub use controller::Controller;
pub use controller_loop::{run_controller, run_shipped_controller};
pub use error::channel_exit_code;
pub use error::{RuntimeError, exit};
pub use faults::{Faultable, FaultyChannel, SignalCounts};
pub use gate::{Applied, CommandRange, CommandRanges, Gate};
pub use in_process::{
    InProcess, Simulation, in_process, in_process_over_pipe, in_process_with_agent, in_process_with_observer, simulate,
};
pub use logger::run_logger;
pub use participant::{EndReason, Mode, Participant, ResumePoint, RunManifest, Session, StartPoint, identity};
pub use pipe::{PIPE_OPTION, PipeError, PipedController, PipedStart, serve_controller};
pub use plant::PlantSide;
pub use plant_loop::{run_plant, run_simulator};
pub use policy_snapshots::{
    FIRST_LOOK_S, PolicySnapshot, SnapshotSchedule, change_ticks, read_snapshots, snapshot_path, ticks_in,
};
pub use reports::{ControllerReport, LoggerReport, PlantReport};
pub use reports::{read as read_report, read_columns, read_realtime, realtime_path, remove_unwritten_reports};
pub use run_counts::{InputCounts, NotLearned, RunCounts};
pub use run_warnings::{RunWarning, judge};
pub use statistics::Switch;
pub use statistics::{FinishedStatistics, RunStatistics, Snapshot};
pub use stopwatch::tick_times;
pub use target_statistics::{TargetResult, TargetsAround};
pub use tracker::Tracker;
pub use wire_manifest::{Services, WireManifest};
