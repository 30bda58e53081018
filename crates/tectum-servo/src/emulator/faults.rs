//! What goes wrong and when: a function of the seed, the fault's place in the list, the servo and the instant.

use xxhash_rust::xxh3::xxh3_64_with_seed;

use super::config::{ServoFault, ServoFaultKind};

const SECOND: u64 = 1_000_000_000;

/// The faults of a chain.
#[derive(Debug, Clone)]
pub struct ChainFaults {
    list: Vec<ServoFault>,
    seed: u64,
}

/// What befalls one answer.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ReplyFault {
    /// It does not come.
    pub lost: bool,
    /// Its checksum is wrong.
    pub broken: bool,
    /// It has another id.
    pub stranger: bool,
    /// It comes so much later, ns.
    pub late: u64,
}

impl ChainFaults {
    /// These faults, with the draws of `seed`.
    pub fn new(list: &[ServoFault], seed: u64) -> Self {
        Self { list: list.to_vec(), seed }
    }

    /// The first instant after `now` at which what lasts may begin or end.
    pub fn next_edge(&self, now: u64) -> u64 {
        let lasting = self.list.iter().filter(|fault| fault.kind.lasts());
        let edges = lasting.flat_map(|fault| {
            let second = fault.probability.map(|_| (now / SECOND + 1) * SECOND);
            [fault.from_s.map(ns), fault.until_s.map(ns), second].into_iter().flatten()
        });
        edges.filter(|&edge| edge > now).min().unwrap_or(u64::MAX)
    }

    /// Whether `kind`, which lasts, befalls the servo with this id at `now`.
    pub fn holds(&self, kind: ServoFaultKind, id: u8, now: u64) -> bool {
        self.matching(id, now).any(|(i, fault)| fault.kind == kind && self.draw(i, fault, id, now / SECOND))
    }

    /// What befalls answer number `answer` of the servo with this id, at `now`.
    pub fn mishap(&self, id: u8, now: u64, answer: u64) -> ReplyFault {
        let mut mishap = ReplyFault::default();
        for (i, fault) in self.matching(id, now).filter(|(_, fault)| !fault.kind.lasts()) {
            if self.draw(i, fault, id, answer) {
                match fault.kind {
                    ServoFaultKind::NoReply => mishap.lost = true,
                    ServoFaultKind::BadChecksum => mishap.broken = true,
                    ServoFaultKind::WrongId => mishap.stranger = true,
                    ServoFaultKind::Slow => mishap.late += (fault.delay_ms.unwrap_or(20.0) * 1e6) as u64,
                    _ => {}
                }
            }
        }
        mishap
    }

    fn matching(&self, id: u8, now: u64) -> impl Iterator<Item = (usize, &ServoFault)> {
        self.list.iter().enumerate().filter(move |(_, fault)| {
            let begun = fault.from_s.is_none_or(|from| now >= ns(from));
            let over = fault.until_s.is_some_and(|until| now >= ns(until));
            begun && !over && fault.servo.is_none_or(|servo| servo == id)
        })
    }

    fn draw(&self, place: usize, fault: &ServoFault, id: u8, number: u64) -> bool {
        let Some(probability) = fault.probability else { return true };
        let mut key = [0; 17];
        key[..8].copy_from_slice(&(place as u64).to_le_bytes());
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
    fn a_window_begins_and_ends_where_it_says() {
        let faults = ChainFaults::new(&[fault(ServoFaultKind::Hot), fault(ServoFaultKind::Slow)], 1);
        assert_eq!(faults.next_edge(0), SECOND);
        assert_eq!(faults.next_edge(SECOND), 2 * SECOND);
        assert_eq!(faults.next_edge(2 * SECOND), u64::MAX);
        assert!(!faults.holds(ServoFaultKind::Hot, 2, SECOND - 1));
        assert!(faults.holds(ServoFaultKind::Hot, 2, SECOND));
        assert!(!faults.holds(ServoFaultKind::Hot, 1, SECOND));
        assert!(!faults.holds(ServoFaultKind::Hot, 2, 2 * SECOND));
        assert_eq!(faults.mishap(2, SECOND, 7).late, 20_000_000);
        assert_eq!(faults.mishap(3, SECOND, 7), ReplyFault::default());
    }

    #[test]
    fn a_probability_is_kept_and_drawn_anew_for_every_answer() {
        let fault = ServoFault { probability: Some(0.25), ..fault(ServoFaultKind::NoReply) };
        let count = |seed| {
            let faults = ChainFaults::new(std::slice::from_ref(&fault), seed);
            (0..10_000).filter(|&n| faults.mishap(2, SECOND, n).lost).count()
        };
        assert!((2300..2700).contains(&count(1)), "{}", count(1));
        assert_ne!(count(1), count(2));
    }
}
