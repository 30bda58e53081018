//! Tests of the emulated servos in virtual time, with rustypot as the host, as with a real chain.

use std::sync::{Arc, Mutex};

use proptest::prelude::*;
use rustypot::DynamixelProtocolHandler as Host;
use tectum_servo::emulator::{EmulatedChain, EmulatedPort, ServoState, SteppedClock};
use tectum_servo::emulator::{EmulatorConfig, ServoFault, ServoFaultKind};
use tectum_servo::model::{Protocol, Register, ServoSeries};

const SECOND: u64 = 1_000_000_000;
const BAUD: u32 = 1_000_000;

/// A host, its port, and access to the chain behind it.
struct Bench {
    host: Host,
    port: EmulatedPort,
    clock: SteppedClock,
    chain: Arc<Mutex<EmulatedChain>>,
    series: &'static ServoSeries,
}

impl Bench {
    fn new(protocol: Protocol, ids: &[u8], settings: &EmulatorConfig) -> Self {
        let chain = Arc::new(Mutex::new(EmulatedChain::new(protocol, ids, BAUD, settings, 1)));
        let clock = SteppedClock::default();
        let port = EmulatedPort::new(Arc::clone(&chain), clock.clone(), BAUD);
        let host = match protocol {
            Protocol::Dynamixel => Host::v2(),
            Protocol::Feetech => Host::v1(),
        };
        Self { host, port, clock, chain, series: protocol.series() }
    }

    fn write(&mut self, id: u8, register: Register, value: i32) -> u8 {
        let data = &register.encode(value)[..usize::from(register.width)];
        self.host.write_with_error(&mut self.port, id, register.address, data).expect("an answer").byte()
    }

    fn read(&mut self, id: u8, register: Register) -> i32 {
        let bytes = self.host.read(&mut self.port, id, register.address, register.width).expect("an answer");
        register.decode(&bytes)
    }

    /// Velocity mode, with torque on.
    fn start_velocity_mode(&mut self, id: u8) {
        let series = self.series;
        assert_eq!(self.write(id, series.operating_mode, i32::from(series.velocity_mode)), 0);
        assert_eq!(self.write(id, series.torque_enable, 1), 0);
    }

    fn state(&self, i: usize) -> ServoState {
        self.chain.lock().unwrap().state(self.clock.now())[i].clone()
    }

    fn wait(&self, seconds: f64) {
        self.clock.step_to(self.clock.now() + (seconds * 1e9) as u64);
    }
}

const BOTH: [Protocol; 2] = [Protocol::Dynamixel, Protocol::Feetech];

fn fault(kind: ServoFaultKind, servo: u8, from: f64, until: f64) -> EmulatorConfig {
    let (from_s, until_s) = (Some(from), Some(until));
    let fault = ServoFault { kind, servo: Some(servo), from_s, until_s, probability: None, delay_ms: None };
    EmulatorConfig { faults: vec![fault], ..EmulatorConfig::default() }
}

#[test]
fn pings_reads_and_writes_are_answered() {
    for protocol in BOTH {
        let mut bench = Bench::new(protocol, &[1, 2, 7], &EmulatorConfig::default());
        let series = bench.series;
        for id in [1, 2, 7] {
            assert!(bench.host.ping(&mut bench.port, id).unwrap());
        }
        assert!(!bench.host.ping(&mut bench.port, 3).unwrap());
        let number = if protocol == Protocol::Dynamixel { 1200 } else { 777 };
        assert_eq!(bench.read(2, series.model), number);
        assert_eq!(bench.read(7, series.position), 2048);
        assert_eq!(bench.host.broadcast_ping(&mut bench.port).unwrap(), [1, 2, 7]);
        let block = series.state;
        let all = bench.host.sync_read(&mut bench.port, &[7, 1, 2], block.address, block.length).unwrap();
        assert!(all.iter().all(|bytes| block.decode(series.position, bytes) == Some(2048)));
        assert!(all.iter().all(|bytes| block.decode(series.temperature, bytes) == Some(32)));
    }
}

#[test]
fn no_servo_answers_at_another_baud_rate_and_a_new_id_applies_at_once() {
    for protocol in BOTH {
        let mut bench = Bench::new(protocol, &[1], &EmulatorConfig::default());
        let mut other = EmulatedPort::new(Arc::clone(&bench.chain), bench.clock.clone(), 57_600);
        assert!(!bench.host.ping(&mut other, 1).unwrap());
        let id = bench.series.id;
        bench.write(1, id, 9);
        assert!(bench.host.ping(&mut bench.port, 9).unwrap());
        assert!(!bench.host.ping(&mut bench.port, 1).unwrap());
    }
}

#[test]
fn a_synchronous_write_of_speeds_turns_the_shafts_accordingly() {
    for protocol in BOTH {
        let mut bench = Bench::new(protocol, &[1, 2], &EmulatorConfig::default());
        let series = bench.series;
        bench.start_velocity_mode(1);
        bench.start_velocity_mode(2);
        let goal = series.goal_velocity;
        let data: Vec<_> = [40, -40].iter().map(|&v| goal.encode(v)[..usize::from(goal.width)].to_vec()).collect();
        bench.host.sync_write(&mut bench.port, &[1, 2], goal.address, &data).unwrap();
        let from = [bench.state(0).position, bench.state(1).position];
        bench.wait(0.5);
        let expected = 0.5 * 40.0 * series.speed_unit / tectum_servo::model::STEP;
        for (i, sign) in [(0, 1.0), (1, -1.0)] {
            let turned = bench.state(i).position - from[i];
            assert!((turned - sign * expected).abs() < 1.0, "{protocol:?}: {turned} instead of {expected}");
            assert!((bench.read(1 + i as u8, series.velocity) - 40 * sign as i32).abs() <= 1);
        }
    }
}

#[test]
fn positions_are_reached_with_the_profile_and_without_torque_the_shaft_moves_by_hand() {
    for protocol in BOTH {
        let settings = EmulatorConfig { speed: Some(3.0), acceleration: Some(50.0), ..EmulatorConfig::default() };
        let mut bench = Bench::new(protocol, &[1], &settings);
        let series = bench.series;
        bench.write(1, series.torque_enable, 1);
        bench.write(1, series.goal_position, 3000);
        bench.wait(0.2);
        assert!((2100.0..2900.0).contains(&bench.state(0).position), "{:?}", bench.state(0));
        bench.wait(1.0);
        assert_eq!(bench.read(1, series.position), 3000);
        let now = bench.clock.now();
        assert!(bench.chain.lock().unwrap().move_by_hand(now, 1, 100.0));
        assert_eq!(bench.read(1, series.position), 3000, "with torque the shaft does not move by hand");
        bench.write(1, series.torque_enable, 0);
        assert!(bench.chain.lock().unwrap().move_by_hand(bench.clock.now(), 1, 100.0));
        bench.wait(5.0);
        assert_eq!(bench.read(1, series.position), 100);
        assert!(!bench.state(0).torque);
        // The old goal is kept.
        bench.write(1, series.torque_enable, 1);
        bench.wait(5.0);
        assert_eq!(bench.read(1, series.position), 3000);
    }
}

#[test]
fn dynamixel_refuses_writes_as_its_manual_says() {
    let mut bench = Bench::new(Protocol::Dynamixel, &[1], &EmulatorConfig::default());
    let series = bench.series;
    let limit = series.velocity_limit.unwrap();
    assert_eq!(bench.write(1, limit, 100), 0);
    assert_eq!(bench.write(1, series.goal_velocity, 101), 6);
    assert_eq!(bench.write(1, series.max_position, 3000), 0);
    assert_eq!(bench.write(1, series.goal_position, 3001), 6);
    assert_eq!(bench.write(1, series.torque_enable, 2), 4);
    assert_eq!(bench.write(1, series.position, 5), 7);
    assert_eq!(bench.write(1, series.torque_enable, 1), 0);
    assert_eq!(bench.write(1, series.operating_mode, 1), 7, "EEPROM while torque is on");
    assert_eq!(bench.read(1, series.operating_mode), 3);
}

#[test]
fn feetech_limits_positions_and_loses_values_that_were_written_while_locked() {
    let ends = fault(ServoFaultKind::CableOut, 1, 5.0, 6.0);
    let mut bench = Bench::new(Protocol::Feetech, &[1], &ends);
    let series = bench.series;
    let (lock, low, high) = (series.lock.unwrap(), series.min_position, series.max_position);
    bench.write(1, high, 3000);
    bench.write(1, lock, 0);
    bench.write(1, low, 1000);
    bench.write(1, lock, 1);
    bench.write(1, series.goal_position, 100);
    bench.wait(1.0);
    assert_eq!(bench.read(1, series.position), 1000);
    assert!(bench.state(0).torque, "a goal position turns torque on");
    bench.clock.step_to(7 * SECOND);
    assert_eq!((bench.read(1, low), bench.read(1, high)), (1000, 4095));
    assert!(!bench.state(0).torque);
}

#[test]
fn the_bus_watchdog_stops_a_dynamixel_without_instructions() {
    let mut bench = Bench::new(Protocol::Dynamixel, &[1], &EmulatorConfig::default());
    let series = bench.series;
    let watchdog = series.bus_watchdog.unwrap();
    bench.start_velocity_mode(1);
    bench.write(1, watchdog, 5);
    bench.write(1, series.goal_velocity, 100);
    let from = bench.state(0).position;
    bench.wait(10.0);
    let turned = bench.state(0).position - from;
    let expected = 0.1 * 100.0 * series.speed_unit / tectum_servo::model::STEP;
    assert!((turned - expected).abs() < expected * 0.02, "{turned} steps, {expected} in 100 ms");
    assert_eq!(bench.read(1, watchdog), 255);
    assert_eq!(bench.write(1, series.goal_velocity, 50), 4);
    bench.write(1, watchdog, 0);
    assert_eq!(bench.write(1, series.goal_velocity, 50), 0);
}

#[test]
fn an_overload_turns_torque_off_and_a_dynamixel_needs_a_reboot() {
    for protocol in BOTH {
        let mut bench = Bench::new(protocol, &[1, 2], &fault(ServoFaultKind::Overload, 2, 1.0, 9.0));
        let series = bench.series;
        bench.start_velocity_mode(2);
        bench.write(2, series.goal_velocity, 30);
        bench.clock.step_to(SECOND * 2);
        assert_eq!(bench.read(2, series.load), 1000);
        assert!(bench.state(1).torque);
        bench.clock.step_to(SECOND * 4);
        assert!(!bench.state(1).torque);
        assert_eq!(bench.read(2, series.hardware_error), 1 << 5);
        bench.clock.step_to(SECOND * 10);
        let refused = bench.write(2, series.torque_enable, 1);
        if protocol == Protocol::Dynamixel {
            assert_eq!(refused, 0x80 | 7);
            bench.host.reboot(&mut bench.port, 2).unwrap();
        }
        assert_eq!(bench.write(2, series.torque_enable, 1), 0);
        assert!(bench.state(1).torque);
    }
}

#[test]
fn heat_low_voltage_and_a_loose_cable_are_reported_and_turn_torque_off() {
    for protocol in BOTH {
        let mut bench = Bench::new(protocol, &[1, 2, 3], &fault(ServoFaultKind::Hot, 1, 1.0, 2.0));
        let series = bench.series;
        bench.write(1, series.torque_enable, 1);
        bench.clock.step_to(SECOND * 3 / 2);
        assert_eq!(bench.read(1, series.temperature), bench.read(1, series.temperature_limit) + 5);
        assert!(!bench.state(0).torque, "{protocol:?}");

        let mut bench = Bench::new(protocol, &[1, 2, 3], &fault(ServoFaultKind::BrownOut, 1, 1.0, 2.0));
        bench.write(1, series.torque_enable, 1);
        bench.clock.step_to(SECOND * 3 / 2);
        assert!(bench.read(1, series.voltage) < bench.read(1, series.min_voltage));
        bench.clock.step_to(SECOND * 5 / 2);
        assert!(!bench.state(0).torque, "it restarts without torque");

        let mut bench = Bench::new(protocol, &[1, 2, 3], &fault(ServoFaultKind::CableOut, 2, 1.0, 2.0));
        bench.write(3, series.torque_enable, 1);
        bench.clock.step_to(SECOND);
        let answers = [1, 2, 3].map(|id| bench.host.ping(&mut bench.port, id).unwrap());
        assert_eq!(answers, [true, false, false]);
        bench.clock.step_to(SECOND * 2);
        assert!(bench.host.ping(&mut bench.port, 3).unwrap());
        assert!(!bench.state(2).torque);
    }
}

#[test]
fn faults_of_answers_are_errors_at_the_host() {
    for protocol in BOTH {
        for kind in
            [ServoFaultKind::NoReply, ServoFaultKind::BadChecksum, ServoFaultKind::WrongId, ServoFaultKind::Slow]
        {
            let mut bench = Bench::new(protocol, &[1, 2], &fault(kind, 2, 1.0, 2.0));
            let block = bench.series.motion;
            let mut ask = |at: u64| {
                bench.clock.step_to(at);
                bench.host.sync_read(&mut bench.port, &[1, 2], block.address, block.length).map(|all| all.len())
            };
            assert_eq!(ask(SECOND / 2).unwrap(), 2);
            let error = ask(SECOND).unwrap_err().to_string();
            assert!(error.contains("motor 2"), "{kind:?}: {error}");
            assert_eq!(ask(SECOND * 3).unwrap(), 2, "{kind:?}");
        }
    }
}

#[test]
fn two_servos_with_one_id_cannot_be_read() {
    for protocol in BOTH {
        let mut bench = Bench::new(protocol, &[1, 2, 2], &EmulatorConfig::default());
        let position = bench.series.position;
        assert!(bench.host.read(&mut bench.port, 1, position.address, position.width).is_ok());
        let error = bench.host.read(&mut bench.port, 2, position.address, position.width).unwrap_err();
        assert!(error.to_string().contains("hecksum"), "{error}");
    }
}

#[test]
fn the_same_seed_and_bytes_give_the_same_answers() {
    let run = |seed| {
        let probability = Some(0.2);
        let noisy = ServoFault { probability, ..fault(ServoFaultKind::NoReply, 1, 0.0, 100.0).faults[0].clone() };
        let settings = EmulatorConfig {
            noise: 2.0,
            latency_us: 100.0,
            jitter_us: 300.0,
            faults: vec![noisy],
            ..EmulatorConfig::default()
        };
        let mut chain = EmulatedChain::new(Protocol::Feetech, &[1], BAUD, &settings, seed);
        let mut all = Vec::new();
        for k in 1..200_u64 {
            chain.receive(k * 10_000_000, BAUD, &[0xff, 0xff, 1, 4, 2, 56, 2, 0xbe]);
            while let Some(due) = chain.next_answer() {
                all.push((due, chain.take(due)));
            }
        }
        all
    };
    assert_eq!(run(3), run(3));
    assert_ne!(run(3), run(4));
    assert!((120..190).contains(&run(3).len()), "{}", run(3).len());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_bytes_at_any_time_leave_a_finite_state(
        pieces in prop::collection::vec((prop::collection::vec(any::<u8>(), 0..40), 0_u64..50_000_000), 0..20),
    ) {
        for protocol in BOTH {
            let mut chain = EmulatedChain::new(protocol, &[1, 2, 2], BAUD, &EmulatorConfig::default(), 1);
            let mut now = 0;
            for (bytes, later) in &pieces {
                now += later;
                chain.receive(now, 0, bytes);
            }
            prop_assert!(chain.state(now + SECOND).iter().all(|servo| servo.position.is_finite()));
        }
    }

    #[test]
    fn values_written_by_rustypot_are_read_back(values in prop::collection::vec(any::<u32>(), 4)) {
        // Profile registers accept any bytes; those that look like a header must be stuffed and read back.
        let mut bench = Bench::new(Protocol::Dynamixel, &[1], &EmulatorConfig::default());
        for value in values {
            let bytes = (value | 0x00fd_ffff).to_le_bytes();
            bench.host.write(&mut bench.port, 1, 108, &bytes).unwrap();
            prop_assert_eq!(bench.host.read(&mut bench.port, 1, 108, 4).unwrap(), bytes);
        }
    }
}
