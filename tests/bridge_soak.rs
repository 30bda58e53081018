//! A soak of the bridge: bridges, guards, controllers, launchers and `jog` are killed, stopped and hung up, their
//! terminals are closed, and cables are pulled out and put back, at random instants, on emulated chains of both
//! protocols.
//!
//! After each fault it requires that torque goes off where that is promised, that no shaft turned further than
//! `max_speed` times five periods without an instruction, that every process ends or goes on, and at the end that
//! nothing is left in shared memory. It takes minutes, so it runs only when it is asked for:
//!
//! ```text
//! TECTUM_SOAK_FAULTS=100 TECTUM_SOAK_SEED=1 cargo test --test bridge_soak -- --ignored --nocapture
//! ```
//!
//! The faults and their instants follow from the seed, and so does their order.

#[path = "support/emulator.rs"]
mod emulator;
mod support;

use std::collections::BTreeMap;
use std::io::BufRead as _;
use std::process::{Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use emulator::Emulator;
use rand::RngExt as _;
use serde_json::Value;
use support::terminal::TestTerminal;
use support::{Process, TECTUM, TestFolder, WATCHDOG, children, domain, has_ended, shared_memory, signal_process};
use tectum::seed::{Rng, stream};
use tectum::servo::model::STEP;

const BRIDGE: &str = env!("CARGO_BIN_EXE_tectum-bridge");
/// The period of the scenario, s, and the highest speed of its joints, rad/s.
const PERIOD: f64 = 0.2;
const MAX_SPEED: f64 = 1.0;
/// Ticks of a run; a session ends long before.
const TICKS: &str = "100000";

/// Faults after which the run goes on.
const PASSING: [&str; 8] = [
    "bridge KILL",
    "bridge STOP",
    "bridge TSTP",
    "cable",
    "answers lost",
    "controller KILL",
    "controller STOP",
    "launcher STOP",
];
/// Faults that end the run.
const FINAL: [&str; 11] = [
    "bridge HUP",
    "bridge INT",
    "bridge QUIT",
    "bridge TERM",
    "guard KILL",
    "launcher INT",
    "launcher TERM",
    "launcher HUP",
    "launcher KILL",
    TERMINAL,
    "cable, then launcher INT",
];
/// Faults of `jog`.
const JOG: [&str; 7] = ["KILL", "STOP", "HUP", "TERM", "QUIT", "cable", TERMINAL];
/// The terminal in which the program runs is closed.
const TERMINAL: &str = "terminal closed";

/// An emulated chain of four servos, and what it has said of itself.
struct Arm {
    emulator: Emulator,
    reports: Receiver<Value>,
    servos: [Value; 4],
}

impl Arm {
    fn start(test_folder: &TestFolder, protocol: &str) -> Self {
        let arguments = ["--protocol", protocol, "--ids", "1,2,3,4", "--link", "arm", "--trace"];
        let mut emulator = Emulator::start(test_folder, &arguments);
        assert!(emulator.next_report()["port"].is_string());
        let (sender, reports) = channel();
        let null = Command::new("true").stdout(Stdio::piped()).spawn().unwrap().stdout.unwrap();
        let output = std::mem::replace(&mut emulator.output, std::io::BufReader::new(null));
        std::thread::spawn(move || {
            for line in output.lines().map_while(Result::ok) {
                let _ = sender.send(serde_json::from_str(&line).unwrap());
            }
        });
        let mut arm = Self { emulator, reports, servos: Default::default() };
        arm.wait_for_torque(false, "at the start");
        arm
    }

    fn take(&mut self, what: &str) {
        let report = self.reports.recv_timeout(WATCHDOG).unwrap_or_else(|_| panic!("{what}: {:?}", self.servos));
        for servo in report["servos"].as_array().unwrap() {
            self.servos[servo["id"].as_u64().unwrap() as usize - 1] = servo.clone();
        }
    }

    /// Waits until the servos that are named in `ids` have torque, or none of them has.
    fn wait(&mut self, ids: &[usize], on: bool, what: &str) {
        while ids.iter().any(|&id| self.servos[id - 1]["torque"] != on) {
            self.take(&format!("{what}: waiting for torque {on}"));
        }
    }

    fn wait_for_torque(&mut self, on: bool, what: &str) {
        self.wait(&[1, 2, 3, 4], on, what);
    }

    /// Asks for the state, and returns the longest turn of a shaft without an instruction so far, rad.
    fn unattended(&mut self) -> f64 {
        self.emulator.send_command("state");
        let full = |report: &Value| report["servos"].as_array().is_some_and(|servos| servos.len() == 4);
        loop {
            let report = self.reports.recv_timeout(WATCHDOG).expect("the state");
            for servo in report["servos"].as_array().unwrap() {
                self.servos[servo["id"].as_u64().unwrap() as usize - 1] = servo.clone();
            }
            if full(&report) {
                break;
            }
        }
        self.servos.iter().map(|servo| servo["unattended"].as_f64().unwrap() * STEP).fold(0.0, f64::max)
    }
}

/// One soak.
struct Soak {
    protocol: &'static str,
    scenario: String,
    rng: Rng,
    faults: BTreeMap<String, u64>,
    sessions: u64,
    /// The longest time from a fault to torque off, by fault, s.
    slowest: BTreeMap<String, f64>,
    /// Prefixes of what the runs had in shared memory.
    domains: Vec<String>,
    // Dropped in this order: the emulator before its folder.
    arm: Arm,
    folder: TestFolder,
}

impl Soak {
    /// A chain, and a scenario in which its servos turn at their highest speed.
    fn new(protocol: &'static str, goal: &str, seed: u64) -> Self {
        let folder = TestFolder::new();
        let text = std::fs::read_to_string("scenarios/servo-emulated.toml").unwrap();
        let (head, tail) = text.split_once("\n[plant.emulator]\n").unwrap();
        let (_, tail) = tail.split_once("[encoder]").unwrap();
        let head = head.replace("\"emulator\" ", "\"arm\" ").replace("\"dynamixel\" ", &format!("\"{protocol}\" "));
        let head = head.replace("period_ms = 50", "period_ms = 200");
        let head = head.replace("goal = \"speed\"", &format!("goal = \"{goal}\""));
        // Position goals need ends. With speed goals a joint may coast past an end while its cable is out, and is then
        // refused until somebody moves it by hand.
        let range = if goal == "position" { "range = [-2.0, 2.0]\n" } else { "" };
        let head = head.replace("max_speed = 12.0", &format!("{range}max_speed = 1.0"));
        let tail = tail.replace("\"learned-reward\"", "\"paper\"").replace("sigma = 0.001", "sigma = 0.01");
        let restart = "[restart]\nbackoff_ms = 10.0\nhealthy_s = 1.0\ngive_up_after = 200\n";
        let scenario = folder.write_file("scenario.toml", format!("{head}\n[encoder]{tail}\n{restart}"));
        Self {
            protocol,
            scenario: scenario.to_str().unwrap().to_owned(),
            rng: stream(seed, protocol),
            faults: BTreeMap::new(),
            sessions: 0,
            slowest: BTreeMap::new(),
            domains: Vec::new(),
            arm: Arm::start(&folder, protocol),
            folder,
        }
    }

    fn one_of(&mut self, list: &[&'static str]) -> &'static str {
        list[self.rng.random_range(0..list.len())]
    }

    /// Lets a random time pass, up to `most` s.
    fn pause(&mut self, most: f64) {
        let until = Instant::now() + Duration::from_secs_f64(most * self.rng.random::<f64>());
        while let Some(left) = until.checked_duration_since(Instant::now()) {
            std::thread::park_timeout(left);
        }
    }

    /// Waits until torque is off after a fault, and checks how far the shafts turned.
    fn safe(&mut self, fault: &str, ids: &[usize], since: Instant) {
        let what = format!("{}, {fault}, fault {}", self.protocol, self.count() + 1);
        self.arm.wait(ids, false, &what);
        let took = self.slowest.entry(fault.to_owned()).or_default();
        *took = took.max(since.elapsed().as_secs_f64());
        let (turned, most) = (self.arm.unattended(), 5.0 * PERIOD * MAX_SPEED);
        assert!(
            turned <= most,
            "{what}: a shaft turned {turned} rad without an instruction; at most {most} are allowed"
        );
        *self.faults.entry(fault.to_owned()).or_default() += 1;
    }

    fn count(&self) -> u64 {
        self.faults.values().sum()
    }

    /// Starts a run, in a terminal if there is one.
    fn start(&mut self, terminal: Option<&TestTerminal>) -> Process {
        self.sessions += 1;
        let name = format!("session-{}", self.sessions);
        let run = ["run", self.scenario.as_str(), "--ticks", TICKS, "--out", &name];
        let mut run = match terminal {
            Some(terminal) => terminal.start(&self.folder, &run, true),
            None => self.folder.start(TECTUM, &run),
        };
        let folder = self.folder.path().join(&name);
        run.wait_until("the run's manifest", || folder.join("run.json").exists());
        self.domains.push(domain(&folder));
        run
    }

    /// A run with some passing faults and a final one.
    fn session(&mut self) {
        let end = self.one_of(&FINAL);
        let terminal = (end == TERMINAL).then(|| TestTerminal::new([80, 24]));
        let mut run = self.start(terminal.as_ref());
        self.arm.wait_for_torque(true, "the start of a run");
        for _ in 0..self.rng.random_range(0..4) {
            self.pause(1.5);
            let fault = self.one_of(&PASSING);
            self.passing(&mut run, fault);
            self.arm.wait_for_torque(true, fault);
        }
        self.pause(1.5);
        self.last(run, end, terminal);
    }

    fn passing(&mut self, run: &mut Process, fault: &str) {
        let since = Instant::now();
        match fault {
            "cable" => {
                self.arm.emulator.send_command("unplug");
                self.pause(1.5);
                self.arm.emulator.send_command("plug");
            }
            "answers lost" => self.arm.emulator.send_command("fault no-reply:2:0:1.5"),
            // The gate's hold and decay are over before the controller is back, or they are not.
            "controller KILL" => {
                let before = run.kill_child("tectum-controller");
                run.next_child_pid("tectum-controller", before);
                *self.faults.entry(fault.to_owned()).or_default() += 1;
                return;
            }
            "controller STOP" => {
                let controller = run.child_pid("tectum-controller");
                signal_process(controller, "STOP");
                self.safe(fault, &[1, 2, 3, 4], since);
                return signal_process(controller, "CONT");
            }
            // The processes go on without it.
            "launcher STOP" => {
                run.signal("STOP");
                self.pause(1.5);
                run.signal("CONT");
                *self.faults.entry(fault.to_owned()).or_default() += 1;
                return;
            }
            signal => signal_process(run.child_pid("tectum-bridge"), &signal["bridge ".len()..]),
        }
        self.safe(fault, &[1, 2, 3, 4], since);
    }

    fn last(&mut self, mut run: Process, fault: &str, terminal: Option<TestTerminal>) {
        let since = Instant::now();
        let (who, signal) = fault.rsplit_once(' ').unwrap();
        let mut processes = children(run.id());
        match who {
            "terminal" => terminal.expect("a terminal").hang_up(),
            "bridge" => signal_process(run.child_pid("tectum-bridge"), signal),
            "guard" => {
                let guards = children(run.child_pid("tectum-bridge"));
                guards.iter().for_each(|(guard, _)| signal_process(*guard, signal));
            }
            "launcher" => run.signal(signal),
            _ => {
                self.arm.emulator.send_command("unplug");
                self.pause(1.0);
                run.signal("INT");
                run.wait_until_or_end("the end of the run", || false);
                self.arm.emulator.send_command("plug");
            }
        }
        self.safe(fault, &[1, 2, 3, 4], since);
        // Without its guard, and after some signals to the bridge, the run goes on without torque.
        if who == "guard" || who == "bridge" {
            run.signal("INT");
        }
        run.wait();
        while let Some((pid, name)) = processes.pop() {
            let began = Instant::now();
            while !has_ended(pid) {
                assert!(began.elapsed() < WATCHDOG, "{fault}: {name} hangs");
                std::thread::park_timeout(Duration::from_millis(10));
            }
        }
    }

    /// Starts a motion of the second joint, and returns when it has torque. A loaded machine may refuse one.
    fn start_jog(&mut self) -> (Process, TestTerminal) {
        // Towards the middle, so that the joint has room.
        self.arm.unattended();
        let at = self.arm.servos[1]["position"].as_f64().unwrap().rem_euclid(4096.0);
        let by = if at > 2048.0 { "-1.5" } else { "1.5" };
        let jog = ["jog", "--port", "arm", "--protocol", self.protocol, "--id", "2", "--by", by, "--speed", "0.2"];
        for _ in 0..5 {
            let terminal = TestTerminal::new([80, 24]);
            let mut process = terminal.start_program(BRIDGE, &self.folder, &jog, true);
            let arm = &mut self.arm;
            process.wait_until_or_end("torque of `jog`", || {
                arm.unattended();
                arm.servos[1]["torque"] == true
            });
            if self.arm.servos[1]["torque"] == true {
                return (process, terminal);
            }
            println!("{}: jog: {:?}", self.protocol, terminal.text());
        }
        panic!("jog was refused five times");
    }

    /// One motion of a joint, in which `jog` meets a fault.
    fn jog(&mut self) {
        let (jog, terminal) = self.start_jog();
        self.pause(1.0);
        let (fault, since) = (self.one_of(&JOG), Instant::now());
        match fault {
            "cable" => {
                self.arm.emulator.send_command("unplug");
                self.pause(1.0);
                self.arm.emulator.send_command("plug");
            }
            TERMINAL => terminal.hang_up(),
            signal => jog.signal(signal),
        }
        self.safe(&format!("jog {fault}"), &[2], since);
        assert_ne!(jog.wait().code, Some(0), "jog {fault}");
    }

    /// Another run wipes what a killed launcher has left; nothing of any run remains.
    fn finish(mut self) {
        let run = self.start(None);
        self.arm.wait_for_torque(true, "the last run");
        run.signal("INT");
        run.wait().expect(130);
        self.arm.wait_for_torque(false, "the last run");
        let left: Vec<_> = self.domains.iter().flat_map(|domain| shared_memory(domain)).collect();
        assert!(left.is_empty(), "left in /dev/shm: {left:?}");
        let (count, turned) = (self.count(), self.arm.unattended());
        println!("{}: {count} faults in {} runs; longest turn {turned:.3} rad", self.protocol, self.sessions);
        for (fault, count) in &self.faults {
            let slowest = self.slowest.get(fault).map_or("-".to_owned(), |seconds| format!("{seconds:.2} s"));
            println!("  {fault:26} {count:4}  torque off within {slowest}");
        }
    }
}

fn soak(protocol: &'static str, goal: &str) {
    let number = |name: &str, default: u64| {
        std::env::var(name).map_or(default, |text| text.parse().unwrap_or_else(|e| panic!("{name}: {e}")))
    };
    let (faults, seed) = (number("TECTUM_SOAK_FAULTS", 100), number("TECTUM_SOAK_SEED", 1));
    let mut soak = Soak::new(protocol, goal, seed);
    while soak.count() < faults {
        match soak.rng.random_range(0..4) {
            0 => soak.jog(),
            _ => soak.session(),
        }
        println!("{protocol}: {} faults", soak.count());
    }
    soak.finish();
}

/// A Feetech has no watchdog, so its default is position goals: it stops by itself.
#[test]
#[ignore = "takes minutes; see above"]
fn feetech() {
    soak("feetech", "position");
}

/// A Dynamixel's own watchdog stops it while its cable is out, also with speed goals.
#[test]
#[ignore = "takes minutes; see above"]
fn dynamixel() {
    soak("dynamixel", "speed");
}
