//! An emulated chain of servos accepts any bytes at any instants without a panic, and its answers are ordered
//! by time. The host takes any bytes for an answer, a part of one, or a reason against it.

#![no_main]

use libfuzzer_sys::fuzz_target;
use tectum::scenario::EmulatorConfig;
use tectum::servo::emulator::EmulatedChain;
use tectum::servo::model::Protocol;
use tectum::servo::packet;

fuzz_target!(|bytes: &[u8]| {
    let Some((&first, rest)) = bytes.split_first() else { return };
    let protocol = if first & 1 == 0 { Protocol::Dynamixel } else { Protocol::Feetech };
    for n in 0..rest.len() {
        if let Ok(Some((taken, reply))) = packet::answer(protocol, 2, usize::from(first >> 1), &rest[n..]) {
            assert!(taken <= rest.len() - n && reply.bytes.len() == usize::from(first >> 1));
        }
    }
    let mut chain = EmulatedChain::new(protocol, &[1, 2, 2, 7], 1_000_000, &EmulatorConfig::default(), 1);
    let (mut now, mut last) = (0, 0);
    for piece in rest.chunks(usize::from(first >> 1) + 1) {
        now += u64::from(piece[0]) * 1_000_000;
        chain.receive(now, 0, piece);
        while let Some(due) = chain.next_answer() {
            assert!(due >= last);
            last = due;
            assert!(chain.take(due).is_some());
        }
    }
    assert!(chain.state(now + 1_000_000_000).iter().all(|servo| servo.position.is_finite()));
});
