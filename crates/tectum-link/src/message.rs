//! What the two ends of a link say to each other: samples as the wire has them, and a few messages of the link's own.
//!
//! A payload is a number for its kind, the session for which it is meant, and the body. Samples travel as their bytes:
//! the handshake has compared the schema.

use bytemuck::{AnyBitPattern, NoUninit};
use serde::{Deserialize, Serialize};
use tectum::wire::{Ahead, Command, Learning, Observation, Status};

/// What one end states about itself and its run, until the other has it, and once a second from then on.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Hello {
    /// Id of the run on this machine.
    pub run: u64,
    /// `realtime` or `lockstep`.
    pub mode: String,
    /// Hash of the samples' layout.
    pub schema: u64,
    /// Hash of the scenario.
    pub scenario: u64,
    /// The build.
    pub build: String,
    /// All processes of the run on this machine have their ports.
    pub ready: bool,
    /// Plant's side: the start of tick 0 on its own clock, ns, once it is known.
    pub t0_ns: Option<u64>,
    /// Controller's side: names of the agent's own columns.
    pub columns: Vec<String>,
    /// The process on this machine has written its report.
    pub reported: bool,
    /// This end has all that it needs of the other one, and ends.
    pub done: bool,
    /// Why this end ends the run before its last tick, if it does.
    pub farewell: Option<String>,
}

/// An observation, with the status of its plant.
#[derive(Debug, Clone, Copy, AnyBitPattern, NoUninit)]
#[repr(C)]
pub struct ObservationMessage {
    /// When it was sent, sender's clock, ns.
    pub sent_ns: u64,
    /// The plant's board.
    pub status: Status,
    /// The sample.
    pub observation: Observation,
}

/// The answer to an observation.
#[derive(Debug, Clone, Copy, AnyBitPattern, NoUninit)]
#[repr(C)]
pub struct AnswerMessage {
    /// When it was sent, sender's clock, ns.
    pub sent_ns: u64,
    /// When the observation was received, sender's clock, ns.
    pub received_ns: u64,
    /// The controller's board.
    pub status: Status,
    /// The command.
    pub command: Command,
}

/// A learning record.
#[derive(Debug, Clone, Copy, AnyBitPattern, NoUninit)]
#[repr(C)]
pub struct LearningMessage {
    /// The controller's board.
    pub status: Status,
    /// The record.
    pub learning: Learning,
}

/// An answer of a lockstep run: command and learning record arrive together, because nothing is late there.
#[derive(Debug, Clone, Copy, AnyBitPattern, NoUninit)]
#[repr(C)]
pub struct LockstepMessage {
    /// The answer.
    pub answer: AnswerMessage,
    /// The record.
    pub learning: Learning,
}

/// One round trip for the clocks: sent, received there, sent back there; ns.
#[derive(Debug, Clone, Copy, Default, AnyBitPattern, NoUninit)]
#[repr(C)]
pub struct EchoMessage {
    /// Sent, on the clock of the end that asks.
    pub sent_ns: u64,
    /// Received, on the clock of the end that answers.
    pub received_ns: u64,
    /// Sent back, on the clock of the end that answers.
    pub returned_ns: u64,
}

/// A part of the report of the process on the other machine.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ReportPart {
    /// Where the part begins.
    pub offset: u32,
    /// Bytes of the whole report; 0 while there is none.
    pub total: u32,
    /// The bytes.
    pub bytes: Vec<u8>,
}

/// What a datagram carries.
#[derive(Debug, Clone)]
pub enum Message {
    /// See [`Hello`].
    Hello(Box<Hello>),
    /// Asks for an echo.
    Ping(EchoMessage),
    /// The echo.
    Pong(EchoMessage),
    /// An observation.
    Observation(Box<ObservationMessage>),
    /// A command, and the commands ahead that go with it, where the scenario has them.
    Answer(Box<AnswerMessage>, Option<Box<Ahead>>),
    /// A learning record.
    Learning(Box<LearningMessage>),
    /// Command and learning record of a tick in lockstep, and commands ahead.
    Lockstep(Box<LockstepMessage>, Option<Box<Ahead>>),
    /// The board of the process on the other machine, when there is nothing else to send.
    Board(Box<Status>),
    /// Asks for the report, from this byte on.
    Ask(u32),
    /// A part of the report.
    Report(ReportPart),
}

/// Most bytes of a part of a report.
pub const PART: usize = 1024;

impl Message {
    /// The message as a payload for the session `to`.
    pub fn encode(&self, to: u64) -> Vec<u8> {
        let (kind, body): (u64, Vec<u8>) = match self {
            Self::Hello(hello) => (1, serde_json::to_vec(hello).unwrap_or_default()),
            Self::Ping(echo) => (2, bytemuck::bytes_of(echo).to_vec()),
            Self::Pong(echo) => (3, bytemuck::bytes_of(echo).to_vec()),
            Self::Observation(message) => (4, bytemuck::bytes_of(&**message).to_vec()),
            Self::Answer(message, ahead) => (5, with_ahead(bytemuck::bytes_of(&**message), ahead.as_deref())),
            Self::Learning(message) => (6, bytemuck::bytes_of(&**message).to_vec()),
            Self::Lockstep(message, ahead) => (7, with_ahead(bytemuck::bytes_of(&**message), ahead.as_deref())),
            Self::Board(status) => (8, bytemuck::bytes_of(&**status).to_vec()),
            Self::Ask(offset) => (9, offset.to_le_bytes().to_vec()),
            Self::Report(part) => {
                let mut bytes = part.offset.to_le_bytes().to_vec();
                bytes.extend(part.total.to_le_bytes());
                bytes.extend(&part.bytes);
                (10, bytes)
            }
        };
        let mut payload = kind.to_le_bytes().to_vec();
        payload.extend(to.to_le_bytes());
        payload.extend(body);
        payload
    }

    /// The session that a payload is meant for, and its message; `None` if it is none.
    pub fn decode(payload: &[u8]) -> Option<(u64, Self)> {
        let word = |at: usize| payload.get(at..at + 8)?.try_into().map(u64::from_le_bytes).ok();
        let (kind, to) = (word(0)?, word(8)?);
        let body = &payload[16..];
        let half = |at: usize| body.get(at..at + 4)?.try_into().map(u32::from_le_bytes).ok();
        let message = match kind {
            1 => Self::Hello(Box::new(serde_json::from_slice(body).ok()?)),
            2 => Self::Ping(read(body)?),
            3 => Self::Pong(read(body)?),
            4 => Self::Observation(Box::new(read(body)?)),
            5 => {
                let (message, ahead) = read_with_ahead(body)?;
                Self::Answer(message, ahead)
            }
            6 => Self::Learning(Box::new(read(body)?)),
            7 => {
                let (message, ahead) = read_with_ahead(body)?;
                Self::Lockstep(message, ahead)
            }
            8 => Self::Board(Box::new(read(body)?)),
            9 => Self::Ask(half(0)?),
            10 if body.len() <= 8 + PART => {
                Self::Report(ReportPart { offset: half(0)?, total: half(4)?, bytes: body.get(8..)?.to_vec() })
            }
            _ => return None,
        };
        Some((to, message))
    }
}

fn read<T: AnyBitPattern>(body: &[u8]) -> Option<T> {
    bytemuck::try_pod_read_unaligned(body).ok()
}

/// `message`, and `ahead` behind it.
fn with_ahead(message: &[u8], ahead: Option<&Ahead>) -> Vec<u8> {
    [message, ahead.map_or(&[], bytemuck::bytes_of)].concat()
}

/// Reads what [`with_ahead`] wrote.
fn read_with_ahead<T: AnyBitPattern>(body: &[u8]) -> Option<(Box<T>, Option<Box<Ahead>>)> {
    let (message, ahead) = body.split_at_checked(size_of::<T>())?;
    let ahead = if ahead.is_empty() { None } else { Some(Box::new(read(ahead)?)) };
    Some((Box::new(read(message)?), ahead))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_survive_and_no_bytes_panic() {
        let hello = Hello { run: u64::MAX, t0_ns: Some(3), ..Hello::default() };
        let payload = Message::Hello(Box::new(hello.clone())).encode(9);
        assert!(matches!(Message::decode(&payload), Some((9, Message::Hello(back))) if *back == hello));
        let status = Status { ticks: 5, ..bytemuck::Zeroable::zeroed() };
        let payload = Message::Board(Box::new(status)).encode(1);
        assert!(matches!(Message::decode(&payload), Some((1, Message::Board(back))) if back.ticks == 5));
        let answer = AnswerMessage { sent_ns: 7, ..bytemuck::Zeroable::zeroed() };
        for ahead in [None, Some(Box::new(Ahead { ticks: 3, ..Ahead::default() }))] {
            let payload = Message::Answer(Box::new(answer), ahead.clone()).encode(1);
            let Some((1, Message::Answer(back, found))) = Message::decode(&payload) else { panic!("{ahead:?}") };
            assert_eq!((back.sent_ns, found), (7, ahead));
            assert!(payload.len() < 1200, "one datagram without fragments");
            assert!(Message::decode(&payload[..payload.len() - 1]).is_none());
        }
        for kind in 0..20_u64 {
            for length in 0..1300 {
                let mut bytes = kind.to_le_bytes().to_vec();
                bytes.resize(length, 0xa5);
                let _ = Message::decode(&bytes);
            }
        }
    }
}
