//! What a process knows of another one across that one's deaths and returns.

use super::{RuntimeError, Session};
use crate::channel::BoardReader;
use crate::wire::{ProcessState, Role, Status};

/// Another process of the run, whose board somebody else holds.
#[derive(Debug)]
pub(super) struct PeerMonitor {
    role: Role,
    /// A new incarnation has been announced and is not in its loop yet.
    awaited: bool,
}

impl PeerMonitor {
    pub fn new(role: Role) -> Self {
        Self { role, awaited: false }
    }

    /// Looks whether the process has come back, and turns its board to the page on which it then writes. True once for each
    /// return, when all its ports are there.
    pub fn check(&mut self, board: &mut BoardReader<Status>, session: &Session) -> Result<bool, RuntimeError> {
        self.awaited |= board.set_incarnation(session.incarnation_of(self.role))?;
        let back = self.awaited && board.get().state() >= ProcessState::Running;
        self.awaited &= !back;
        Ok(back)
    }
}
