//! A round trip of observation and command between two processes over a run's own channels, with criterion:
//! polling with a yield, as in lockstep, and woken by an event, as in real time. The peer is a second process
//! (this program, started again), never a thread.
//!
//! These are back-to-back round trips with warm caches: a lower bound for the transport, not the latency of a
//! control loop. For that see the percentiles that `tectum run --mode realtime` prints.

use std::io::{BufRead as _, BufReader, Write as _};
use std::process::{Child, Command as Program, Stdio};
use std::time::Duration;

use criterion::Criterion;
use tectum::channel::{ControllerPorts, DomainName, PlantPorts, RunServices};
use tectum::clock::{Backoff, ProcessHandle, monotonic_ns, precise_timers};
use tectum::runtime::identity;
use tectum::scenario::{Plan, Scenario};
use tectum::wire::{Command, Observation};

/// The environment variable that tells the peer which domain to join, and how to wait.
const PEER: &str = "TECTUM_BENCH_PEER";

fn plan() -> Plan {
    Scenario::find("paper").unwrap().plan().unwrap()
}

fn main() {
    match std::env::var(PEER) {
        Ok(task) => serve(&task),
        Err(_) => measure(),
    }
}

/// The peer: answers every observation with a command, until its parent ends.
fn serve(task: &str) {
    let (run, wait) = task.split_once(' ').unwrap();
    let plan = plan();
    let name = DomainName::of(run.parse().unwrap());
    let (mut ports, _status) = ControllerPorts::open(&name, &identity(&plan), &plan.scenario.channels).unwrap();
    let parent = ProcessHandle::of(rustix::process::getppid().unwrap().as_raw_pid() as u32).unwrap();
    precise_timers();
    println!("ready");
    std::io::stdout().flush().unwrap();
    let mut command = Command::default();
    let mut backoff = Backoff::default();
    loop {
        while let Some(observation) = ports.observation.receive().unwrap() {
            command.header.tick = observation.header.tick;
            ports.command.send(&command).unwrap();
            backoff = Backoff::default();
        }
        let check = if wait == "event" {
            ports.wake.wait(Duration::from_millis(100));
            true
        } else {
            backoff.pause()
        };
        if check && parent.ended() {
            return;
        }
    }
}

struct PeerProcess(Child);

impl Drop for PeerProcess {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn measure() {
    let mut criterion = Criterion::default().configure_from_args();
    let plan = plan();
    let (channels, identity) = (&plan.scenario.channels, identity(&plan));
    for wait in ["poll and yield", "event"] {
        let run = u64::from(std::process::id()) << 32 | wait.len() as u64;
        let name = DomainName::of(run);
        let _services = RunServices::create(&name, &identity, channels, None, false).unwrap();
        let (ports, _status) = PlantPorts::open(&name, &identity, channels).unwrap();
        let child = Program::new(std::env::current_exe().unwrap())
            .env(PEER, format!("{run} {wait}"))
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut peer = PeerProcess(child);
        let mut ready = String::new();
        BufReader::new(peer.0.stdout.take().unwrap()).read_line(&mut ready).unwrap();

        let mut observation = Observation::default();
        criterion.bench_function(&format!("transport/round trip, {wait}"), |b| {
            b.iter(|| {
                observation.header.tick += 1;
                ports.observation.send(&observation).unwrap();
                if wait == "event" {
                    ports.wake.notify();
                }
                let began = monotonic_ns();
                let mut backoff = Backoff::default();
                while ports.command.receive().unwrap().is_none_or(|c| c.header.tick != observation.header.tick) {
                    if backoff.pause() {
                        assert!(monotonic_ns() - began < 60_000_000_000, "the peer does not answer");
                    }
                }
            });
        });
    }
    criterion.final_summary();
}
