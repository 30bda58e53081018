//! All that the launcher's loop sees and does, as one trait: time, boards, processes, signals, the run's folder, and
//! what it says. The loop itself ([`Supervisor`](super::Supervisor)) only decides.
//!
//! There are two worlds: the real one (`process_world.rs`), and the stepped one of `tests/supervise_simulation.rs`, in
//! which thousands of runs with seeded faults pass in a second.

use super::LaunchError;
use super::children::ProcessDeath;
use crate::channel::BoardsCopy;
use crate::wire::{Control, Role, Status};

/// What the launcher does to a process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ProcessAction {
    /// SIGKILL to the process.
    Kill,
    /// SIGKILL to the process and all that it has started.
    KillGroup,
    /// SIGSTOP.
    Stop,
    /// SIGCONT.
    Continue,
    /// SIGTERM.
    Terminate,
}

/// The world around the launcher's loop. Nothing in it may wait without a limit.
pub trait SupervisedWorld {
    /// The instant, ns.
    fn now_ns(&self) -> u64;
    /// Waits for `ns` nanoseconds; less if a signal comes.
    fn pause(&mut self, ns: u64);
    /// Waits until a process has ended or said something, or a signal comes, or for `ns` nanoseconds.
    fn await_event(&mut self, ns: u64);
    /// The number of the termination signal received; 0 if there was none.
    fn signal(&self) -> u32;
    /// Whether a checkpoint was requested since the last call.
    fn checkpoint_asked(&mut self) -> bool;

    /// The status that the process in `role` published last.
    fn status(&self, role: Role) -> Status;
    /// Writes the launcher's board.
    fn put_control(&mut self, control: Control);
    /// Gives watchers a copy of all boards.
    fn publish(&mut self, boards: BoardsCopy);
    /// Whether somebody follows what is published, so that it should be new.
    fn is_watched(&self) -> bool;
    /// Gives all memory of the run its pages.
    ///
    /// # Errors
    /// [`LaunchError::Channel`] when there is no room.
    fn fill_memory(&mut self) -> Result<(), LaunchError>;

    /// Empties the places of processes that have ended. Returns those that ended before they had finished.
    fn reap(&mut self) -> Vec<ProcessDeath>;
    /// Whether there is no process in this role: it has ended, and has not been started again.
    fn is_empty(&self, role: Role) -> bool;
    /// Whether there is a child of the launcher in this role that can be signalled.
    fn has_child(&self, role: Role) -> bool;
    /// Whether all processes have ended.
    fn all_ended(&self) -> bool;
    /// Signals the child in this role, if there is one.
    fn act(&mut self, role: Role, action: ProcessAction);
    /// Kills all remaining processes and what they have started.
    fn kill_all(&mut self);
    /// Reclaims the shared memory of dead processes. False if that does not come to an end.
    fn reclaim(&mut self) -> bool;
    /// Opens the board's page for a process that is started again.
    ///
    /// # Errors
    /// One sentence, when there is no room for it.
    fn set_incarnation(&mut self, role: Role, incarnation: u32) -> Result<(), String>;
    /// Starts the process of an empty role again.
    ///
    /// # Errors
    /// One sentence, when the operating system refuses.
    fn start_again(&mut self, role: Role) -> Result<(), String>;
    /// Waits, not for long, for the last that processes say.
    fn await_last_words(&mut self);

    /// Whether the run's folder was found to be removed just now. Looks at once if `now`, else now and then.
    fn folder_removed(&mut self, now: bool, tick: u64) -> bool;
    /// The tick at which the run's folder was found to be removed, if it was.
    fn folder_removed_at(&self) -> Option<u64>;
    /// Says something on standard error and to watchers.
    fn say(&mut self, message: &str);
    /// Says something to watchers alone.
    fn say_to_watchers(&mut self, message: &str);
    /// Shows the progress, if that is due.
    fn show_progress(&mut self);
    /// Erases the progress line.
    fn clear_progress(&mut self);
}
