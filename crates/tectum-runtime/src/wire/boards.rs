//! The boards on which the launcher and the processes publish their state. Readers see the latest value only,
//! and a writer never waits for a reader.

use super::Role;
use super::schema::sample;

sample! {
    /// The launcher's board: which phase the run is in.
    Control, "3" {
        /// A [`Phase`] as a number.
        phase: u32,
        /// Checkpoints that were requested by a signal so far.
        checkpoints: u32,
        /// Start of tick 0 on the run's clock, ns; valid from [`Phase::Run`] on.
        t0_ns: u64,
        /// Start number of each process within the run, by [`Role`].
        incarnations: [u32; 3],
        /// The processes that have ended without finishing and will not return: bit 0 the plant, 1 the controller,
        /// 2 the logger. Nobody waits for them.
        gone: u32,
    }
}

sample! {
    /// A process's board: its state and its counts.
    Status, "3" {
        /// A [`ProcessState`] as a number.
        state: u32,
        /// Operating-system id of the process.
        pid: u32,
        /// Heartbeat: counts the process's updates of its board. A count that does not change for long is a
        /// hang.
        beat: u64,
        /// One more than the tick at whose start a checkpoint is taken; 0 before the first. Plant: the one that it has
        /// announced last. Controller: its own last one.
        checkpoint: u64,
        /// Ticks done.
        ticks: u64,
        /// Samples sent on each of its channels.
        sent: u64,
        /// Plant: ticks whose command had not arrived in time. Logger: 0.
        missed: u64,
        /// Plant: commands that arrived after their tick.
        late: u64,
        /// Plant: ticks skipped. Controller: observations that it never received. Logger: samples lost.
        lost: u64,
        /// Logger: ticks consumed. In lockstep the plant waits for this count, so that no sample is lost.
        consumed: u64,
        /// Controller, in real time: total time that its learner has taken after commands were sent, ns.
        learner_ns: u64,
        /// Controller: mean loss over the window in progress.
        loss: f32,
        /// Controller: mean error at the end of a target over the window in progress, NaN where there is none.
        end_error: f32,
        /// Schema hash of the process's build.
        schema: u64,
        /// Hash of the scenario that the process read.
        scenario: u64,
        /// Hash of the process's build identity.
        build: u64,
    }
}

/// The phases of a run, in order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u32)]
pub enum Phase {
    /// Processes open the services and make their ports.
    SetUp = 0,
    /// All ports exist. Every process connects its ports, so that no first sample is lost.
    Connect = 1,
    /// Ticks run from `t0_ns` on.
    Run = 2,
    /// The plant ends after the tick in progress, the others after their last sample.
    Stop = 3,
    /// Every process that still runs ends now.
    Abort = 4,
}

impl Control {
    /// Whether the process in `role` has ended without finishing and will not return.
    pub fn is_gone(&self, role: Role) -> bool {
        self.gone >> role as u32 & 1 == 1
    }

    /// Marks the process in `role` as one that will not return.
    pub fn set_gone(&mut self, role: Role) {
        self.gone |= 1 << role as u32;
    }

    /// The phase on the board; a number without a phase reads as [`Phase::Abort`].
    pub fn phase(&self) -> Phase {
        match self.phase {
            0 => Phase::SetUp,
            1 => Phase::Connect,
            2 => Phase::Run,
            3 => Phase::Stop,
            _ => Phase::Abort,
        }
    }
}

/// The states of a process, in order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u32)]
pub enum ProcessState {
    /// Not started yet.
    Absent = 0,
    /// All ports are created.
    Ready = 1,
    /// All ports are connected.
    Connected = 2,
    /// The loop runs.
    Running = 3,
    /// The loop is over, the last sample is sent, and files are closed.
    Finished = 4,
    /// The process ended before the run was over.
    Failed = 5,
    /// The loop is over; files are being closed and synced to the disk, which may take long. No heartbeat comes
    /// meanwhile.
    Closing = 6,
}

impl Status {
    /// The state on the board; a number without a state reads as [`ProcessState::Failed`].
    pub fn state(&self) -> ProcessState {
        match self.state {
            0 => ProcessState::Absent,
            1 => ProcessState::Ready,
            2 => ProcessState::Connected,
            3 => ProcessState::Running,
            4 => ProcessState::Finished,
            6 => ProcessState::Closing,
            _ => ProcessState::Failed,
        }
    }
}
