//! The bridge on the emulated chain, in virtual time: replacing the simulator, learning, limits, and the effect of each
//! fault.
//!
//! The effects of faults must equal `tests/snapshots/servo_faults.txt`. A change of that table is a change of the
//! bridge's reaction to faults and must be reviewed there. To write it anew: `TECTUM_BLESS=1 cargo test --test bridge`.

#[path = "support/snapshot.rs"]
mod snapshot;

use std::fmt::Write as _;
use std::sync::{Arc, Mutex};

use snapshot::assert_snapshot;
use tectum::runtime::{Controller, PlantSide};
use tectum::scenario::{EmulatorConfig, Plan, Scenario};
use tectum::servo::bridge::{Bridge, BridgeError, SafetyState, TripCause, joints_of};
use tectum::servo::bus::{Bus, BusError};
use tectum::servo::emulator::{EmulatedChain, EmulatedPort, SteppedClock};
use tectum::servo::model::{Protocol, ServoModel};
use tectum::servo::tools::calibrate;
use tectum::wire::{Command, Learning, MAX_OUTPUTS, Observation, Vision, flag};

/// The plan of `scenarios/servo-emulated.toml` with this emulator, this number of ticks, and `change` applied to its
/// text.
fn plan(emulator: &str, ticks: u64, change: impl FnOnce(String) -> String) -> Plan {
    let text = std::fs::read_to_string("scenarios/servo-emulated.toml").unwrap();
    let (head, tail) = text.split_once("\n[plant.emulator]\n").unwrap();
    let (_, tail) = tail.split_once("[encoder]").unwrap();
    let text = change(format!("{head}\n[plant.emulator]\n{emulator}\n[encoder]{tail}"));
    let mut scenario = Scenario::parse(&text, "bridge").unwrap();
    scenario.ticks = ticks;
    scenario.plan().unwrap()
}

/// A bridge on an emulated chain.
struct Setup {
    chain: Arc<Mutex<EmulatedChain>>,
    clock: SteppedClock,
    bridge: Bridge,
}

/// A bridge on the chain that the plan describes.
fn set_up(plan: &Plan) -> Setup {
    let servos = plan.scenario.plant.servos.as_ref().unwrap();
    let ids: Vec<u8> = joints_of(plan).unwrap().iter().map(|joint| joint.id).collect();
    let ideal = EmulatorConfig::default();
    let settings = plan.scenario.plant.emulator.as_ref().unwrap_or(&ideal);
    let chain = EmulatedChain::new(servos.protocol, &ids, servos.baud, settings, plan.scenario.seed);
    set_up_on(plan, chain).unwrap()
}

/// A bridge on any chain, which may differ from the plan's.
fn set_up_on(plan: &Plan, chain: EmulatedChain) -> Result<Setup, BridgeError> {
    let (chain, clock) = (Arc::new(Mutex::new(chain)), SteppedClock::default());
    let bridge = Bridge::new(plan, bus_to(&chain, &clock, plan), joints_of(plan)?, Box::new(|_| {}))?;
    Ok(Setup { chain, clock, bridge })
}

/// The plan's host side of the bus.
fn bus_to(chain: &Arc<Mutex<EmulatedChain>>, clock: &SteppedClock, plan: &Plan) -> Bus {
    let servos = plan.scenario.plant.servos.as_ref().unwrap();
    let (port, now) = (EmulatedPort::new(Arc::clone(chain), clock.clone(), servos.baud), clock.clone());
    Bus::over(Box::new(port), servos.protocol, Bridge::budget(plan), Box::new(move || now.now()))
}

/// A scenario's text with another protocol.
fn with_protocol(text: &str, protocol: Protocol) -> String {
    text.replace("\"dynamixel\" ", &format!("\"{}\" ", protocol.name()))
}

/// The error at the end of a target, averaged over the targets of the last quarter of the run.
fn end_error(observations: &[Observation]) -> f64 {
    let late = &observations[observations.len() * 3 / 4..];
    let ends: Vec<f64> =
        late.iter().filter(|o| o.header.flags & flag::NEW_TARGET != 0).map(|o| f64::from(o.measures[0])).collect();
    ends.iter().sum::<f64>() / ends.len() as f64
}

/// One run in virtual time. `command_arrives` decides for every tick whether the bridge receives the command. Returns
/// the observations, whether any servo had torque at the end of each tick, and the bridge.
fn run(plan: &Plan, setup: Setup, command_arrives: impl FnMut(u64) -> bool) -> (Vec<Observation>, Vec<bool>, Bridge) {
    let (all, torque, bridge, _) = run_learning(plan, setup, command_arrives);
    (all, torque, bridge)
}

/// The same, and returns the learning sample of each tick as well.
fn run_learning(
    plan: &Plan,
    setup: Setup,
    mut command_arrives: impl FnMut(u64) -> bool,
) -> (Vec<Observation>, Vec<bool>, Bridge, Vec<Learning>) {
    let Setup { chain, clock, bridge } = setup;
    let mut t0 = clock.now();
    let mut side = PlantSide::new(bridge, plan);
    let mut controller = Controller::new(plan);
    let (mut observation, mut command) = (Observation::default(), Command::default());
    let (mut all, mut torque, mut learned) = (Vec::new(), Vec::new(), Vec::new());
    for tick in 0..plan.scenario.ticks {
        side.observe(tick, 0, 0, &mut observation);
        all.push(observation);
        controller.respond(&observation, &mut command);
        controller.after_command(&observation);
        let mut learning = Learning::default();
        controller.record(&observation, &mut learning);
        learned.push(learning);
        let before = clock.now();
        let arrives = command_arrives(tick);
        // A test may let time pass here, as if the process had been stopped.
        t0 += clock.now() - before;
        side.apply(tick, arrives.then_some(&command), true);
        let end = t0 + (tick + 1) * plan.period_ns;
        assert!(clock.now() <= end, "tick {tick}: the bus took longer than the tick");
        clock.step_to(end);
        torque.push(chain.lock().unwrap().state(end).iter().any(|servo| servo.torque));
        side.finish_step(tick);
    }
    (all, torque, side.into_body(), learned)
}

#[test]
fn the_emulated_and_simulated_scenarios_differ_only_in_the_plant() {
    let load = |name: &str| Scenario::load(format!("scenarios/{name}.toml").as_ref()).unwrap();
    let (mut emulated, simulated) = (load("servo-emulated"), load("servo-simulated"));
    assert_ne!(emulated, simulated);
    (emulated.name, emulated.plant) = (simulated.name.clone(), simulated.plant.clone());
    emulated.source = simulated.source.clone();
    assert_eq!(emulated, simulated);
}

/// The same seed gives simulator and emulator the same targets. The mean error of four seeds on the bridge must lie
/// within the simulator's spread over eight seeds.
#[test]
fn an_ideal_chain_learns_as_the_simulator_does() {
    let ticks = 1600;
    let simulated = |seed| {
        let mut scenario = Scenario::load("scenarios/servo-simulated.toml".as_ref()).unwrap();
        (scenario.seed, scenario.ticks) = (seed, ticks);
        let plan = scenario.plan().unwrap();
        let mut all = Vec::new();
        tectum::runtime::in_process_with_observer(&plan, plan.simulated_plant().unwrap(), |observation, _| {
            all.push(*observation);
            true
        });
        end_error(&all)
    };
    let emulated = |seed| {
        let plan = plan("", ticks, |text| text.replace("\nseed = 1", &format!("\nseed = {seed}")));
        let mut setup = set_up(&plan);
        setup.bridge.arm().unwrap();
        end_error(&run(&plan, setup, |_| true).0)
    };
    // Two threads take half of the seeds each.
    let (simulated, emulated) = std::thread::scope(|scope| {
        let halves = [1..=4, 5..=8].map(|seeds| {
            scope.spawn(|| {
                let of_both = |seed| (simulated(seed), (seed % 2 == 0).then(|| emulated(seed)));
                seeds.map(of_both).collect::<Vec<(f64, Option<f64>)>>()
            })
        });
        let all: Vec<_> = halves.into_iter().flat_map(|half| half.join().unwrap()).collect();
        (all.iter().map(|one| one.0).collect::<Vec<_>>(), all.iter().filter_map(|one| one.1).collect::<Vec<_>>())
    });
    let mean = emulated.iter().sum::<f64>() / emulated.len() as f64;
    let (low, high) = simulated.iter().fold((f64::MAX, 0.0_f64), |(low, high), &e| (low.min(e), high.max(e)));
    assert!((low..=high).contains(&mean), "mean {mean} m of {emulated:?} m; the simulator has {simulated:?} m");
}

#[test]
fn an_unarmed_bridge_reads_and_keeps_torque_off() {
    let plan = plan("", 100, |text| text);
    let (all, torque, bridge) = run(&plan, set_up(&plan), |_| true);
    assert_eq!(bridge.state(), SafetyState::ReadOnly);
    assert!(torque.iter().all(|on| !on));
    for observation in &all[1..] {
        assert_eq!(observation.applied, [0.0; MAX_OUTPUTS]);
        assert_ne!(observation.header.flags & flag::UNARMED, 0);
    }
}

#[test]
fn commands_ramp_up_after_late_arming() {
    let plan =
        plan("", 140, |text| text.replace("\"learned-reward\"", "\"paper\"").replace("sigma = 0.001", "sigma = 0.01"));
    let setup = set_up(&plan);
    let key = setup.bridge.arm_request();
    // Torque is turned on long after the gate's ramp of the start has ended.
    let (all, torque, _) = run(&plan, setup, |tick| {
        key.store(tick == 100, std::sync::atomic::Ordering::Relaxed);
        true
    });
    let first = torque.iter().position(|&on| on).unwrap();
    assert_eq!(first, 100);
    for (tick, observation) in (0..).zip(&all).skip(first + 1) {
        let most = 0.01 * ((tick - first) as f32 / 21.0).min(1.0);
        assert!(observation.applied.iter().all(|u| u.abs() <= most + 1e-6), "tick {tick}: {:?}", observation.applied);
    }
    assert!(all[first + 1].header.flags & flag::RAMPED != 0);
}

/// A tracker that publishes from tick 0, publishes nothing from tick 100 to 149, and whose target jumps at tick 60.
#[test]
fn vision_sets_the_target_and_a_blind_arm_stands_still() {
    let plan = plan("", 200, |text| {
        let text = text.replace("\"learned-reward\"", "\"paper\"");
        text.replace("armed = true ", "sight = \"vision\"\narmed = true ")
    });
    assert_eq!(plan.measures[3..], ["bus_read_us", "bus_write_us", "vision_age_ms"]);
    let mut setup = set_up(&plan);
    let samples = Arc::new(Mutex::new(std::collections::VecDeque::new()));
    let queue = Arc::clone(&samples);
    setup.bridge.set_vision_source(Box::new(move || queue.lock().unwrap().pop_front()));
    setup.bridge.arm().unwrap();
    let clock = setup.clock.clone();
    let (first, second, end) = ([0.3, 0.2], [-0.4, 0.1], [0.1_f32, 0.25]);
    let (all, torque, bridge, learned) = run_learning(&plan, setup, |tick| {
        if !(100..150).contains(&tick) {
            let mut sample = Vision { target: if tick < 60 { first } else { second }, end, ..Vision::default() };
            sample.header.sensed_ns = clock.now();
            samples.lock().unwrap().push_back(sample);
            // An invalid sample is dropped.
            samples.lock().unwrap().push_back(Vision { end: [f32::NAN; 2], ..sample });
        }
        true
    });
    let error = |target: [f32; 2]| (target[0] - end[0]).hypot(target[1] - end[1]);
    // A sample that was sent in tick k is available when tick k + 1 begins. The sample of tick 99 is 145 ms old at tick
    // 102. The next one is available at tick 151.
    let sees = |tick: u64| (1..102).contains(&tick) || tick > 150;
    for (tick, observation) in (0..).zip(&all) {
        let (flags, target) = (observation.header.flags, if tick < 61 { first } else { second });
        // A tick is blind when there was no vision at its beginning or at its end.
        let blind = !sees(tick) || tick > 1 && !sees(tick - 1);
        assert_eq!(flags & flag::BLIND != 0, blind, "tick {tick}: {flags:b}");
        assert_eq!(learned[tick as usize].header.flags & flag::LEARNED != 0, tick > 1 && !blind, "tick {tick}");
        assert_eq!(flags & flag::NEW_TARGET != 0, tick == 1 || tick == 61, "tick {tick}");
        if tick > 0 {
            assert_eq!(observation.inputs[..2], target, "tick {tick}");
        }
        if tick > 1 {
            // The error belongs to the tick before and to that tick's target.
            let before = if tick < 62 { first } else { second };
            assert!((observation.measures[0] - error(before)).abs() < 1e-6, "tick {tick}: {:?}", observation.measures);
            assert_eq!(observation.measures[1..3], end, "tick {tick}");
        }
        if sees(tick) && tick > 1 {
            assert!((0.0..=100.0).contains(&observation.measures[5]), "tick {tick}: {:?}", observation.measures);
        }
    }
    // Torque is turned on with the first command that is based on vision. It stays on when vision is lost; the arm then
    // stands still.
    assert_eq!(torque.iter().position(|on| *on), Some(1));
    assert!(torque[1..].iter().all(|on| *on));
    for observation in &all[103..=151] {
        assert_eq!(observation.applied, [0.0; MAX_OUTPUTS], "tick {}", observation.header.tick);
        assert_eq!(observation.inputs[2..6], all[105].inputs[2..6], "tick {}", observation.header.tick);
        let seen = observation.header.tick > 150;
        assert!(seen || observation.reward == all[102].reward, "tick {}", observation.header.tick);
    }
    assert!(all[90..102].iter().chain(&all[153..]).all(|observation| observation.applied != [0.0; MAX_OUTPUTS]));
    drop(samples);
    assert_eq!(bridge.report.armed, 1);
}

/// For every kind of goal, the servos hold the joints' limits afterwards.
#[test]
fn limits_are_written_into_the_servos() {
    let both = [Protocol::Dynamixel, Protocol::Feetech];
    for (protocol, goal) in both.into_iter().flat_map(|protocol| [(protocol, "speed"), (protocol, "position")]) {
        let plan = plan("", 10, |text| {
            let text = with_protocol(&text, protocol).replace("goal = \"speed\"", &format!("goal = \"{goal}\""));
            let all = text.replace("max_speed = 12.0", "range = [-2.0, 2.0]\nmax_speed = 12.0");
            // The first joint is mounted in the opposite direction, and its zero is off the middle.
            all.replacen("range = [-2.0, 2.0]", "direction = -1\nzero = 1500\nrange = [-1.0, 0.5]\n", 1)
        });
        let mut setup = set_up(&plan);
        setup.bridge.arm().unwrap();
        let mut bus = bus_to(&setup.chain, &setup.clock, &plan);
        let series = bus.series();
        let mut ends = |id| [series.min_position, series.max_position].map(|register| bus.read(id, register).unwrap());
        // 1 rad is 651.9 steps.
        assert_eq!(ends(1), [1500 - 325, 1500 + 651], "{protocol:?}, {goal}");
        assert_eq!(ends(2), [2048 - 1303, 2048 + 1303], "{protocol:?}, {goal}");
        if let Some(limit) = series.velocity_limit {
            let unit = series.speed_unit;
            assert_eq!(bus.read(1, limit).unwrap(), (12.0 / unit).ceil() as i32);
        }
    }
}

/// A reason against torque is reported in one sentence that names the servo or the file, and no servo has torque then.
#[test]
fn a_mismatch_is_refused_and_torque_stays_off() {
    let ids = [1, 2, 3, 4];
    let chain = |ids: &[u8]| EmulatedChain::new(Protocol::Dynamixel, ids, 1_000_000, &EmulatorConfig::default(), 1);
    let four_joints = plan("", 10, |text| text);
    // A model of the same protocol with another control table.
    let small = ServoModel { name: "XL-320", number: 350, protocol: Protocol::Dynamixel };
    let small = EmulatedChain::of(&small, &ids, 1_000_000, &EmulatorConfig::default(), 1);
    for (chain, text) in [
        (small, "servo 1 says that it is model 350 (XL-320: "),
        (chain(&[1, 2, 4]), "(`tectum-bridge scan`)"),
        (chain(&[2, 4]), "servo 1: no answer in time; servo 3: no answer in time; with an answer: servo 2, 4"),
        (chain(&[9]), "no servo of the arm answers"),
        (chain(&[1, 2, 2, 3, 4]), "2"),
    ] {
        let error = set_up_on(&four_joints, chain).err().unwrap().to_string();
        assert!(error.contains(text), "{text}: {error}");
    }

    // The joint stands at 1 rad and its range ends at 0.5 rad.
    let out_of_range =
        plan("", 10, |text| text.replacen("max_speed = 12.0", "zero = 1396\nrange = [-1.0, 0.5]\nmax_speed = 12.0", 1));
    let mut setup = set_up_on(&out_of_range, chain(&ids)).unwrap();
    let error = setup.bridge.arm().unwrap_err().to_string();
    assert!(error.starts_with("servo 1 stands at 1.000 rad and its range is -1 to 0.5 rad"), "{error}");
    let (_, torque, bridge) = run(&out_of_range, setup, |_| true);
    assert!(bridge.state() == SafetyState::ReadOnly && torque.iter().all(|on| !on));

    // Calibrations of other arms: with another protocol, and with another number of joints.
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("arm.toml");
    let by_file = plan("", 10, |text| {
        let (head, tail) = text.split_once("[[plant.servos.joints]]").unwrap();
        let (_, tail) = tail.split_once("[plant.emulator]").unwrap();
        let head = head.replace("armed = true ", &format!("calibration = {file:?}\narmed = true "));
        format!("{head}[plant.emulator]{tail}")
    });
    let joints = |n: usize| (1..=n).map(|id| format!("[[joints]]\nid = {id}\n")).collect::<String>();
    for (protocol, n, text) in
        [("feetech", 4, "another arm's"), ("dynamixel", 3, "3"), ("dynamixel", 0, "joints"), ("dynamixel", 4, "")]
    {
        std::fs::write(&file, format!("protocol = \"{protocol}\"\n{}", joints(n))).unwrap();
        match joints_of(&by_file) {
            Ok(found) => assert!(text.is_empty() && found.len() == 4, "{text}"),
            Err(error) => {
                let error = error.to_string();
                assert!(!text.is_empty() && error.contains("arm.toml") && error.contains(text), "{text}: {error}");
            }
        }
    }
}

/// An answer does not identify its request. An answer that arrives too late must not be taken for that of the next
/// request.
#[test]
fn late_answers_are_not_taken_for_the_next_request() {
    let slow = "faults = [{ kind = \"slow\", servo = 1, delay_ms = 10.0, until_s = 0.01 }]";
    for protocol in [Protocol::Dynamixel, Protocol::Feetech] {
        let plan = plan("", 10, |text| with_protocol(&text, protocol));
        // The next request is sent after every possible delay, so that the second of two late answers arrives during
        // it.
        for wait in (0..12_000_000).step_by(50_000) {
            let chain = EmulatedChain::new(protocol, &[1], 1_000_000, &toml::from_str(slow).unwrap(), 1);
            let (chain, clock) = (Arc::new(Mutex::new(chain)), SteppedClock::default());
            let mut bus = bus_to(&chain, &clock, &plan);
            let (read, _) = bus.sync_read(&[1], bus.series().state);
            assert!(read.is_ok(), "the second attempt receives the answer to the first");
            clock.step_to(clock.now() + wait);
            let (number, known) = bus.model(1).unwrap();
            assert!(known.is_some(), "{protocol:?}, after {wait} ns: {number}");
            assert_eq!(bus.read(1, bus.series().hardware_error).unwrap(), 0);
        }
    }
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

/// An hour with all faults at once. The applied command is always within limits, no tick takes longer than its period,
/// and no servo has torque in a tick whose flags say that torque is off.
#[test]
fn an_hour_of_mixed_faults_stays_within_limits() {
    let mixed: String = ["no-reply", "bad-checksum", "wrong-id", "slow", "cable-out"]
        .map(|kind| format!("[[plant.emulator.faults]]\nkind = \"{kind}\"\nprobability = 0.001\n"))
        .concat();
    let plan = plan(&mixed, 72_000, |text| text.replace("\"learned-reward\"", "\"paper\""));
    let mut setup = set_up(&plan);
    setup.bridge.arm().unwrap();
    let key = setup.bridge.arm_request();
    let (all, torque, bridge) = run(&plan, setup, |tick| {
        // The operator arms the bridge again every ten seconds.
        key.store(tick % 200 == 0, std::sync::atomic::Ordering::Relaxed);
        tick % 1009 > 8
    });
    let most = 0.01 * 1.0001;
    for (observation, on) in all[1..].iter().zip(&torque) {
        let off = observation.header.flags & (flag::UNARMED | flag::TRIPPED) != 0;
        assert!(observation.applied.iter().all(|u| u.abs() <= most), "{:?}", observation.applied);
        assert!(!off || observation.applied == [0.0; MAX_OUTPUTS], "tick {}", observation.header.tick);
        assert!(!(off && *on) || observation.header.flags & flag::BLIND != 0, "tick {}", observation.header.tick);
    }
    let with_torque = torque.iter().filter(|on| **on).count();
    assert!(
        bridge.report.blind > 10 && with_torque > 36_000,
        "{} blind, {with_torque} with torque, {:?}",
        bridge.report.blind,
        bridge.report.events
    );
}

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
    let off = (100..400).find(|&tick| !torque[tick]);
    let back = off.and_then(|off| (off..400).find(|&tick| torque[tick]));
    let mut causes: Vec<String> = bridge.report.events.iter().map(|event| event.cause.to_string()).collect();
    causes.dedup();
    let at = |tick: Option<usize>| tick.map_or("-".to_owned(), |tick| format!("{} ms", (tick as i64 - 99) * 50));
    format!(
        "{protocol:<10} {name:<14} {:>6} blind  torque off after {:>8}, on again after {:>8}  {}",
        bridge.report.blind,
        at(off),
        at(back),
        causes.join(", ")
    )
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
    assert_snapshot("tests/snapshots/servo_faults.txt", &table);
}

/// A joint stands at the end of its range next to the encoder's 0, where a reading may come from the other end of the
/// turn. No goal leads the long way round.
#[test]
fn no_goal_leads_across_the_encoders_zero() {
    for protocol in [Protocol::Dynamixel, Protocol::Feetech] {
        let plan = plan("noise = 1.0", 400, |text| {
            let text = with_protocol(&text, protocol).replace("goal = \"speed\"", "goal = \"position\"");
            let text = text.replace("max_speed = 12.0", "zero = 698\nrange = [-1.07, 1.07]\nmax_speed = 12.0");
            text.replace("\"learned-reward\"", "\"paper\"").replace("sigma = 0.001", "sigma = 0.01")
        });
        let mut setup = set_up(&plan);
        for id in 1..=4 {
            // The lower end is at 1 step.
            setup.chain.lock().unwrap().move_by_hand(0, id, 3.0);
        }
        setup.bridge.arm().unwrap();
        let (chain, clock) = (Arc::clone(&setup.chain), setup.clock.clone());
        let mut farthest: f64 = 0.0;
        let (_, torque, _) = run(&plan, setup, |_| {
            let state = chain.lock().unwrap().state(clock.now());
            let beyond = |at: f64| (at + 100.0).rem_euclid(4096.0) - 100.0;
            farthest = state.iter().map(|servo| beyond(servo.position)).fold(farthest, f64::max);
            true
        });
        assert!(torque.iter().filter(|on| **on).count() > 300, "{protocol:?}");
        assert!((10.0..=1399.0).contains(&farthest), "{protocol:?}: {farthest}");
    }
}

/// The last check, where the packet is made: a goal outside the written limits is not sent, whoever asks for it.
#[test]
fn a_goal_outside_the_limits_is_not_sent() {
    for protocol in [Protocol::Dynamixel, Protocol::Feetech] {
        let plan = plan("", 10, |text| with_protocol(&text, protocol));
        let chain = EmulatedChain::new(protocol, &[1, 2], 1_000_000, &EmulatorConfig::default(), 1);
        let (chain, clock) = (Arc::new(Mutex::new(chain)), SteppedClock::default());
        let mut bus = bus_to(&chain, &clock, &plan);
        let series = bus.series();
        bus.limit_goals(vec![(2, [1000, 3000])]);
        for (goal, fits) in [(1000, true), (999, false), (3000, true), (3001, false)] {
            assert_eq!(bus.sync_set(&[1, 2], series.goal_position, |_| goal).is_ok(), fits, "{goal}");
            assert_eq!(bus.write(2, series.goal_position, goal).is_ok(), fits, "{goal}");
            assert!(bus.write(1, series.goal_position, goal).is_ok());
        }
        assert_eq!(bus.read(2, series.goal_position).unwrap(), 3000);
    }
}

/// Registers that other programs left behind are named before torque comes on.
#[test]
fn registers_that_others_left_are_refused() {
    for (protocol, address, bytes, name) in [
        (Protocol::Feetech, 31, &[44_u8, 9][..], "homing_offset (address 31) is -300 and should be 0"),
        (Protocol::Feetech, 30, &[2][..], "angular_resolution (address 30) is 0x2"),
        (Protocol::Feetech, 21, &[3][..], "p_coefficient (address 21) is 3 and should be 32, as when"),
        (Protocol::Dynamixel, 20, &[44, 1, 0, 0][..], "homing_offset (address 20) is 300 and should be 0"),
        (Protocol::Dynamixel, 10, &[1][..], "drive_mode (address 10) is 1"),
        (Protocol::Dynamixel, 60, &[1][..], "startup_configuration (address 60) is 1"),
    ] {
        let plan = plan("", 10, |text| {
            let text = with_protocol(&text, protocol);
            let gain = if protocol == Protocol::Feetech { "p_coefficient = 32" } else { "pwm_limit = 885" };
            text.replace("max_speed = 12.0", &format!("max_speed = 12.0\nregisters = {{ {gain} }}"))
        });
        let mut setup = set_up(&plan);
        setup.chain.lock().unwrap().overwrite(2, address, bytes);
        let error = setup.bridge.arm().unwrap_err();
        assert!(error.is_configuration() && error.to_string().contains(name), "{name}: {error}");
        assert!(error.to_string().starts_with("servo 2"), "{error}");
    }
    // A Dynamixel whose range begins below its offset stands on the other side of its encoder's 0 after a restart.
    let below = plan("", 10, |text| {
        text.replace("max_speed = 12.0", "range = [-2.9, 2.9]\nregisters = { homing_offset = 300 }\nmax_speed = 12.0")
    });
    let mut setup = set_up(&below);
    (1..=4).for_each(|id| setup.chain.lock().unwrap().overwrite(id, 20, &[44, 1, 0, 0]));
    let error = setup.bridge.arm().unwrap_err();
    assert!(error.is_configuration() && error.to_string().contains("lies across the 0 of its encoder"), "{error}");
    // A register that the calibration states is as it should be; a mode that makes times of speeds never is.
    let recorded = |register: &str| {
        plan("", 10, |text| {
            text.replace("max_speed = 12.0", &format!("max_speed = 12.0\nregisters = {{ {register} }}"))
        })
    };
    for (register, address, bytes, fits) in
        [("homing_offset = 300", 20, &[44_u8, 1, 0, 0][..], true), ("drive_mode = 4", 10, &[4][..], false)]
    {
        let mut setup = set_up(&recorded(register));
        (1..=4).for_each(|id| setup.chain.lock().unwrap().overwrite(id, address, bytes));
        assert_eq!(setup.bridge.arm().is_ok(), fits, "{register}");
    }
}

/// Answers of a user who calibrates servo 1: before each Enter, something happens to the arm.
struct Hand {
    chain: Arc<Mutex<EmulatedChain>>,
    clock: SteppedClock,
    steps: std::vec::IntoIter<Step>,
    line: &'static [u8],
}

/// What happens before an Enter.
enum Step {
    /// The shaft is turned to this position.
    At(f64),
    /// The servo is no longer there, and comes back.
    Gone,
    Back,
}

impl std::io::Read for Hand {
    fn read(&mut self, _: &mut [u8]) -> std::io::Result<usize> {
        unreachable!("it is read by lines")
    }
}

impl std::io::BufRead for Hand {
    fn fill_buf(&mut self) -> std::io::Result<&[u8]> {
        if self.line.is_empty()
            && let Some(step) = self.steps.next()
        {
            let mut chain = self.chain.lock().unwrap();
            match step {
                Step::At(steps) => assert!(chain.move_by_hand(self.clock.now(), 1, steps)),
                Step::Gone => chain.overwrite(1, Protocol::Feetech.series().id.address, &[9]),
                Step::Back => chain.overwrite(9, Protocol::Feetech.series().id.address, &[1]),
            }
            self.line = b"\n";
        }
        Ok(self.line)
    }

    fn consume(&mut self, n: usize) {
        self.line = &self.line[n..];
    }
}

/// A silence and a wrong step cost one question more, not the calibration.
#[test]
fn calibrate_asks_again_what_failed() {
    let plan = plan("", 10, |text| with_protocol(&text, Protocol::Feetech));
    let chain = EmulatedChain::new(Protocol::Feetech, &[1], 1_000_000, &EmulatorConfig::default(), 1);
    let (chain, clock) = (Arc::new(Mutex::new(chain)), SteppedClock::default());
    let mut bus = bus_to(&chain, &clock, &plan);
    let steps = vec![
        Step::At(2000.0),
        // Too little to tell a direction: the joint begins again.
        Step::At(2010.0),
        Step::At(2010.0),
        Step::At(2000.0),
        Step::At(2200.0),
        Step::Gone,
        Step::Back,
        Step::At(3000.0),
    ];
    let mut hand = Hand { chain: Arc::clone(&chain), clock, steps: steps.into_iter(), line: b"" };
    let mut said = Vec::new();
    // The least angle is 200 steps above the zero, which is no range with 0 in it; so the joint begins once more.
    let ended = calibrate(&mut bus, &[1], 6.0, &mut hand, &mut said).unwrap_err().to_string();
    let said = String::from_utf8(said).unwrap();
    assert!(ended.contains("the answers end"), "{ended}");
    assert!(said.contains("too little to tell a direction. This joint again"), "{said}");
    assert!(said.contains("servo 1: no answer in time; look at its cable; Enter asks it again"), "{said}");
    assert!(said.contains("no range with the angle 0 in it"), "{said}");
    let steps = [2000.0, 2200.0, 1000.0, 3000.0].map(Step::At);
    hand.steps = Vec::from(steps).into_iter();
    let joint = calibrate(&mut bus, &[1], 6.0, &mut hand, &mut Vec::new()).unwrap().joints.remove(0);
    assert_eq!((joint.zero, joint.direction, joint.raw_ends()), (2000, 1, Some([1000, 3000])));
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
    let mut bus = bus_to(&chain, &clock, &plan);
    let (line, now) = (Arc::clone(&chain), clock.clone());
    bus.set_opener(Box::new(move || {
        let out = line.lock().unwrap().is_cable_out();
        if out {
            return Err(BusError::NoPort("arm".to_owned()));
        }
        Ok(Box::new(EmulatedPort::new(Arc::clone(&line), now.clone(), servos.baud)))
    }));
    let mut bridge = Bridge::new(&plan, bus, joints_of(&plan).unwrap(), Box::new(|_| {})).unwrap();
    let tick_now = Arc::new(std::sync::atomic::AtomicU64::new(0));
    let at = |tick: &Arc<std::sync::atomic::AtomicU64>| tick.load(std::sync::atomic::Ordering::Relaxed);
    let (of_guard, of_clock) = (Arc::clone(&tick_now), Arc::clone(&tick_now));
    bridge.set_guard(Box::new(move |_| loss != Loss::GuardDead || at(&of_guard) < 100));
    bridge.set_sleep_clock(Box::new(
        move || if loss == Loss::Asleep && at(&of_clock) >= 100 { 3_600_000_000_000 } else { 0 },
    ));
    bridge.arm().unwrap();
    let (line, time) = (Arc::clone(&chain), clock.clone());
    let setup = Setup { chain, clock, bridge };
    let (_, torque, bridge) = run(&plan, setup, |tick| {
        tick_now.store(tick, std::sync::atomic::Ordering::Relaxed);
        match (loss, tick) {
            (Loss::CableOut, 100) => line.lock().unwrap().pull_cable(),
            (Loss::CableOut, 120) => line.lock().unwrap().put_cable_back(),
            (Loss::Frozen, 100) => time.step_to(time.now() + 500_000_000),
            _ => {}
        }
        true
    });
    let off = (100..400).find(|&tick| !torque[tick]);
    let back = off.and_then(|off| (off..400).find(|&tick| torque[tick]));
    let mut causes: Vec<String> = bridge.report.events.iter().map(|event| event.cause.to_string()).collect();
    causes.dedup();
    let at = |tick: Option<usize>| tick.map_or("-".to_owned(), |tick| format!("{} ms", (tick as i64 - 99) * 50));
    format!(
        "{:<10} {name:<14} {rearm:<9}  torque off after {:>8}, on again after {:>8}  {}",
        protocol.name(),
        at(off),
        at(back),
        causes.join(", ")
    )
}
