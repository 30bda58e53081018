//! The bridge on the emulated chain, in virtual time: the swap, the numbers, and what each fault does.
//!
//! The table in `tests/snapshots/servo_faults.txt` is what came out, exactly; `TECTUM_BLESS=1 cargo test --test bridge` writes
//! it anew. A change of it is a change of what the bridge does about faults, and is reviewed there.

use std::fmt::Write as _;
use std::sync::{Arc, Mutex};

use tectum::runtime::{Controller, PlantSide};
use tectum::scenario::{EmulatorConfig, Plan, Scenario};
use tectum::servo::bridge::{Bridge, BridgeError, SafetyState, joints_of};
use tectum::servo::bus::Bus;
use tectum::servo::emulator::{EmulatedChain, EmulatedPort, SteppedClock};
use tectum::servo::model::{Protocol, ServoModel};
use tectum::wire::{Command, Learning, Observation, Vision, flag};

/// The emulated twin with this emulator, so many ticks, and with `change` made to its text.
fn plan(emulator: &str, ticks: u64, change: impl FnOnce(String) -> String) -> Plan {
    let text = std::fs::read_to_string("scenarios/servo-emulated.toml").unwrap();
    let (head, tail) = text.split_once("\n[plant.emulator]\n").unwrap();
    let (_, tail) = tail.split_once("[encoder]").unwrap();
    let text = change(format!("{head}\n[plant.emulator]\n{emulator}\n[encoder]{tail}"));
    let mut scenario = Scenario::parse(&text, "bridge").unwrap();
    scenario.ticks = ticks;
    scenario.plan().unwrap()
}

/// A bridge at the host's end of an emulated chain.
struct Setup {
    chain: Arc<Mutex<EmulatedChain>>,
    clock: SteppedClock,
    bridge: Bridge,
}

fn set_up(plan: &Plan) -> Setup {
    let servos = plan.scenario.plant.servos.as_ref().unwrap();
    let ids: Vec<u8> = joints_of(plan).unwrap().iter().map(|joint| joint.id).collect();
    let ideal = EmulatorConfig::default();
    let settings = plan.scenario.plant.emulator.as_ref().unwrap_or(&ideal);
    let chain = EmulatedChain::new(servos.protocol, &ids, servos.baud, settings, plan.scenario.seed);
    set_up_on(plan, chain).unwrap()
}

/// The same on a chain that may not be the plan's.
fn set_up_on(plan: &Plan, chain: EmulatedChain) -> Result<Setup, BridgeError> {
    let (chain, clock) = (Arc::new(Mutex::new(chain)), SteppedClock::default());
    let bridge = Bridge::new(plan, bus_to(&chain, &clock, plan), joints_of(plan)?, Box::new(|_| {}))?;
    Ok(Setup { chain, clock, bridge })
}

/// The plan's host at the other end of the wire.
fn bus_to(chain: &Arc<Mutex<EmulatedChain>>, clock: &SteppedClock, plan: &Plan) -> Bus {
    let servos = plan.scenario.plant.servos.as_ref().unwrap();
    let (port, now) = (EmulatedPort::new(Arc::clone(chain), clock.clone(), servos.baud), clock.clone());
    Bus::over(Box::new(port), servos.protocol, Bridge::budget(plan), Box::new(move || now.now()))
}

/// The text of a plan with another protocol.
fn speaking(text: &str, protocol: Protocol) -> String {
    text.replace("\"dynamixel\" ", &format!("\"{}\" ", protocol.name()))
}

/// Errors at the ends of targets, averaged over the last quarter of the run.
fn end_error(observations: &[Observation]) -> f64 {
    let late = &observations[observations.len() * 3 / 4..];
    let ends: Vec<f64> =
        late.iter().filter(|o| o.header.flags & flag::NEW_TARGET != 0).map(|o| f64::from(o.measures[0])).collect();
    ends.iter().sum::<f64>() / ends.len() as f64
}

/// One run in virtual time; `see` is asked in every tick for what happens to the command.
fn run(plan: &Plan, setup: Setup, heard: impl FnMut(u64) -> bool) -> (Vec<Observation>, Vec<bool>, Bridge) {
    let (all, torque, bridge, _) = run_learning(plan, setup, heard);
    (all, torque, bridge)
}

/// The same, with what was learned at each tick.
fn run_learning(
    plan: &Plan,
    setup: Setup,
    mut heard: impl FnMut(u64) -> bool,
) -> (Vec<Observation>, Vec<bool>, Bridge, Vec<Learning>) {
    let Setup { chain, clock, bridge } = setup;
    let t0 = clock.now();
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
        side.apply(tick, heard(tick).then_some(&command), true);
        let end = t0 + (tick + 1) * plan.period_ns;
        assert!(clock.now() <= end, "tick {tick}: the bus took more than the tick has");
        clock.step_to(end);
        torque.push(chain.lock().unwrap().state(end).iter().any(|servo| servo.torque));
        side.finish_step(tick);
    }
    (all, torque, side.into_body(), learned)
}

#[test]
fn the_swap_is_the_plant_alone() {
    let load = |name: &str| Scenario::load(format!("scenarios/{name}.toml").as_ref()).unwrap();
    let (mut emulated, simulated) = (load("servo-emulated"), load("servo-simulated"));
    assert_ne!(emulated, simulated);
    (emulated.name, emulated.plant) = (simulated.name.clone(), simulated.plant.clone());
    emulated.source = simulated.source.clone();
    assert_eq!(emulated, simulated);
}

/// Both have the same targets with the same seed, so that the seeds are those of one run each.
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
    // The simulator's spread over seeds, and where the bridge is on the average of some.
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
    assert!((low..=high).contains(&mean), "{mean} m of {emulated:?}, and the simulator has {simulated:?} m");
}

#[test]
fn unarmed_it_reads_and_torque_stays_off() {
    let plan = plan("", 100, |text| text);
    let (all, torque, bridge) = run(&plan, set_up(&plan), |_| true);
    assert_eq!(bridge.state(), SafetyState::ReadOnly);
    assert!(torque.iter().all(|on| !on));
    for observation in &all[1..] {
        assert_eq!(observation.applied, [0.0; 8]);
        assert_ne!(observation.header.flags & flag::UNARMED, 0);
    }
}

#[test]
fn whoever_arms_late_begins_gently() {
    let plan =
        plan("", 140, |text| text.replace("\"learned-reward\"", "\"paper\"").replace("sigma = 0.001", "sigma = 0.01"));
    let setup = set_up(&plan);
    let key = setup.bridge.arm_request();
    // The gate's ramp is long over when torque comes on.
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

/// A tracker that is there from tick 0, says nothing from tick 100 to 149, and whose target jumps at tick 60.
#[test]
fn what_is_seen_counts_and_who_does_not_see_stands_still() {
    let plan = plan("", 200, |text| {
        let text = text.replace("\"learned-reward\"", "\"paper\"");
        text.replace("armed = true ", "sight = \"vision\"\narmed = true ")
    });
    assert_eq!(plan.measures[3..], ["bus_read_us", "bus_write_us", "vision_age_ms"]);
    let mut setup = set_up(&plan);
    let samples = Arc::new(Mutex::new(std::collections::VecDeque::new()));
    let theirs = Arc::clone(&samples);
    setup.bridge.set_vision_source(Box::new(move || theirs.lock().unwrap().pop_front()));
    setup.bridge.arm().unwrap();
    let clock = setup.clock.clone();
    let (first, second, end) = ([0.3, 0.2], [-0.4, 0.1], [0.1_f32, 0.25]);
    let (all, torque, bridge, learned) = run_learning(&plan, setup, |tick| {
        if !(100..150).contains(&tick) {
            let mut sample = Vision { target: if tick < 60 { first } else { second }, end, ..Vision::default() };
            sample.header.sensed_ns = clock.now();
            samples.lock().unwrap().push_back(sample);
            // What cannot be is dropped.
            samples.lock().unwrap().push_back(Vision { end: [f32::NAN; 2], ..sample });
        }
        true
    });
    let error = |target: [f32; 2]| (target[0] - end[0]).hypot(target[1] - end[1]);
    // What was sent in tick k is there when tick k + 1 begins; that of tick 99 is 145 ms old at tick 102, and another is there at tick 151.
    let sees = |tick: u64| (1..102).contains(&tick) || tick > 150;
    for (tick, observation) in (0..).zip(&all) {
        let (flags, target) = (observation.header.flags, if tick < 61 { first } else { second });
        // A tick in which it did not see at the beginning or at the end.
        let blind = !sees(tick) || tick > 1 && !sees(tick - 1);
        assert_eq!(flags & flag::BLIND != 0, blind, "tick {tick}: {flags:b}");
        assert_eq!(learned[tick as usize].header.flags & flag::LEARNED != 0, tick > 1 && !blind, "tick {tick}");
        assert_eq!(flags & flag::NEW_TARGET != 0, tick == 1 || tick == 61, "tick {tick}");
        if tick > 0 {
            assert_eq!(observation.inputs[..2], target, "tick {tick}");
        }
        if tick > 1 {
            // The reward of the tick before is that of its own target.
            let before = if tick < 62 { first } else { second };
            assert!((observation.measures[0] - error(before)).abs() < 1e-6, "tick {tick}: {:?}", observation.measures);
            assert_eq!(observation.measures[1..3], end, "tick {tick}");
        }
        if sees(tick) && tick > 1 {
            assert!((0.0..=100.0).contains(&observation.measures[5]), "tick {tick}: {:?}", observation.measures);
        }
    }
    // Torque comes on with the first command that is given with open eyes, and stays on when they close; the arm then stands.
    assert_eq!(torque.iter().position(|on| *on), Some(1));
    assert!(torque[1..].iter().all(|on| *on));
    for observation in &all[103..=151] {
        assert_eq!(observation.applied, [0.0; 8], "tick {}", observation.header.tick);
        assert_eq!(observation.inputs[2..6], all[105].inputs[2..6], "tick {}", observation.header.tick);
        let seen = observation.header.tick > 150;
        assert!(seen || observation.reward == all[102].reward, "tick {}", observation.header.tick);
    }
    assert!(all[90..102].iter().chain(&all[153..]).all(|observation| observation.applied != [0.0; 8]));
    drop(samples);
    assert_eq!(bridge.report.armed, 1);
}

/// Whatever the goals are, the servos hold the joints' limits afterwards; a joint that turns freely has none.
#[test]
fn limits_are_written_into_the_servos() {
    let both = [Protocol::Dynamixel, Protocol::Feetech];
    for (protocol, goal) in both.into_iter().flat_map(|protocol| [(protocol, "speed"), (protocol, "position")]) {
        let plan = plan("", 10, |text| {
            let text = speaking(&text, protocol).replace("goal = \"speed\"", &format!("goal = \"{goal}\""));
            let all = text.replace("max_speed = 12.0", "range = [-2.0, 2.0]\nmax_speed = 12.0");
            // The first one is mounted the other way round, with its zero off the middle.
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

/// What speaks against torque is said in a sentence that names the servo or the file, and nothing has torque then.
#[test]
fn what_does_not_fit_is_refused_without_torque() {
    let ids = [1, 2, 3, 4];
    let chain = |ids: &[u8]| EmulatedChain::new(Protocol::Dynamixel, ids, 1_000_000, &EmulatorConfig::default(), 1);
    let whole = plan("", 10, |text| text);
    // Of the same protocol, with another control table.
    let small = ServoModel { name: "XL-320", number: 350, protocol: Protocol::Dynamixel };
    let small = EmulatedChain::of(&small, &ids, 1_000_000, &EmulatorConfig::default(), 1);
    for (chain, text) in [
        (small, "servo 1 says that it is model 350, which is none of the Dynamixel X"),
        (chain(&[1, 2, 4]), "(`tectum-bridge scan`)"),
        (chain(&[1, 2, 2, 3, 4]), "2"),
    ] {
        let error = set_up_on(&whole, chain).err().unwrap().to_string();
        assert!(error.contains(text), "{text}: {error}");
    }

    // It stands at 1 rad of a range that ends at 0.5.
    let bent =
        plan("", 10, |text| text.replacen("max_speed = 12.0", "zero = 1396\nrange = [-1.0, 0.5]\nmax_speed = 12.0", 1));
    let mut setup = set_up_on(&bent, chain(&ids)).unwrap();
    let error = setup.bridge.arm().unwrap_err().to_string();
    assert!(error.starts_with("servo 1 stands at 1.000 rad and its range is -1 to 0.5 rad"), "{error}");
    let (_, torque, bridge) = run(&bent, setup, |_| true);
    assert!(bridge.state() == SafetyState::ReadOnly && torque.iter().all(|on| !on));

    // Calibrations: another arm's in what it speaks, and in its number of joints.
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

/// An answer does not say to what it is one: those that come too late are not taken for that of the next question.
#[test]
fn late_answers_are_nobodys() {
    let slow = "faults = [{ kind = \"slow\", servo = 1, delay_ms = 10.0, until_s = 0.01 }]";
    for protocol in [Protocol::Dynamixel, Protocol::Feetech] {
        let plan = plan("", 10, |text| speaking(&text, protocol));
        // Whenever the next question is asked, the second of two late answers comes then.
        for wait in (0..12_000_000).step_by(50_000) {
            let chain = EmulatedChain::new(protocol, &[1], 1_000_000, &toml::from_str(slow).unwrap(), 1);
            let (chain, clock) = (Arc::new(Mutex::new(chain)), SteppedClock::default());
            let mut bus = bus_to(&chain, &clock, &plan);
            let (read, _) = bus.sync_read(&[1], bus.series().state);
            assert!(read.is_ok(), "the second time it is in time for the first");
            clock.step_to(clock.now() + wait);
            let (number, known) = bus.model(1).unwrap();
            assert!(known.is_some(), "{protocol:?}, after {wait} ns: {number}");
            assert_eq!(bus.read(1, bus.series().hardware_error).unwrap(), 0);
        }
    }
}

/// A panic with torque on, here in what the bridge says: torque is off before the process is gone.
#[test]
fn a_panic_turns_torque_off() {
    let plan = plan("", 100, |text| text);
    let servos = plan.scenario.plant.servos.as_ref().unwrap();
    let chain = EmulatedChain::new(servos.protocol, &[1, 2, 3, 4], servos.baud, &EmulatorConfig::default(), 1);
    let (chain, clock) = (Arc::new(Mutex::new(chain)), SteppedClock::default());
    let bus = bus_to(&chain, &clock, &plan);
    let seen = Arc::new(Mutex::new(false));
    let (look, at, note) = (Arc::clone(&chain), clock.clone(), Arc::clone(&seen));
    let say = move |text: &str| {
        if text.contains("torque is on") {
            *note.lock().unwrap() = look.lock().unwrap().state(at.now()).iter().all(|servo| servo.torque);
            panic!("as any other");
        }
    };
    let mut bridge = Bridge::new(&plan, bus, joints_of(&plan).unwrap(), Box::new(say)).unwrap();
    bridge.arm().unwrap();
    let setup = Setup { chain: Arc::clone(&chain), clock: clock.clone(), bridge };
    let ended = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| run(&plan, setup, |_| true)));
    assert!(ended.is_err() && *seen.lock().unwrap(), "it did not panic with torque on");
    assert!(chain.lock().unwrap().state(clock.now()).iter().all(|servo| !servo.torque));
}

/// An hour of everything at once: whatever happens, what is applied is within limits, no tick is longer than a tick, and torque is on
/// in no tick that says it is off.
#[test]
fn an_hour_of_mixed_faults() {
    let mixed: String = ["no-reply", "bad-checksum", "wrong-id", "slow", "cable-out"]
        .map(|kind| format!("[[plant.emulator.faults]]\nkind = \"{kind}\"\nprobability = 0.001\n"))
        .concat();
    let plan = plan(&mixed, 72_000, |text| text.replace("\"learned-reward\"", "\"paper\""));
    let mut setup = set_up(&plan);
    setup.bridge.arm().unwrap();
    let key = setup.bridge.arm_request();
    let (all, torque, bridge) = run(&plan, setup, |tick| {
        // Somebody looks at it every ten seconds.
        key.store(tick % 200 == 0, std::sync::atomic::Ordering::Relaxed);
        tick % 1009 > 8
    });
    let most = 0.01 * 1.0001;
    for (observation, on) in all[1..].iter().zip(&torque) {
        let off = observation.header.flags & (flag::UNARMED | flag::TRIPPED) != 0;
        assert!(observation.applied.iter().all(|u| u.abs() <= most), "{:?}", observation.applied);
        assert!(!off || observation.applied == [0.0; 8], "tick {}", observation.header.tick);
        assert!(!(off && *on) || observation.header.flags & flag::BLIND != 0, "tick {}", observation.header.tick);
    }
    let driven = torque.iter().filter(|on| **on).count();
    assert!(
        bridge.report.blind > 10 && driven > 36_000,
        "{} blind, {driven} driven, {:?}",
        bridge.report.blind,
        bridge.report.events
    );
}

/// A fault for the table: the emulator's table, or commands that stay away, from tick 100 to tick 200.
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

fn row(name: &str, emulator: &str, protocol: &str, away: bool) -> String {
    let plan = plan(emulator, 400, |text| text.replace("\"dynamixel\" ", &format!("\"{protocol}\" ")));
    let mut setup = set_up(&plan);
    setup.bridge.arm().unwrap();
    let (all, torque, bridge) = run(&plan, setup, |tick| !away || !(100..200).contains(&tick));
    for observation in &all {
        assert!(observation.applied.iter().all(|u| u.abs() <= 0.0101), "{name}: {:?}", observation.applied);
    }
    let off = (100..400).find(|&tick| !torque[tick]);
    let back = off.and_then(|off| (off..400).find(|&tick| torque[tick]));
    let causes: Vec<String> = bridge.report.events.iter().map(|event| event.cause.to_string()).collect();
    let mut causes = causes;
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
fn what_each_fault_does() {
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
    let path = "tests/snapshots/servo_faults.txt";
    if std::env::var_os("TECTUM_BLESS").is_some() {
        std::fs::write(path, &table).unwrap();
    }
    let kept = std::fs::read_to_string(path).unwrap_or_default();
    assert_eq!(kept, table, "TECTUM_BLESS=1 writes it anew");
}
