//! Packets against the manuals' examples, against rustypot, and against any bytes.

use super::*;
use proptest::collection::SizeRange;
use proptest::prelude::*;
use rustypot::DynamixelProtocolHandler as Host;
use serialport::{SerialPort, TTYPort};
use std::io::Read as _;
use std::time::Duration;

const BOTH: [Protocol; 2] = [Protocol::Dynamixel, Protocol::Feetech];

#[test]
fn the_examples_of_the_manuals_are_parsed_and_encoded() {
    let bytes = [0xff, 0xff, 0xfd, 0, 1, 3, 0, 1, 0x19, 0x4e];
    let packet = Packet { id: 1, code: instruction::PING, parameters: vec![], checksum_ok: true };
    assert_eq!(parse(Protocol::Dynamixel, &bytes), Parsed::Packet(10, packet.clone()));
    assert_eq!(ping(Protocol::Dynamixel, 1), bytes);
    let bytes = [0xff, 0xff, 0xfd, 0, 1, 8, 0, 0x55, 0, 0xa6, 0, 0, 0, 0x8c, 0xc0];
    assert_eq!(status(Protocol::Dynamixel, 1, 0, &[0xa6, 0, 0, 0]), bytes);
    let reply = ServoReply { bytes: vec![0xa6, 0, 0, 0], error: 0 };
    assert_eq!(answer(Protocol::Dynamixel, 1, 4, &bytes), Ok(Some((15, reply))));
    let bytes = [0xff, 0xff, 1, 2, 1, 0xfb];
    assert_eq!(parse(Protocol::Feetech, &bytes), Parsed::Packet(6, packet));
    assert_eq!(ping(Protocol::Feetech, 1), bytes);
    let bytes = [0xff, 0xff, 1, 3, 0, 0x20, 0xdb];
    assert_eq!(status(Protocol::Feetech, 1, 0, &[0x20]), bytes);
    let reply = ServoReply { bytes: vec![0x20], error: 0 };
    assert_eq!(answer(Protocol::Feetech, 1, 1, &bytes), Ok(Some((7, reply))));
}

#[test]
fn an_answer_is_refused_by_the_reason() {
    for protocol in BOTH {
        let whole = status(protocol, 7, 0, &[1, 2]);
        let of = |id, length, bytes: &[u8]| answer(protocol, id, length, bytes);
        assert!(matches!(of(7, 2, &whole), Ok(Some((n, _))) if n == whole.len()));
        assert_eq!(of(7, 2, &whole[..whole.len() - 1]), Ok(None));
        assert_eq!(of(8, 2, &whole), Err(AnswerFault::WrongId(7)));
        assert_eq!(of(7, 3, &whole), Err(AnswerFault::Length));
        assert_eq!(of(7, 2, &[&[0], &whole[..]].concat()), Err(AnswerFault::Malformed));
        let mut broken = whole.clone();
        *broken.last_mut().unwrap() ^= 1;
        assert_eq!(of(7, 2, &broken), Err(AnswerFault::Checksum));
    }
    // An instruction is no answer: an adapter sends it back, or two hosts share the line.
    assert_eq!(answer(Protocol::Dynamixel, 7, 0, &ping(Protocol::Dynamixel, 7)), Err(AnswerFault::Malformed));
}

/// Whether rustypot writes just `ours` for an instruction, at the other end of a pseudo-terminal.
fn writes(ours: &[u8], protocol: Protocol, instruction: impl Fn(&Host, &mut dyn SerialPort)) -> bool {
    let host = if protocol == Protocol::Dynamixel { Host::v2() } else { Host::v1() };
    let (mut near, mut far) = TTYPort::pair().expect("a pseudo-terminal");
    near.set_timeout(Duration::from_millis(1)).expect("a time-out");
    far.set_timeout(Duration::from_secs(60)).expect("a time-out");
    instruction(&host, &mut near);
    let mut theirs = vec![0; ours.len()];
    far.read_exact(&mut theirs).expect("as many bytes as ours");
    theirs == ours && far.bytes_to_read().expect("a count") == 0
}

/// Bytes among which those of headers are frequent.
fn body(length: impl Into<SizeRange>) -> impl Strategy<Value = Vec<u8>> {
    prop::collection::vec(prop_oneof![Just(0xff_u8), Just(0xfd), any::<u8>()], length)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn instructions_are_those_of_rustypot(
        id in 0_u8..=252, address: u8, length in 1_u8..100,
        data in body(1..40), goals in prop::collection::vec(body(4), 1..6),
    ) {
        let (ids, block): (Vec<u8>, _) = ((1..=goals.len() as u8).collect(), RegisterBlock { address, length });
        for protocol in BOTH {
            type Instruction<'a> = &'a dyn Fn(&Host, &mut dyn SerialPort);
            let same = |ours: &[u8], instruction: Instruction| writes(ours, protocol, instruction);
            prop_assert!(same(&ping(protocol, id), &|host, port| drop(host.ping(port, id))));
            let ours = read(protocol, id, block);
            prop_assert!(same(&ours, &|host, port| drop(host.read(port, id, address, length))));
            let ours = write(protocol, id, address, &data);
            prop_assert!(same(&ours, &|host, port| drop(host.write(port, id, address, &data))));
            let ours = sync_read(protocol, &ids, block);
            prop_assert!(same(&ours, &|host, port| drop(host.sync_read(port, &ids, address, length))));
            let ours = sync_write(protocol, &ids, address, &goals);
            prop_assert!(same(&ours, &|host, port| drop(host.sync_write(port, &ids, address, &goals))));
        }
    }
}

proptest! {
    #[test]
    fn any_bytes_are_an_answer_a_part_of_one_or_a_reason(bytes in body(0..300), id: u8, length in 0_usize..40) {
        for protocol in BOTH {
            if let Ok(Some((taken, reply))) = answer(protocol, id, length, &bytes) {
                prop_assert!(taken <= bytes.len() && reply.bytes.len() == length);
            }
        }
    }

    #[test]
    fn an_answer_is_read_whole_whatever_follows_it_and_refused_with_any_bit_wrong(
        id in 0_u8..=252, error: u8, data in body(0..60), rest in body(0..20), at: prop::sample::Index, bit in 0_u8..8,
    ) {
        for protocol in BOTH {
            let packet = status(protocol, id, error, &data);
            let received = [&packet[..], &rest].concat();
            let reply = ServoReply { bytes: data.clone(), error };
            prop_assert_eq!(answer(protocol, id, data.len(), &received), Ok(Some((packet.len(), reply))));
            for n in 0..packet.len() {
                prop_assert_eq!(answer(protocol, id, data.len(), &packet[..n]), Ok(None));
            }
            let mut broken = packet.clone();
            broken[at.index(packet.len())] ^= 1_u8 << bit;
            prop_assert!(!matches!(answer(protocol, id, data.len(), &broken), Ok(Some(_))));
        }
    }

    #[test]
    fn unstuffing_inverts_stuffing(body in body(0..64)) {
        let wire = stuffed(&body);
        prop_assert_eq!(unstuffed(&wire), body);
        // A stuffed body never contains a header.
        prop_assert!(!wire.windows(4).any(|four| four == [0xff, 0xff, 0xfd, 0x00]));
    }
}
