//! A log as bytes: the positions of its messages in the file.

use tectum::log::{LogRecord, TOTALS_METADATA};
use tectum::wire::{Command, Gap, Learning, Observation};

/// A message's position in the file.
#[derive(Debug, Clone, Copy)]
pub struct LoggedMessage {
    /// Where the sample's bytes begin, after the four bytes of encapsulation.
    pub offset: usize,
    /// The number of these bytes.
    pub length: usize,
    /// The sample.
    pub sample: LogRecord,
}

/// The positions of all messages, and the end of the last one: cut there, a log is torn and has no checksum.
pub fn messages(log: &[u8]) -> (Vec<LoggedMessage>, usize) {
    let (mut at, mut messages) = (8, Vec::new());
    while at + 9 < log.len() {
        let (opcode, length) = (log[at], u64::from_le_bytes(log[at + 1..at + 9].try_into().unwrap()) as usize);
        let record = &log[at + 9..at + 9 + length];
        let totals = record.get(4..).is_some_and(|name| name.starts_with(TOTALS_METADATA.as_bytes()));
        match opcode {
            0x05 => {
                let body = &record[26..];
                let sample = match body.len() {
                    n if n == size_of::<Observation>() => LogRecord::Observation(bytemuck::pod_read_unaligned(body)),
                    n if n == size_of::<Command>() => LogRecord::Command(bytemuck::pod_read_unaligned(body)),
                    n if n == size_of::<Learning>() => LogRecord::Learning(bytemuck::pod_read_unaligned(body)),
                    n if n == size_of::<Gap>() => LogRecord::Gap(bytemuck::pod_read_unaligned(body)),
                    n => panic!("a message of {n} bytes"),
                };
                messages.push(LoggedMessage { offset: at + 35, length: body.len(), sample });
            }
            0x0C if totals => return (messages, at),
            _ => {}
        }
        at += 9 + length;
    }
    panic!("a log without an end");
}
