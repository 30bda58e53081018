//! What the boards of a run show: phases, states and counts.

/// The state of a process, as its board and its process id tell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum WatchedState {
    /// Not started yet, or about to be started again.
    #[default]
    Waiting,
    /// It opens its channels.
    SettingUp,
    /// Its loop runs.
    Running,
    /// It closes its files.
    Closing,
    /// It has done its part.
    Finished,
    /// It ended too early.
    Failed,
    /// Its process is gone, and it had not finished.
    Died,
}

impl WatchedState {
    /// Name for people.
    pub const fn name(self) -> &'static str {
        ["waiting", "setting up", "running", "closing", "finished", "failed", "died"][self as usize]
    }

    /// Whether something is wrong with the process.
    pub const fn is_bad(self) -> bool {
        matches!(self, Self::Failed | Self::Died)
    }
}

/// A process of the run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SeenProcess {
    /// Its state.
    pub state: WatchedState,
    /// How often it was started again.
    pub restarts: u32,
    /// Whether it will not return.
    pub gone: bool,
    /// Operating-system id; 0 if there is none.
    pub pid: u32,
    /// Ticks done.
    pub ticks: u64,
    /// Plant: ticks whose command had not come in time.
    pub missed: u64,
    /// Plant: commands that came after their tick.
    pub late: u64,
    /// Plant: ticks passed over. Controller: observations not received. Logger: samples lost.
    pub lost: u64,
}
