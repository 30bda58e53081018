//! The parts of a run.

/// The three parts of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// The controlled system: simulator or hardware.
    Plant,
    /// Encoder, policy and learner.
    Controller,
    /// Writes all samples to a file.
    Logger,
}

impl Role {
    /// All roles, in the order of their start.
    pub const ALL: [Role; 3] = [Role::Plant, Role::Controller, Role::Logger];

    /// The role's name, as in file names and messages.
    pub const fn name(self) -> &'static str {
        match self {
            Role::Plant => "plant",
            Role::Controller => "controller",
            Role::Logger => "logger",
        }
    }
}
