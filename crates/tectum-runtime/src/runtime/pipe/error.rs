//! Why a program at the other end of a pipe cannot be used.

use crate::runtime::exit;

/// Why a controller at the other end of a pipe cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum PipeError {
    /// The program does not exist or cannot be started.
    #[error("the controller cannot be started: {program}: {cause}")]
    Start {
        /// The program.
        program: String,
        /// What is wrong, and the remedy.
        cause: String,
    },
    /// The program refused the scenario, or failed and said why.
    #[error("{message}")]
    Refused {
        /// The exit code to end with.
        code: u8,
        /// Its message.
        message: String,
    },
    /// The program ended.
    #[error("the controller {program} {how} at tick {tick}, before the run was over")]
    Ended {
        /// The program.
        program: String,
        /// How it ended.
        how: String,
        /// The tick that it should have answered.
        tick: u64,
    },
    /// The program gave no answer.
    #[error(
        "the controller {program} gave no answer to tick {tick} for {seconds} s and was killed; \
         `hang_s` under [restart] sets how long it may take"
    )]
    Silent {
        /// The program.
        program: String,
        /// The tick that it should have answered.
        tick: u64,
        /// How long it had, s.
        seconds: f64,
    },
    /// A signal ended this process while the program owed an answer.
    #[error("ended by signal {number}, while the controller {program} owed the answer to tick {tick}")]
    Interrupted {
        /// The program.
        program: String,
        /// The tick that it should have answered.
        tick: u64,
        /// The signal.
        number: u32,
    },
    /// What the program wrote is not the protocol.
    #[error(
        "the controller {program} does not speak the protocol of a pipe: {what}; a controller writes nothing else to \
         its standard output (docs/wire.md)"
    )]
    Protocol {
        /// The program.
        program: String,
        /// What is wrong.
        what: String,
    },
}

impl PipeError {
    /// The exit code for this error.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Start { .. } => exit::INPUT,
            Self::Refused { code, .. } => *code,
            Self::Interrupted { number, .. } => exit::by_signal(*number),
            Self::Ended { .. } | Self::Silent { .. } | Self::Protocol { .. } => exit::PROCESS,
        }
    }
}
