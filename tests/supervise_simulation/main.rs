//! The launcher's loop over a simulated world: thousands of short runs with seeded faults, in stepped time.
//! Processes die, hang, stop, do not get ready, close slowly or not at all; signals come; the operating system
//! refuses to start a process, or has no memory. After each run the rules are checked that hold whatever happens.
//!
//! A failure names its seed; `TECTUM_SIMULATE=SEED` runs that one alone and prints what happened in it, and
//! `TECTUM_SIMULATE=A..B` runs a range.
//!
//! It found that a set-up which takes longer than `set_up_s`, as one by hand does, had all processes killed as hung
//! when ticks began, and that after Ctrl-C a restarted process that was still setting up kept the others from
//! closing in good order. That it finds what is put back was seen with changes of `src/supervise`: losses are not
//! announced; hung processes or stalled runs are not noticed; a run that failed ends as complete; policies or the
//! count of restarts in a row are not heeded; two processes set up at a time; a refused start is neither tried
//! again nor said; a process is left at the end.

mod process;
mod world;

use std::ops::Range;

use tectum::supervise::{SupervisedWorld as _, Supervisor};
use tectum::wire::{ProcessState, Role};

use world::{SimulatedWorld, World};

/// Seeds in the usual test.
const SEEDS: u64 = 100_000;

/// The seeds of `TECTUM_SIMULATE`, and whether it names one alone.
fn seeds() -> (Range<u64>, bool) {
    let Ok(text) = std::env::var("TECTUM_SIMULATE") else { return (0..SEEDS, false) };
    let number = |text: &str| text.parse::<u64>().expect("TECTUM_SIMULATE is a seed, or A..B");
    match text.split_once("..") {
        Some((from, until)) => (number(from)..number(until), false),
        None => (number(&text)..number(&text) + 1, true),
    }
}

/// Runs the launcher's loop over the world of `seed`, and checks what holds for every run. The sentence says what does
/// not hold.
fn simulate(seed: u64) -> Result<World, String> {
    let world = SimulatedWorld::new(seed);
    let (rules, view) = (world.rules(), world.view());
    let mut supervisor = Supervisor::new(world, &rules);
    let set_up = supervisor.set_up();
    let began = supervisor.world().now_ns();
    if let Err(error) = set_up {
        let seen = view.take();
        return match seen.may_fail_to_set_up() {
            true => Ok(seen),
            false => Err(format!("it could not be set up, and nothing was in the way: {error}")),
        };
    }
    supervisor.run_ticks(began);
    supervisor.close(began);
    if !supervisor.world().all_ended() {
        return Err("a process is left when the run is over".to_owned());
    }
    let end = supervisor.into_end();
    let seen = view.take();
    match seen.check(&end) {
        Ok(()) => Ok(seen),
        Err(what) => Err(format!("{what}\n{}", seen.account())),
    }
}

/// What the worlds of a range of seeds came to.
#[derive(Debug, Default)]
struct Census {
    complete: u64,
    signal: u64,
    failed: u64,
    never_ran: u64,
    restarts: u64,
    killed_as_hung: u64,
    finished_after_a_loss: u64,
}

impl Census {
    fn count(&mut self, seen: &World) {
        *match seen.outcome() {
            None => &mut self.never_ran,
            Some(tectum::supervise::RunOutcome::Complete) => &mut self.complete,
            Some(tectum::supervise::RunOutcome::Signal(_)) => &mut self.signal,
            Some(tectum::supervise::RunOutcome::Failed) => &mut self.failed,
        } += 1;
        self.restarts += seen.restarts();
        self.killed_as_hung += seen.killed_as_hung();
        let finished = |role: &Role| seen.board(*role).state() == ProcessState::Finished;
        let lost = Role::ALL.iter().any(|role| !finished(role));
        self.finished_after_a_loss += u64::from(lost && Role::ALL.iter().any(finished));
    }

    /// Whether every kind of run occurred often enough for the rules to have been tried.
    fn is_rich(&self, seeds: u64) -> bool {
        let kinds = [
            self.complete,
            self.signal,
            self.failed,
            self.never_ran,
            self.restarts,
            self.killed_as_hung,
            self.finished_after_a_loss,
        ];
        kinds.iter().all(|&count| count > seeds / 200)
    }
}

#[test]
fn whatever_happens_the_run_ends_as_it_must() {
    let (seeds, told) = seeds();
    let count = seeds.end - seeds.start;
    let mut census = Census::default();
    for seed in seeds {
        match simulate(seed) {
            Ok(seen) => {
                if told {
                    eprintln!("{}", seen.account());
                }
                census.count(&seen);
            }
            Err(what) => panic!("seed {seed}: {what}\nTECTUM_SIMULATE={seed} runs it alone"),
        }
    }
    assert!(count < 1000 || census.is_rich(count), "{census:?}");
    eprintln!("{count} seeds: {census:?}");
}

#[test]
fn a_seed_gives_the_same_run_again() {
    for seed in 0..200 {
        let runs = [simulate(seed), simulate(seed)].map(|run| run.unwrap_or_else(|what| panic!("seed {seed}: {what}")));
        assert_eq!(runs[0].history(), runs[1].history(), "seed {seed}");
    }
}
