//! What each fault does to an arm on servos: the bridge on emulated chains, in virtual time.
//!
//! The effects must equal `tests/snapshots/servo_faults.txt`. A change of that table is a change of the bridge's
//! reaction to faults and must be reviewed there. To write it anew: `TECTUM_BLESS=1 cargo test --test bridge_faults`.

#[path = "support/snapshot.rs"]
mod snapshot;
#[path = "support/virtual_bridge.rs"]
mod virtual_bridge;

use std::fmt::Write as _;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use rand::RngExt as _;
use snapshot::assert_snapshot;
use tectum::scenario::{EmulatorConfig, JointConfig, JointMapping, Plan, Rearm, Scenario, ServoFault, ServoFaultKind};
use tectum::seed::stream;
use tectum::servo::bridge::{Bridge, TripCause, joints_of};
use tectum::servo::emulator::{EmulatedChain, SteppedClock};
use tectum::servo::follower::FollowerAgent;
use tectum::servo::model::{Protocol, STEP};
use tectum::servo::tools::{Calibration, Teleop, TeleopArm, teleop_scenario};
use tectum::wire::{MAX_OUTPUTS, Observation, flag};
use virtual_bridge::{Setup, bus_that_reopens, bus_to, plan, run, run_with, set_up, with_protocol};

/// The faults of the table: name, and the keys of the emulator's fault from tick 100 to tick 200.
const FAULTS: [(&str, &str); 9] = [
    ("none", ""),
    ("no-reply", "kind = \"no-reply\""),
    ("bad-checksum", "kind = \"bad-checksum\""),
    ("wrong-id", "kind = \"wrong-id\""),
    ("slow", "kind = \"slow\"\ndelay_ms = 30.0"),
    ("cable-out", "kind = \"cable-out\""),
    ("overload", "kind = \"overload\""),
    ("brown-out", "kind = \"brown-out\""),
    ("hot", "kind = \"hot\""),
];

/// Runs one fault and describes its effect in a line. With `no_commands`, the bridge receives no commands during the
/// fault.
fn row(name: &str, emulator: &str, protocol: &str, no_commands: bool) -> String {
    let plan = plan(emulator, 400, |text| text.replace("\"dynamixel\" ", &format!("\"{protocol}\" ")));
    let mut setup = set_up(&plan);
    setup.bridge.arm().unwrap();
    let (all, torque, bridge) = run(&plan, setup, |tick| !no_commands || !(100..200).contains(&tick));
    for observation in &all {
        assert!(observation.applied.iter().all(|u| u.abs() <= 0.0101), "{name}: {:?}", observation.applied);
    }
    // Who fell silent is named.
    for event in bridge.report.events.iter().filter(|event| event.cause == TripCause::BusLost) {
        assert_eq!(event.servo, Some(2), "{name}");
    }
    let effect = effect(&torque, &bridge);
    format!("{protocol:<10} {name:<14} {:>6} blind  {effect}", bridge.report.blind)
}

/// After how long torque went off, when it came back, and why it was off. The fault began at tick 100.
fn effect(torque: &[bool], bridge: &Bridge) -> String {
    let off = (100..400).find(|&tick| !torque[tick]);
    let back = off.and_then(|off| (off..400).find(|&tick| torque[tick]));
    let mut causes: Vec<String> = bridge.report.events.iter().map(|event| event.cause.to_string()).collect();
    causes.dedup();
    let at = |tick: Option<usize>| tick.map_or("-".to_owned(), |tick| format!("{} ms", (tick as i64 - 99) * 50));
    format!("torque off after {:>8}, on again after {:>8}  {}", at(off), at(back), causes.join(", "))
}

/// What happens to a bridge that loses its port, its guard, or time, from tick 100 on.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Loss {
    CableOut,
    Asleep,
    Frozen,
    GuardDead,
}

/// Runs a loss that is over at tick 120, and describes its effect in a line.
fn loss_row(name: &str, loss: Loss, protocol: Protocol, rearm: &str) -> String {
    let plan = plan("", 400, |text| {
        with_protocol(&text, protocol).replace("armed = true ", &format!("rearm = \"{rearm}\"\narmed = true "))
    });
    let servos = plan.scenario.plant.servos.clone().unwrap();
    let chain = EmulatedChain::new(protocol, &[1, 2, 3, 4], servos.baud, &EmulatorConfig::default(), 1);
    let (chain, clock) = (Arc::new(Mutex::new(chain)), SteppedClock::default());
    let bus = bus_that_reopens(&chain, &clock, &plan);
    let mut bridge = Bridge::new(&plan, bus, joints_of(&plan).unwrap(), Box::new(|_| {})).unwrap();
    let tick_now = Arc::new(AtomicU64::new(0));
    let at = |tick: &Arc<AtomicU64>| tick.load(Ordering::Relaxed);
    let (of_guard, of_clock) = (Arc::clone(&tick_now), Arc::clone(&tick_now));
    bridge.set_guard(Box::new(move |_| loss != Loss::GuardDead || at(&of_guard) < 100));
    bridge.set_sleep_clock(Box::new(
        move || if loss == Loss::Asleep && at(&of_clock) >= 100 { 3_600_000_000_000 } else { 0 },
    ));
    bridge.arm().unwrap();
    let (line, time) = (Arc::clone(&chain), clock.clone());
    let setup = Setup { chain, clock, bridge };
    let (_, torque, bridge) = run(&plan, setup, |tick| {
        tick_now.store(tick, Ordering::Relaxed);
        match (loss, tick) {
            (Loss::CableOut, 100) => line.lock().unwrap().pull_cable(),
            (Loss::CableOut, 120) => line.lock().unwrap().put_cable_back(),
            (Loss::Frozen, 100) => time.step_to(time.now() + 500_000_000),
            _ => {}
        }
        true
    });
    format!("{:<10} {name:<14} {rearm:<9}  {}", protocol.name(), effect(&torque, &bridge))
}

/// What happens to the leader of an arm that follows it, from tick 100 on.
#[derive(Debug, Clone, Copy, PartialEq)]
enum LeaderLoss {
    Silent,
    CableOut,
    Fault,
}

/// The scenario of a follower with two joints, and of its leader.
fn teleop_plan(protocol: Protocol, rearm: Rearm) -> Plan {
    let joint = |id: u8| JointConfig {
        id,
        name: None,
        direction: 1,
        zero: 2048,
        range: [-1.5, 1.5],
        max_speed: 3.0,
        registers: Default::default(),
    };
    let arm = |port: &str, ids: [u8; 2]| TeleopArm {
        port: port.to_owned(),
        baud: 1_000_000,
        calibration: Calibration { protocol, joints: ids.map(joint).to_vec() },
    };
    let teleop = Teleop {
        leader: arm("leader", [1, 2]),
        follower: arm("follower", [11, 12]),
        mapping: JointMapping::Scale,
        held: Vec::new(),
        max_speed: 3.0,
        approach_speed: 0.5,
        period_ms: 50.0,
        ticks: 400,
        rearm,
        armed: true,
    };
    Scenario::parse(&teleop_scenario(&teleop).unwrap().0, "teleop").unwrap().plan().unwrap()
}

/// Runs a loss of the leader that is over at tick 120, and describes its effect on the follower in a line. A hand moves
/// the leader all the time.
fn leader_row(name: &str, loss: LeaderLoss, protocol: Protocol, rearm: Rearm) -> String {
    let plan = teleop_plan(protocol, rearm);
    let chain = |ids: &[u8]| EmulatedChain::new(protocol, ids, 1_000_000, &EmulatorConfig::default(), 1);
    let (leader, follower) = (Arc::new(Mutex::new(chain(&[1, 2]))), Arc::new(Mutex::new(chain(&[11, 12]))));
    let clock = SteppedClock::default();
    let bus = bus_that_reopens(&follower, &clock, &plan);
    let mut bridge = Bridge::new(&plan, bus, joints_of(&plan).unwrap(), Box::new(|_| {})).unwrap();
    bridge.set_leader(bus_that_reopens(&leader, &clock, &plan)).unwrap();
    bridge.arm().unwrap();
    let setup = Setup { chain: follower, clock: clock.clone(), bridge };
    let (all, torque, bridge, _) = run_with(&plan, setup, FollowerAgent::new(&plan).unwrap(), |tick| {
        let (mut leader, now) = (leader.lock().unwrap(), clock.now());
        leader.move_by_hand(now, 1, 2048.0 + 400.0 * (tick as f64 / 20.0).sin());
        let fault = |kind| ServoFault { kind, servo: Some(2), until_s: Some(1.0), ..NO_FAULT };
        match (loss, tick) {
            (LeaderLoss::Silent, 100) => leader.add_fault(now, fault(ServoFaultKind::NoReply)),
            (LeaderLoss::Fault, 100) => leader.add_fault(now, fault(ServoFaultKind::BrownOut)),
            (LeaderLoss::CableOut, 100) => leader.pull_cable(),
            (LeaderLoss::CableOut, 120) => leader.put_cable_back(),
            _ => {}
        }
        true
    });
    // A leader never has torque, and its follower is where it is, as far as it has torque.
    assert!(leader.lock().unwrap().state(clock.now()).iter().all(|servo| !servo.torque));
    let apart = |tick: usize| all[tick].measures[0];
    assert!(apart(99) < 0.2, "{name}: {} rad apart", apart(99));
    assert!(!torque[399] || apart(399) < 0.2, "{name}: {} rad apart", apart(399));
    let rearm = if rearm.is_automatic() { "automatic" } else { "by-hand" };
    format!("{:<10} {name:<16} {rearm:<9}  {}", protocol.name(), effect(&torque, &bridge))
}

#[test]
fn each_fault_has_its_recorded_effect() {
    let mut table = String::from("A fault from tick 100 to tick 200 of 400, of 50 ms each: what it does.\n\n");
    for protocol in ["dynamixel", "feetech"] {
        for (name, fault) in FAULTS {
            let text = match fault {
                "" => String::new(),
                fault => format!("[[plant.emulator.faults]]\n{fault}\nservo = 2\nfrom_s = 5.0\nuntil_s = 10.0\n"),
            };
            writeln!(table, "{}", row(name, &text, protocol, false)).unwrap();
        }
        writeln!(table, "{}", row("commands away", "", protocol, true)).unwrap();
    }
    table += "\nA loss at tick 100 of 400, of 50 ms each, over at tick 120 (by itself, or when armed by hand).\n\n";
    for protocol in [Protocol::Dynamixel, Protocol::Feetech] {
        for (name, loss) in [
            ("cable out", Loss::CableOut),
            ("asleep", Loss::Asleep),
            ("frozen", Loss::Frozen),
            ("guard dead", Loss::GuardDead),
        ] {
            for rearm in ["automatic", "by-hand"] {
                writeln!(table, "{}", loss_row(name, loss, protocol, rearm)).unwrap();
            }
        }
    }
    table += "\nA loss of the leader at tick 100 of 400, of 50 ms each, over at tick 120: what its follower does.\n\n";
    for protocol in [Protocol::Dynamixel, Protocol::Feetech] {
        for (name, loss) in [
            ("leader silent", LeaderLoss::Silent),
            ("leader cable out", LeaderLoss::CableOut),
            ("leader fault", LeaderLoss::Fault),
        ] {
            for rearm in [Rearm::Automatic, Rearm::ByHand] {
                writeln!(table, "{}", leader_row(name, loss, protocol, rearm)).unwrap();
            }
        }
    }
    assert_snapshot("tests/snapshots/servo_faults.txt", &table);
}

/// Ticks of an hour, and of the longest fault in it.
const HOUR: u64 = 72_000;
const LONGEST: u64 = 60;

/// What happens in the hour beside answers that are lost, late or damaged.
const EVENTS: [&str; 8] =
    ["cable out", "asleep", "frozen", "overload", "brown-out", "hot", "commands away", "a servo's cable out"];

/// An hour in which everything fails that can come back, at random instants: every few seconds one of [`EVENTS`], and
/// one answer in a thousand is lost, damaged, late, or another servo's. The applied command is always within limits, no
/// tick takes longer than its period, no servo has torque in a tick whose flags say that torque is off, and no shaft
/// turns further without an instruction than its highest speed makes of five periods. An operator arms it every ten
/// seconds.
fn an_hour_of_faults(protocol: Protocol, goal: &str) {
    let mixed: String = ["no-reply", "bad-checksum", "wrong-id", "slow", "cable-out"]
        .map(|kind| format!("[[plant.emulator.faults]]\nkind = \"{kind}\"\nprobability = 0.001\n"))
        .concat();
    // Position goals need ends.
    let range = if goal == "position" { "range = [-3.0, 3.0]\n" } else { "" };
    let plan = plan(&mixed, HOUR, |text| {
        let text = with_protocol(&text, protocol).replace("\"learned-reward\"", "\"paper\"");
        // Fast, so that a shaft that nobody stops turns far.
        let text = text.replace("sigma = 0.001", "sigma = 0.01");
        let text = text.replace("goal = \"speed\"", &format!("goal = \"{goal}\""));
        text.replace("max_speed = 12.0", &format!("{range}max_speed = 12.0"))
    });
    let settings = plan.scenario.plant.emulator.clone().unwrap();
    let chain = EmulatedChain::new(protocol, &[1, 2, 3, 4], 1_000_000, &settings, 1);
    let (chain, clock) = (Arc::new(Mutex::new(chain)), SteppedClock::default());
    let bus = bus_that_reopens(&chain, &clock, &plan);
    let mut bridge = Bridge::new(&plan, bus, joints_of(&plan).unwrap(), Box::new(|_| {})).unwrap();
    let slept = Arc::new(AtomicU64::new(0));
    let of_clock = Arc::clone(&slept);
    bridge.set_sleep_clock(Box::new(move || of_clock.load(Ordering::Relaxed)));
    bridge.arm().unwrap();
    let key = bridge.arm_request();
    let (mut rng, line, time) = (stream(1, "faults of the hour"), Arc::clone(&chain), clock.clone());
    let (mut next, mut back, mut away, mut happened) = (LONGEST, 0, 0, [0_u64; EVENTS.len()]);
    let setup = Setup { chain: Arc::clone(&chain), clock: clock.clone(), bridge };
    let (all, torque, bridge) = run(&plan, setup, |tick| {
        key.store(tick % 200 == 0, Ordering::Relaxed);
        let (mut line, now) = (line.lock().unwrap(), time.now());
        if tick == back {
            line.put_cable_back();
        }
        if tick >= next {
            let (event, ticks) = (rng.random_range(0..EVENTS.len()), rng.random_range(1..=LONGEST));
            next = tick + LONGEST + rng.random_range(0..300);
            happened[event] += 1;
            let servo = Some(rng.random_range(1..=4));
            let fault = |kind| ServoFault { kind, servo, until_s: Some(ticks as f64 * 0.05), ..NO_FAULT };
            match EVENTS[event] {
                "cable out" => (line.pull_cable(), back = tick + ticks).0,
                "asleep" => drop(slept.fetch_add(3_600_000_000_000, Ordering::Relaxed)),
                "frozen" => time.step_to(now + ticks * plan.period_ns),
                "overload" => line.add_fault(now, fault(ServoFaultKind::Overload)),
                "brown-out" => line.add_fault(now, fault(ServoFaultKind::BrownOut)),
                "hot" => line.add_fault(now, fault(ServoFaultKind::Hot)),
                "commands away" => away = tick + ticks,
                _ => line.add_fault(now, fault(ServoFaultKind::CableOut)),
            }
        }
        tick >= away
    });
    let most = 0.01 * 1.0001;
    let blind = |observation: &Observation| observation.header.flags & flag::BLIND != 0;
    for (pair, on) in all.windows(2).zip(&torque) {
        let (tick, [before, observation]) = (pair[0].header.tick, pair) else { unreachable!() };
        let off = observation.header.flags & (flag::UNARMED | flag::TRIPPED) != 0;
        assert!(observation.applied.iter().all(|u| u.abs() <= most), "{:?}", observation.applied);
        assert!(!off || observation.applied == [0.0; MAX_OUTPUTS], "tick {tick}");
        // A port that is back turns torque off at the end of a tick, which is read after that.
        assert!(!(off && *on) || blind(observation) || blind(before), "tick {tick}");
    }
    let turned = chain.lock().unwrap().state(clock.now()).iter().map(|servo| servo.unattended).fold(0.0, f64::max);
    let (turned, with_torque) = (turned * STEP, torque.iter().filter(|on| **on).count());
    let mut causes: Vec<String> = bridge.report.events.iter().map(|event| event.cause.to_string()).collect();
    causes.sort();
    causes.dedup();
    println!(
        "{}: {} events {happened:?}, {} blind ticks, {with_torque} with torque, turned {turned:.2} rad; {causes:?}",
        protocol.name(),
        happened.iter().sum::<u64>(),
        bridge.report.blind
    );
    assert!(happened.iter().all(|&times| times > 10), "{happened:?}");
    assert!(turned <= 5.0 * 0.05 * 12.0, "a shaft turned {turned} rad without an instruction");
    assert!(bridge.report.blind > 10 && with_torque > 15_000, "{with_torque} ticks with torque; {causes:?}");
}

/// A fault without a window.
const NO_FAULT: ServoFault = ServoFault {
    kind: ServoFaultKind::NoReply,
    servo: None,
    from_s: None,
    until_s: None,
    probability: None,
    delay_ms: None,
};

#[test]
fn an_hour_of_every_fault_on_dynamixel() {
    an_hour_of_faults(Protocol::Dynamixel, "speed");
}

/// A Feetech has no watchdog: its goals are positions.
#[test]
fn an_hour_of_every_fault_on_feetech() {
    an_hour_of_faults(Protocol::Feetech, "position");
}

/// A panic with torque on, here in the callback for messages, turns torque off before the process ends.
#[test]
fn a_panic_turns_torque_off() {
    let plan = plan("", 100, |text| text);
    let servos = plan.scenario.plant.servos.as_ref().unwrap();
    let chain = EmulatedChain::new(servos.protocol, &[1, 2, 3, 4], servos.baud, &EmulatorConfig::default(), 1);
    let (chain, clock) = (Arc::new(Mutex::new(chain)), SteppedClock::default());
    let bus = bus_to(&chain, &clock, &plan);
    let had_torque = Arc::new(Mutex::new(false));
    let (observed, now, result) = (Arc::clone(&chain), clock.clone(), Arc::clone(&had_torque));
    let report = move |text: &str| {
        if text.contains("torque is on") {
            *result.lock().unwrap() = observed.lock().unwrap().state(now.now()).iter().all(|servo| servo.torque);
            panic!("a panic like any other");
        }
    };
    let mut bridge = Bridge::new(&plan, bus, joints_of(&plan).unwrap(), Box::new(report)).unwrap();
    bridge.arm().unwrap();
    let setup = Setup { chain: Arc::clone(&chain), clock: clock.clone(), bridge };
    let ended = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| run(&plan, setup, |_| true)));
    assert!(ended.is_err() && *had_torque.lock().unwrap(), "it did not panic with torque on");
    assert!(chain.lock().unwrap().state(clock.now()).iter().all(|servo| !servo.torque));
}
