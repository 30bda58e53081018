//! What a tick costs on the controller's side: the part that the command waits for, the account after it, and the whole
//! tick of plant and controller in one process.

use criterion::{Criterion, criterion_group, criterion_main};
use std::hint::black_box;
use tectum::plant::Body;
use tectum::runtime::{Controller, PlantSide};
use tectum::scenario::{Plan, Scenario};
use tectum::wire::{Command, Learning, Observation};

fn plan() -> Plan {
    Scenario::find("paper").unwrap().plan().unwrap()
}

/// A controller in the middle of things, with a ring of observations as they come from a real run.
fn running(plan: &Plan) -> (Controller, Vec<Observation>) {
    let mut plant = PlantSide::new(Body::of(plan).unwrap(), plan);
    let mut controller = Controller::new(plan);
    let (mut observation, mut command) = (Observation::default(), Command::default());
    let mut ring = Vec::new();
    for tick in 0..4096 {
        plant.observe(tick, 0, 0, &mut observation);
        controller.respond(&observation, &mut command);
        plant.live(tick, Some(&command));
        ring.push(observation);
    }
    (controller, ring)
}

fn controller(c: &mut Criterion) {
    let plan = plan();
    let (mut controller, ring) = running(&plan);
    let mut group = c.benchmark_group("controller/arm320");
    let mut tick = 4096_u64;
    let mut command = Command::default();
    group.bench_function("learn, encode, answer", |b| {
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
    group.bench_function("account and learning record", |b| {
        b.iter(|| {
            let observation = &ring[(tick % 4096) as usize];
            tick += 1;
            controller.settle(black_box(observation));
            controller.record(observation, &mut learning);
            black_box(&learning);
        });
    });
    group.finish();
}

fn in_process(c: &mut Criterion) {
    let plan = plan();
    let mut plant = PlantSide::new(Body::of(&plan).unwrap(), &plan);
    let mut controller = Controller::new(&plan);
    let (mut observation, mut command) = (Observation::default(), Command::default());
    let mut tick = 0;
    c.bench_function("in process/tick of plant and controller", |b| {
        b.iter(|| {
            plant.observe(tick, 0, 0, &mut observation);
            controller.respond(&observation, &mut command);
            controller.settle(&observation);
            plant.live(tick, Some(&command));
            tick += 1;
        });
    });
}

criterion_group!(benches, controller, in_process);
criterion_main!(benches);
