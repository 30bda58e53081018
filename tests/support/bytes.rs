//! A log as bytes: where its records and its samples stand.

use tectum::log::{LogRecord, TOTALS_METADATA};
use tectum::wire::{Command, Gap, Learning, Observation};

/// A message's place in the file.
#[derive(Debug, Clone, Copy)]
pub struct Body {
    /// Where the sample's bytes begin, behind the four bytes of encapsulation.
    pub at: usize,
    /// How many there are.
    pub length: usize,
    /// The sample.
    pub sample: LogRecord,
}

/// All messages' places, and where the last of them ends: cut there, a log is torn and has no checksum.
pub fn bodies(log: &[u8]) -> (Vec<Body>, usize) {
    let (mut at, mut bodies) = (8, Vec::new());
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
                bodies.push(Body { at: at + 35, length: body.len(), sample });
            }
            0x0C if totals => return (bodies, at),
            _ => {}
        }
        at += 9 + length;
    }
    panic!("a log without an end");
}
