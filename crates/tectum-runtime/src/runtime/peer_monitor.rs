//! Follows another process of the run across its restarts.

use super::{RuntimeError, Session};
use crate::channel::BoardReader;
use crate::wire::{ProcessState, Role, Status};

/// The restarts of another process of the run. The caller holds the reader of its board.
#[derive(Debug)]
pub(super) struct PeerMonitor {
    role: Role,
    /// A new incarnation has been announced and does not run its loop yet.
    restarting: bool,
}

impl PeerMonitor {
    /// Monitors the process in `role`.
    pub fn new(role: Role) -> Self {
        Self { role, restarting: false }
    }

    /// Checks whether the process has been restarted, and moves the reader to the board page of the new
    /// incarnation. Returns true once per restart, when all ports of the new incarnation are connected.
    pub fn check(&mut self, board: &mut BoardReader<Status>, session: &Session) -> Result<bool, RuntimeError> {
        self.restarting |= board.set_incarnation(session.incarnation_of(self.role))?;
        let returned = self.restarting && board.get().state() >= ProcessState::Running;
        self.restarting &= !returned;
        Ok(returned)
    }
}
