//! What encoding costs: the arm's 320 features by every implementation and on every path, and how that grows with the
//! number of units, along a line and on a plane.
//!
//! Every call takes the next of a ring of inputs, so that no branch is learnt by heart and nothing is a constant.

use std::f64::consts::PI;
use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use tectum::encoder::naive::{NaiveEncoder, SeparableEncoder};
use tectum::encoder::{Axis, Encoder, Map};
use tectum::simd::SimdPath;

/// Inputs of the ring; a power of two.
const RING: usize = 256;

/// The arm of section 4.2: a 16x16 plane for the target, a line of 16 for each of four angles.
fn arm() -> Vec<Map> {
    let axis = |input, half: f64| Axis { input, units: 16, min: -half, max: half, radius: 0.5 };
    let mut maps = vec![Map::Plane(axis(0, 1.0), axis(1, 1.0))];
    maps.extend((2..6).map(|input| Map::Line(axis(input, PI))));
    maps
}

/// Inputs over the arm's ranges, from a fixed linear congruential generator.
fn ring() -> Vec<[f32; 6]> {
    let mut state = 2010u64;
    let mut draw = |half: f64| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (((state >> 11) as f64 / (1u64 << 53) as f64 * 2.0 - 1.0) * half) as f32
    };
    (0..RING).map(|_| [draw(1.0), draw(1.0), draw(PI), draw(PI), draw(PI), draw(PI)]).collect()
}

/// Runs `encode` over the ring.
fn over_ring(bencher: &mut criterion::Bencher, mut encode: impl FnMut(&[f32])) {
    let ring = ring();
    let mut next = 0;
    bencher.iter(|| {
        next = (next + 1) % RING;
        encode(black_box(&ring[next]));
    });
}

fn arm320(criterion: &mut Criterion) {
    let maps = arm();
    let mut encoder = Encoder::new(&maps, true);
    let mut features = encoder.features();
    let mut plain = vec![0.0f32; encoder.units()];
    let (naive, mut separable) = (NaiveEncoder::new(&maps, true), SeparableEncoder::new(&maps, true));

    let mut group = criterion.benchmark_group("encode/arm320");
    group.bench_function("naive", |b| {
        over_ring(b, |inputs| {
            naive.encode(inputs, &mut plain);
            black_box(&mut plain);
        });
    });
    group.bench_function("separable", |b| {
        over_ring(b, |inputs| {
            separable.encode(inputs, &mut plain);
            black_box(&mut plain);
        });
    });
    group.bench_function("twin", |b| {
        over_ring(b, |inputs| {
            encoder.encode_scalar(inputs, &mut features);
            black_box(&mut features);
        });
    });
    for path in SimdPath::all() {
        let mut encoder = encoder.clone().on(path);
        group.bench_function(format!("kernel, {path}"), |b| {
            over_ring(b, |inputs| {
                encoder.encode(inputs, &mut features);
                black_box(&mut features);
            });
        });
    }
    group.finish();
}

/// From 32 units to 32,768: `shape` gives the maps of so many.
fn scaling(criterion: &mut Criterion, name: &str, shape: impl Fn(u32) -> Map) {
    let mut group = criterion.benchmark_group(name);
    for power in (5..=15).step_by(2) {
        for path in SimdPath::all() {
            let mut encoder = Encoder::new(&[shape(power)], true).on(path);
            let mut features = encoder.features();
            group.throughput(Throughput::Elements(1 << power));
            group.bench_function(BenchmarkId::new(path.to_string(), 1 << power), |b| {
                over_ring(b, |inputs| {
                    encoder.encode(inputs, &mut features);
                    black_box(&mut features);
                });
            });
        }
    }
    group.finish();
}

/// A line of n units needs n exponentials, a plane some `2 sqrt n`: its cost per feature falls.
fn lines_and_planes(criterion: &mut Criterion) {
    let axis = |input, units| Axis { input, units, min: -1.0, max: 1.0, radius: 0.5 };
    scaling(criterion, "encode/line", |power| Map::Line(axis(0, 1 << power)));
    scaling(criterion, "encode/plane", |power| {
        let slow = power / 2;
        Map::Plane(axis(0, 1 << slow), axis(1, 1 << (power - slow)))
    });
}

criterion_group!(benches, arm320, lines_and_planes);
criterion_main!(benches);
