//! Why a channel cannot be set up or used, in words for the user: what happened, and what to do. The transport's own
//! names for its errors mean nothing to a user, and one of them can have several causes. So what can be checked is
//! checked before the transport is asked ([`shared_memory`](super::shared_memory)), and what remains is put into
//! words here.

use std::path::PathBuf;

/// Why a channel cannot be set up or used.
#[derive(Debug, thiserror::Error)]
pub enum ChannelError {
    /// Something of the run's domain could not be created or opened.
    #[error("{what} of the run cannot be set up in shared memory: {cause}")]
    SetUp {
        /// The resource.
        what: String,
        /// The cause, with its remedy.
        cause: SetUpCause,
        /// The cause as the transport or the operating system names it, for whoever debugs this.
        name: String,
    },
    /// The run belongs to another user.
    #[error(
        "the run belongs to the user with id {owner}, and this process to the one with id {own}; start all processes \
         of a run as the same user"
    )]
    OtherUser {
        /// The run's user.
        owner: u32,
        /// This process's user.
        own: u32,
    },
    /// The run's shared memory is no longer there, although its launcher is.
    #[error(
        "the run's shared memory {} is not there: the run is over, or somebody removed it (systemd-logind does so when \
         its user logs out, unless RemoveIPC=no is set in /etc/systemd/logind.conf); start a new run", root.display()
    )]
    Removed {
        /// The root of the run's domain.
        root: PathBuf,
    },
    /// This machine's shared memory cannot hold a run.
    #[error("{found}; {remedy}")]
    SharedMemory {
        /// What is wrong with it.
        found: String,
        /// What to do.
        remedy: &'static str,
    },
    /// A sample could not be sent or received.
    #[error("channel {channel} failed while the run was going: {cause}")]
    Transfer {
        /// The channel's name.
        channel: String,
        /// iceoryx2's reason.
        cause: String,
    },
    /// The process does not fit the run.
    #[error("{0}")]
    Mismatch(Mismatch),
}

/// Why a process is refused: one of the handshake's values differs.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "the {role} does not fit the run: its {what} is {ours}, the run's is {theirs}; start it from the same build and \
     with the same scenario as the run"
)]
pub struct Mismatch {
    /// The refused process.
    pub role: &'static str,
    /// The value that differs: `schema`, `scenario` or `build`.
    pub what: &'static str,
    /// The process's own value.
    pub ours: String,
    /// The run's value.
    pub theirs: String,
}

/// Why something could not be created or opened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum SetUpCause {
    /// It does not exist.
    #[error("it is not there; the run is over or was never started")]
    Missing,
    /// This user may not use it.
    #[error("permission denied; start all processes of a run as the same user")]
    Permission,
    /// Shared memory is full, or not there.
    #[error("there is no room; give /dev/shm more of it (`sudo mount -o remount,size=256M /dev/shm`)")]
    NoRoom,
    /// The process may not have more open files, mappings or locked memory.
    #[error("a limit of this process is reached; raise it (`ulimit -n`, `ulimit -l`)")]
    Limit,
    /// A living process, or a dead one whose place is not free yet, has this role.
    #[error("another process already has this role in the run")]
    RoleTaken,
    /// Another process began to create it and did not finish.
    #[error("another process has begun to create it and does not finish; end the run and start a new one")]
    Unfinished,
    /// What is there does not fit.
    #[error("what is there has another layout; start all processes from the same build, and a new run")]
    OtherLayout,
    /// What is there is damaged.
    #[error("what is there is damaged; end the run and start a new one")]
    Damaged,
    /// It exists already.
    #[error("it exists already; start the run anew")]
    Exists,
    /// No other cause is known.
    #[error("the system refuses; `tectum doctor` checks the shared memory of this machine")]
    Refused,
}

impl SetUpCause {
    /// The cause of an error that the transport or the operating system names `name`.
    fn of(name: &str) -> Self {
        let causes: [(&[&str], Self); 9] = [
            (&["DoesNotExist", "MarkedForDestruction", "NotFound"], Self::Missing),
            (&["Permission", "ReadOnly", "not a regular file of this user"], Self::Permission),
            (&["UnableToGenerateUniqueNodeId", "OutOfMemory", "StorageFull", "NOSPC", "NOMEM"], Self::NoRoom),
            (&["code: 28", "code: 12", "InsufficientMemory", "ConfigCouldNotBeCreated"], Self::NoRoom),
            (&["code: 24", "code: 23", "FileHandles", "PerProcess", "SystemWide"], Self::Limit),
            (&["Exceeds"], Self::RoleTaken),
            (&["BeingCreated", "HangsInCreation", "Initialization"], Self::Unfinished),
            (&["Incompatible", "DoesNotSupport", "layout", "size is wrong", "VersionMismatch"], Self::OtherLayout),
            (&["Corrupted", "Damaged"], Self::Damaged),
        ];
        let known = causes.into_iter().find(|(names, _)| names.iter().any(|known| name.contains(known)));
        match known {
            Some((_, cause)) => cause,
            None if name.contains("AlreadyExists") => Self::Exists,
            None => Self::Refused,
        }
    }
}

impl ChannelError {
    pub(super) fn set_up(what: impl Into<String>, cause: impl std::fmt::Debug) -> Self {
        let name = format!("{cause:?}");
        Self::SetUp { what: what.into(), cause: SetUpCause::of(&name), name }
    }

    /// Whether the machine or the user's input must change before another attempt can do better.
    pub(crate) fn is_input(&self) -> bool {
        use SetUpCause::{Limit, Missing, NoRoom, Permission};
        match self {
            Self::SetUp { cause, .. } => matches!(cause, Limit | Missing | NoRoom | Permission),
            Self::Removed { .. } | Self::SharedMemory { .. } => true,
            _ => false,
        }
    }

    /// Whether the process does not fit the run.
    pub(crate) fn is_mismatch(&self) -> bool {
        let other_layout = matches!(self, Self::SetUp { cause: SetUpCause::OtherLayout, .. });
        other_layout || matches!(self, Self::Mismatch(_) | Self::OtherUser { .. })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_name_of_the_transport_reaches_the_user() {
        for (name, cause) in [
            ("InternalError", SetUpCause::Refused),
            ("ServiceConfigCouldNotBeCreated", SetUpCause::NoRoom),
            ("Os { code: 28, kind: StorageFull, message: \"No space left on device\" }", SetUpCause::NoRoom),
            ("ExceedsMaxSupportedWriters", SetUpCause::RoleTaken),
            ("DoesNotExist", SetUpCause::Missing),
            ("InsufficientPermissions", SetUpCause::Permission),
            ("ServiceInCorruptedState", SetUpCause::Damaged),
            ("IncompatibleTypes", SetUpCause::OtherLayout),
            ("AlreadyExists", SetUpCause::Exists),
        ] {
            assert_eq!(SetUpCause::of(name), cause, "{name}");
            let text = ChannelError::SetUp { what: "a board".into(), cause, name: name.into() }.to_string();
            assert!(!text.contains(name) && text.starts_with("a board of the run cannot be set up"), "{text}");
        }
    }
}
