//! The bridge on the emulated chain, in virtual time: replacing the simulator, learning, limits, and the checks before
//! torque. `tests/bridge_faults.rs` has the effects of faults.

#[path = "support/virtual_bridge.rs"]
mod virtual_bridge;

use std::sync::{Arc, Mutex};

use tectum::scenario::{EmulatorConfig, Scenario};
use tectum::servo::bridge::{SafetyState, joints_of};
use tectum::servo::emulator::{EmulatedChain, SteppedClock};
use tectum::servo::model::{Protocol, ServoModel};
use tectum::servo::tools::calibrate;
use tectum::wire::{MAX_OUTPUTS, Observation, Vision, flag};
use virtual_bridge::{bus_to, plan, run, run_learning, set_up, set_up_on, with_protocol};

/// The error at the end of a target, averaged over the targets of the last quarter of the run.
fn end_error(observations: &[Observation]) -> f64 {
    let late = &observations[observations.len() * 3 / 4..];
    let ends: Vec<f64> =
        late.iter().filter(|o| o.header.flags & flag::NEW_TARGET != 0).map(|o| f64::from(o.measures[0])).collect();
    ends.iter().sum::<f64>() / ends.len() as f64
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
