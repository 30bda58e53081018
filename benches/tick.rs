//! What a tick costs on the controller's side: the learning rule by itself in three versions and by size, the part that the
//! command waits for, the account after it, and the whole tick of plant and controller in one process. The same for the
//! learned-reward rule, whose tick is a thousand times dearer.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;
use tectum::learner::PaperRule;
use tectum::learner::naive::NaivePaperRule;
use tectum::policy::{LinearPolicy, Outputs};
use tectum::runtime::{Controller, PlantSide};
use tectum::scenario::{Plan, Scenario};
use tectum::simd::SimdPath;
use tectum::wire::{Command, Learning, Observation};

const NOISE: Outputs = [0.003, -0.002, 0.001, -0.004, 0.002, -0.001, 0.004, -0.003];

fn plan(name: &str) -> Plan {
    Scenario::find(name).unwrap().plan().unwrap()
}

/// Features as an encoder makes them: positive, of unit norm.
fn features(len: usize) -> [Vec<f32>; 2] {
    let norm = (len as f32 / 3.0).sqrt();
    [0.37, 0.73].map(|k| (0..len).map(|i| (i as f32 * k).fract() / norm).collect())
}

/// Learns from one tick and answers the next: the textbook's loops, learning and answering apart, and both in one pass.
fn paper(c: &mut Criterion) {
    let mut group = c.benchmark_group("learn and answer/4 x 320");
    let [now, next] = features(320);
    let mut textbook = NaivePaperRule::new(320, 4, 0.98, 1e-3);
    group.bench_function("textbook", |b| {
        b.iter(|| {
            textbook.step(black_box(&now), &NOISE, -0.1);
            black_box(textbook.mean(black_box(&next)));
        });
    });
    for path in SimdPath::all() {
        let mut policy = LinearPolicy::new(320, (0..320).collect(), 4).on(path);
        let mut rule = PaperRule::new(320, 4, 0.98, 1e-3);
        group.bench_function(format!("two passes, {path}"), |b| {
            b.iter(|| {
                rule.step(&mut policy, black_box(&now), &NOISE, -0.1);
                black_box(policy.mean(black_box(&next)));
            });
        });
        group.bench_function(format!("one pass, {path}"), |b| {
            let mut mean = [0.0; 8];
            b.iter(|| {
                rule.step_and_answer(&mut policy, black_box([&now, &next]), &NOISE, -0.1, &mut mean);
                black_box(&mean);
            });
        });
    }
    group.finish();
}

/// The cost is linear in features times outputs, as long as weights and trace stay in a cache.
fn scaling(c: &mut Criterion) {
    let mut group = c.benchmark_group("learn and answer");
    for (outputs, power) in [4, 8].into_iter().flat_map(|outputs| (5..=15).step_by(2).map(move |p| (outputs, p))) {
        let len = 1_usize << power;
        let [now, next] = features(len);
        for path in SimdPath::all() {
            let mut policy = LinearPolicy::new(len, (0..len).collect(), outputs).on(path);
            let mut rule = PaperRule::new(len, outputs, 0.98, 1e-3);
            group.throughput(Throughput::Elements((len * outputs) as u64));
            group.bench_function(BenchmarkId::new(path.to_string(), format!("{outputs} x {len}")), |b| {
                let mut mean = [0.0; 8];
                b.iter(|| {
                    rule.step_and_answer(&mut policy, black_box([&now, &next]), &NOISE, -0.1, &mut mean);
                    black_box(&mean);
                });
            });
        }
    }
    group.finish();
}

/// A controller in the middle of things, with a ring of observations as they come from a real run.
fn running(plan: &Plan, path: SimdPath, ticks: u64) -> (Controller, Vec<Observation>) {
    let mut plant = PlantSide::new(plan.simulated_plant().unwrap(), plan);
    let mut controller = Controller::new(plan).on(path);
    let (mut observation, mut command) = (Observation::default(), Command::default());
    let mut ring = Vec::new();
    for tick in 0..ticks {
        plant.observe(tick, 0, 0, &mut observation);
        controller.respond(&observation, &mut command);
        controller.after_command(&observation);
        plant.step(tick, Some(&command));
        ring.push(observation);
    }
    (controller, ring)
}

fn controller(c: &mut Criterion) {
    let plan = plan("paper");
    let mut group = c.benchmark_group("controller/arm320");
    for path in SimdPath::all() {
        let (mut controller, ring) = running(&plan, path, 4096);
        let mut tick = 4096_u64;
        let mut command = Command::default();
        group.bench_function(format!("learn, encode, answer, {path}"), |b| {
            b.iter(|| {
                let mut observation = ring[(tick % 4096) as usize];
                observation.header.tick = tick;
                observation.header.flags = 0;
                tick += 1;
                controller.respond(black_box(&observation), &mut command);
                black_box(&command);
            });
        });
        let mut learning = Learning::default();
        group.bench_function(format!("account and learning record, {path}"), |b| {
            b.iter(|| {
                let observation = &ring[(tick % 4096) as usize];
                tick += 1;
                controller.after_command(black_box(observation));
                controller.record(observation, &mut learning);
                black_box(&learning);
            });
        });
    }
    group.finish();
}

fn in_process(c: &mut Criterion) {
    let mut group = c.benchmark_group("in process/tick of plant and controller");
    for (name, path) in
        SimdPath::all().map(|path| ("paper", path)).chain([("arm", SimdPath::best()), ("eye", SimdPath::best())])
    {
        let plan = plan(name);
        let mut plant = PlantSide::new(plan.simulated_plant().unwrap(), &plan);
        let mut controller = Controller::new(&plan).on(path);
        let (mut observation, mut command) = (Observation::default(), Command::default());
        let mut tick = 0;
        group.bench_function(format!("{name}, {path}"), |b| {
            b.iter(|| {
                plant.observe(tick, 0, 0, &mut observation);
                controller.respond(&observation, &mut command);
                controller.after_command(&observation);
                plant.step(tick, Some(&command));
                tick += 1;
            });
        });
    }
    group.finish();
}

criterion_group!(benches, paper, scaling, controller, in_process);
criterion_main!(benches);
