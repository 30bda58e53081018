//! The host's bus on emulated servos, in virtual time: adapters that send back what they are sent, and servos that obey
//! without answering.

use std::sync::{Arc, Mutex};

use tectum_servo::bus::{AnswerFault, Bus, BusBudget, BusError};
use tectum_servo::emulator::{EmulatedChain, EmulatedPort, EmulatorConfig, SteppedClock};
use tectum_servo::model::Protocol;

const BAUD: u32 = 1_000_000;
const BOTH: [Protocol; 2] = [Protocol::Dynamixel, Protocol::Feetech];

/// A bus to servos 1 and 2, and the chain behind it.
fn bus(protocol: Protocol, settings: &EmulatorConfig) -> (Bus, Arc<Mutex<EmulatedChain>>) {
    let chain = Arc::new(Mutex::new(EmulatedChain::new(protocol, &[1, 2], BAUD, settings, 1)));
    let clock = SteppedClock::default();
    let port = EmulatedPort::new(Arc::clone(&chain), clock.clone(), BAUD);
    let budget = BusBudget::of(50_000_000);
    (Bus::over(Box::new(port), protocol, budget, Box::new(move || clock.now())), chain)
}

#[test]
fn an_adapter_that_sends_back_what_it_is_sent_is_noticed_and_its_bytes_are_left_out() {
    for (protocol, echo) in BOTH.into_iter().flat_map(|protocol| [(protocol, true), (protocol, false)]) {
        let (mut bus, chain) = bus(protocol, &EmulatorConfig { echo, ..EmulatorConfig::default() });
        let series = bus.series();
        bus.torque_off(&[1, 2]);
        assert!(!bus.ping(7), "{protocol:?}: an echo is no answer");
        assert!(matches!(bus.model(7), Err(BusError::NoAnswer { id: 7, fault: AnswerFault::Silent })));
        assert!(bus.model(1).unwrap().1.is_some());
        assert_eq!(bus.echoes(), echo, "{protocol:?}");
        bus.write(2, series.goal_position, 2500).unwrap();
        bus.sync_set(&[1, 2], series.torque_enable, |_| 1).unwrap();
        for _ in 0..3 {
            let answers = bus.sync_read(&[1, 2], series.state).0.unwrap();
            assert_eq!(answers.len(), 2);
        }
        assert!(chain.lock().unwrap().state(bus.now()).iter().all(|servo| servo.torque), "{protocol:?}");
        assert!(bus.ping(1) && !bus.ping(7));
    }
}

#[test]
fn a_servo_that_obeys_without_answering_is_told_from_one_that_is_not_there() {
    for (protocol, level, address, full) in
        [(Protocol::Dynamixel, 1, 68, 2), (Protocol::Dynamixel, 0, 68, 2), (Protocol::Feetech, 0, 8, 1)]
    {
        let (mut bus, chain) = bus(protocol, &EmulatorConfig::default());
        let series = bus.series();
        chain.lock().unwrap().overwrite(2, series.response_level.address, &[level]);
        let reads = protocol == Protocol::Feetech || level > 0;
        let error = match reads {
            true => bus.write(2, series.goal_position, 2500).unwrap_err(),
            false => bus.model(2).unwrap_err(),
        };
        let expected = matches!(error, BusError::Mute { id: 2, address: at, level } if (at, level) == (address, full));
        assert!(expected && error.is_configuration(), "{protocol:?}, level {level}: {error}");
        assert!(bus.model(1).is_ok() && bus.write(1, series.goal_position, 2500).is_ok());
        // One that is not there is only silent.
        assert!(matches!(bus.model(3), Err(BusError::NoAnswer { id: 3, fault: AnswerFault::Silent })));
        assert!(matches!(bus.write(3, series.goal_position, 9), Err(BusError::NoAnswer { id: 3, .. })));
    }
}

#[test]
fn the_first_servo_without_an_answer_is_named() {
    for protocol in BOTH {
        let (mut bus, chain) = bus(protocol, &EmulatorConfig::default());
        let block = bus.series().state;
        chain.lock().unwrap().overwrite(2, bus.series().id.address, &[9]);
        let error = bus.sync_read(&[1, 2], block).0.unwrap_err();
        assert_eq!(error.to_string(), "servo 2: no answer in time", "{protocol:?}");
    }
}
