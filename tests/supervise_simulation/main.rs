//! The launcher's loop over a simulated world: thousands of short runs with seeded faults, in stepped time.
//! Processes die, hang, stop, do not get ready, close slowly or not at all; signals come; the operating system
//! refuses to start a process, or has no memory. After each run the rules are checked that hold whatever happens.
//!
//! A failure names its seed; `TECTUM_SIMULATE=SEED` runs that one alone and prints what happened in it, and
//! `TECTUM_SIMULATE=A..B` runs a range, on all cores:
//!
//! ```text
//! TECTUM_SIMULATE=0..100000 cargo test --test supervise_simulation      # a minute on two cores
//! ```
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
const SEEDS: u64 = 20_000;

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

    fn kinds(&mut self) -> [&mut u64; 7] {
        let Self { complete, signal, failed, never_ran, restarts, killed_as_hung, finished_after_a_loss } = self;
        [complete, signal, failed, never_ran, restarts, killed_as_hung, finished_after_a_loss]
    }

    fn add(&mut self, mut part: Self) {
        self.kinds().into_iter().zip(part.kinds()).for_each(|(sum, count)| *sum += *count);
    }

    /// Whether every kind of run occurred often enough for the rules to have been tried.
    fn is_rich(&mut self, seeds: u64) -> bool {
        self.kinds().into_iter().all(|count| *count > seeds / 200)
    }
}

/// What the worlds of these seeds came to, or what does not hold and for which seed.
fn census(seeds: impl Iterator<Item = u64>, told: bool) -> Result<Census, String> {
    let mut census = Census::default();
    for seed in seeds {
        let seen =
            simulate(seed).map_err(|what| format!("seed {seed}: {what}\nTECTUM_SIMULATE={seed} runs it alone"))?;
        if told {
            eprintln!("{}", seen.account());
        }
        census.count(&seen);
    }
    Ok(census)
}

#[test]
fn whatever_happens_the_run_ends_as_it_must() {
    let (seeds, told) = seeds();
    let count = seeds.end - seeds.start;
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let parts: Vec<_> = std::thread::scope(|scope| {
        let part = |i| {
            let seeds = seeds.clone().skip(i).step_by(threads);
            scope.spawn(move || census(seeds, told))
        };
        let running: Vec<_> = (0..threads).map(part).collect();
        running.into_iter().map(|part| part.join().unwrap()).collect()
    });
    let mut census = Census::default();
    for part in parts {
        census.add(part.unwrap_or_else(|what| panic!("{what}")));
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
