//! Compares the number of instructions of a tick with a recorded number, so that an unintended change is noticed. (A
//! loop over lanes that is no longer inlined takes ten times as many instructions.)
//!
//! The instructions are counted one by one: this program starts itself again and steps with ptrace through the part
//! between two signals. That needs no hardware counters and gives the same number every time. Where ptrace is not
//! allowed, the test prints that it is skipped, and passes. The numbers below belong to rustc 1.95; a very different
//! version may need new ones. `cargo test --test instructions` checks the numbers of the test profile; with `--release`
//! it checks those of the programs that users run.

use std::io::{BufRead, BufReader, Write};
use std::process::{Command, ExitCode, Stdio};

use nix::sys::ptrace;
use nix::sys::signal::Signal;
use nix::sys::wait::{WaitStatus, waitpid};
use nix::unistd::Pid;
use tectum::runtime::Simulation;
use tectum::scenario::Scenario;
use tectum::simd::SimdPath;

/// The environment variable that names the part to count, when the program is started to be counted.
const PART: &str = "TECTUM_COUNTED_PART";

/// Ticks before the counted ones.
const BEFORE: u64 = 2000;
/// Ticks that are counted.
const COUNTED: u64 = 4;

/// The recorded numbers: part, path, and instructions a tick of the paper's arm in the release and in the test profile.
const RECORDED: [(&str, &str, [u64; 2]); 9] = [
    ("encode", "sse2", [1453, 1470]),
    ("encode", "avx2", [929, 1214]),
    ("encode", "avx512", [765, 898]),
    ("respond", "sse2", [6764, 7772]),
    ("respond", "avx2", [3573, 5625]),
    ("respond", "avx512", [2701, 3912]),
    ("tick", "sse2", [9632, 12209]),
    ("tick", "avx2", [6398, 10042]),
    ("tick", "avx512", [5512, 8298]),
];

/// The largest tolerated difference, in percent.
const TOLERANCE: u64 = 5;

fn main() -> ExitCode {
    if let Ok(part) = std::env::var(PART) {
        run_counted_part(&part);
        return ExitCode::SUCCESS;
    }
    let profile = usize::from(cfg!(debug_assertions));
    let mut changed = false;
    for (what, path, recorded) in RECORDED {
        if !SimdPath::all().any(|here| here.to_string() == path) {
            println!("{what}, {path}: skipped, this machine has no such path");
            continue;
        }
        match count(&format!("{what} {path}")) {
            Ok(seen) => {
                let (seen, recorded) = (seen / COUNTED, recorded[profile]);
                let same = seen.abs_diff(recorded) * 100 <= recorded * TOLERANCE;
                println!("{what}, {path}: {seen} instructions a tick, recorded {recorded}");
                changed |= !same;
            }
            Err(error) => println!("{what}, {path}: skipped, this process may not be stepped through ({error})"),
        }
    }
    if changed {
        println!("more than {TOLERANCE} % off: find out why, and record the new numbers in tests/instructions.rs");
    }
    ExitCode::from(u8::from(changed))
}

/// Counts the instructions of a part, minus those of an empty part.
fn count(part: &str) -> nix::Result<u64> {
    let program = std::env::current_exe().unwrap();
    let mut child = Command::new(program).env(PART, part).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let pid = Pid::from_raw(child.id() as i32);
    let mut ready = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut ready).unwrap();
    let counted = ptrace::attach(pid).and_then(|()| {
        waitpid(pid, None)?;
        child.stdin.take().unwrap().write_all(b"go\n").unwrap();
        ptrace::cont(pid, None)?;
        assert_eq!(waitpid(pid, None)?, WaitStatus::Stopped(pid, Signal::SIGUSR1), "the first mark");
        let overhead = step_to_mark(pid)?;
        Ok(step_to_mark(pid)? - overhead)
    });
    let _ = child.kill();
    let _ = child.wait();
    counted
}

/// Steps to the next mark and returns the number of instructions.
fn step_to_mark(pid: Pid) -> nix::Result<u64> {
    let mut steps = 0;
    loop {
        ptrace::step(pid, None)?;
        steps += 1;
        match waitpid(pid, None)? {
            WaitStatus::Stopped(_, Signal::SIGTRAP) => {}
            WaitStatus::Stopped(_, Signal::SIGUSR1) => return Ok(steps),
            status => panic!("the counted program stopped otherwise: {status:?}"),
        }
    }
}

/// The counted program: prepares the part, waits until ptrace is attached, and marks where counting begins and ends.
fn run_counted_part(part: &str) {
    let (what, path) = part.split_once(' ').unwrap();
    let path = SimdPath::all().find(|here| here.to_string() == path).unwrap();
    let plan = Scenario::find("paper").unwrap().plan().unwrap();
    // What the programs run is compiled in the runtime, and this test, as the library, without optimisation.
    let mut run = Simulation::new(&plan, plan.simulated_plant().unwrap()).on(path);
    let mut encoder = plan.encoder().on(path);
    let mut features = encoder.features();
    let tick = |run: &mut Simulation| {
        let observation = *run.sense();
        run.answer();
        run.improve();
        run.advance();
        observation
    };
    let seen: Vec<_> = (0..BEFORE).map(|_| tick(&mut run)).skip((BEFORE - COUNTED) as usize).collect();
    println!("ready");
    std::io::stdin().read_line(&mut String::new()).unwrap();
    mark();
    mark();
    match what {
        "encode" => seen.iter().for_each(|seen| encoder.encode(&seen.inputs[..6], &mut features)),
        "tick" => (0..COUNTED).for_each(|_| _ = tick(&mut run)),
        _ => {
            let mut observation = seen[0];
            for k in BEFORE..BEFORE + COUNTED {
                observation.header.tick = k;
                run.answer_to(&observation);
            }
        }
    }
    mark();
}

/// A signal that the counting process observes.
fn mark() {
    rustix::process::kill_process(rustix::process::getpid(), rustix::process::Signal::USR1).unwrap();
}
