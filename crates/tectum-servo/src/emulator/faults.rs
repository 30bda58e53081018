//! Fault injection. Whether a fault occurs is a function of the seed, the fault's index in the list, the servo
//! and the time.

use xxhash_rust::xxh3::xxh3_64_with_seed;

use super::config::{ServoFault, ServoFaultKind};

const SECOND: u64 = 1_000_000_000;

/// The faults of a chain.
#[derive(Debug, Clone)]
pub struct ChainFaults {
    list: Vec<ServoFault>,
    seed: u64,
}

/// Faults of one answer.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ReplyFault {
    /// It is not sent.
    pub lost: bool,
    /// Its checksum is wrong.
    pub bad_checksum: bool,
    /// It has another id.
    pub wrong_id: bool,
    /// Additional delay, ns.
    pub delay_ns: u64,
}

impl ChainFaults {
    /// The faults of a configuration, with random draws from `seed`.
    pub fn new(list: &[ServoFault], seed: u64) -> Self {
        Self { list: list.to_vec(), seed }
    }

    /// Adds a fault.
    pub fn push(&mut self, fault: ServoFault) {
        self.list.push(fault);
    }

    /// The first time after `now` at which a fault of a servo may begin or end, ns.
    pub fn next_change(&self, now: u64) -> u64 {
        let of_servos = self.list.iter().filter(|fault| fault.kind.affects_servo());
        let times = of_servos.flat_map(|fault| {
            let second = fault.probability.map(|_| (now / SECOND + 1) * SECOND);
            [fault.from_s.map(ns), fault.until_s.map(ns), second].into_iter().flatten()
        });
        times.filter(|&time| time > now).min().unwrap_or(u64::MAX)
    }

    /// Whether a servo fault of this kind affects servo `id` at `now`.
    pub fn is_active(&self, kind: ServoFaultKind, id: u8, now: u64) -> bool {
        self.matching(id, now).any(|(i, fault)| fault.kind == kind && self.draw(i, fault, id, now / SECOND))
    }

    /// The faults of answer number `answer`, sent by servo `id` at `now`.
    pub fn reply_fault(&self, id: u8, now: u64, answer: u64) -> ReplyFault {
        let mut reply = ReplyFault::default();
        for (i, fault) in self.matching(id, now).filter(|(_, fault)| !fault.kind.affects_servo()) {
            if self.draw(i, fault, id, answer) {
                match fault.kind {
                    ServoFaultKind::NoReply => reply.lost = true,
                    ServoFaultKind::BadChecksum => reply.bad_checksum = true,
                    ServoFaultKind::WrongId => reply.wrong_id = true,
                    ServoFaultKind::Slow => reply.delay_ns += (fault.delay_ms.unwrap_or(20.0) * 1e6) as u64,
                    _ => {}
                }
            }
        }
        reply
    }

    /// The faults whose servo and time window match, with their index.
    fn matching(&self, id: u8, now: u64) -> impl Iterator<Item = (usize, &ServoFault)> {
        self.list.iter().enumerate().filter(move |(_, fault)| {
            let started = fault.from_s.is_none_or(|from| now >= ns(from));
            let ended = fault.until_s.is_some_and(|until| now >= ns(until));
            started && !ended && fault.servo.is_none_or(|servo| servo == id)
        })
    }

    /// Whether the fault at `index` occurs in answer or second `number` of servo `id`.
    fn draw(&self, index: usize, fault: &ServoFault, id: u8, number: u64) -> bool {
        let Some(probability) = fault.probability else { return true };
        let mut key = [0; 17];
        key[..8].copy_from_slice(&(index as u64).to_le_bytes());
        key[8..16].copy_from_slice(&number.to_le_bytes());
        key[16] = id;
        let drawn = xxh3_64_with_seed(&key, self.seed) >> 11;
        (drawn as f64) < probability * (1_u64 << 53) as f64
    }
}

fn ns(seconds: f64) -> u64 {
    (seconds * SECOND as f64) as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fault(kind: ServoFaultKind) -> ServoFault {
        ServoFault { kind, servo: Some(2), from_s: Some(1.0), until_s: Some(2.0), probability: None, delay_ms: None }
    }

    #[test]
    fn a_fault_is_active_within_its_window() {
        let faults = ChainFaults::new(&[fault(ServoFaultKind::Hot), fault(ServoFaultKind::Slow)], 1);
        assert_eq!(faults.next_change(0), SECOND);
        assert_eq!(faults.next_change(SECOND), 2 * SECOND);
        assert_eq!(faults.next_change(2 * SECOND), u64::MAX);
        assert!(!faults.is_active(ServoFaultKind::Hot, 2, SECOND - 1));
        assert!(faults.is_active(ServoFaultKind::Hot, 2, SECOND));
        assert!(!faults.is_active(ServoFaultKind::Hot, 1, SECOND));
        assert!(!faults.is_active(ServoFaultKind::Hot, 2, 2 * SECOND));
        assert_eq!(faults.reply_fault(2, SECOND, 7).delay_ns, 20_000_000);
        assert_eq!(faults.reply_fault(3, SECOND, 7), ReplyFault::default());
    }

    #[test]
    fn a_probability_applies_to_every_answer_independently() {
        let fault = ServoFault { probability: Some(0.25), ..fault(ServoFaultKind::NoReply) };
        let count = |seed| {
            let faults = ChainFaults::new(std::slice::from_ref(&fault), seed);
            (0..10_000).filter(|&n| faults.reply_fault(2, SECOND, n).lost).count()
        };
        assert!((2300..2700).contains(&count(1)), "{}", count(1));
        assert_ne!(count(1), count(2));
    }
}
