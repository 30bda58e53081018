//! `tectum bench encoder`: the arm's 320 features by every version and on every path, and lines and planes of 32 to 32,768
//! features.
//!
//! Every call takes the next of a ring of inputs, so that no branch is learnt by heart and nothing is a constant.

use std::f64::consts::PI;
use std::hint::black_box;

use super::calls::{CallCase, in_turns};
use super::costs::{CallCost, CallsSettings, CostsOutcome, Growth};
use super::{BenchError, Machine};
use crate::clock::{TerminationSignals, monotonic_ns};
use crate::encoder::naive::{NaiveEncoder, SeparableEncoder};
use crate::encoder::{Axis, Encoder, Map};
use crate::simd::SimdPath;
use crate::supervise::{LaunchError, ProgressLine, RunFolder};

/// Inputs of the ring; a power of two.
const RING: usize = 256;
/// Numbers of features, as powers of two.
pub(super) const POWERS: std::ops::RangeInclusive<u32> = 5..=15;

/// The arm of section 4.2: a 16x16 plane for the target, a line of 16 for each of four angles.
fn arm() -> Vec<Map> {
    let axis = |input, half: f64| Axis { input, units: 16, min: -half, max: half, radius: 0.5 };
    let mut maps = vec![Map::Plane(axis(0, 1.0), axis(1, 1.0))];
    maps.extend((2..6).map(|input| Map::Line(axis(input, PI))));
    maps
}

/// Inputs over the arm's ranges, from a fixed linear congruential generator.
fn notify() -> Vec<[f32; 6]> {
    let mut state = 2010u64;
    let mut draw = |half: f64| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (((state >> 11) as f64 / (1u64 << 53) as f64 * 2.0 - 1.0) * half) as f32
    };
    (0..RING).map(|_| [draw(1.0), draw(1.0), draw(PI), draw(PI), draw(PI), draw(PI)]).collect()
}

/// A case that encodes the ring's inputs one after the other.
fn over_ring<'a, K>(key: K, notify: &'a [[f32; 6]], mut encode: impl FnMut(&[f32]) + 'a) -> CallCase<'a, K> {
    let mut next = 0;
    CallCase::new(key, move || {
        next = (next + 1) % RING;
        encode(black_box(&notify[next]));
    })
}

/// The encoder of `maps` on `path`, as a case.
fn kernel<'a, K>(key: K, notify: &'a [[f32; 6]], maps: &[Map], path: SimdPath) -> CallCase<'a, K> {
    let mut encoder = Encoder::new(maps, true).on(path);
    let mut features = encoder.features();
    over_ring(key, notify, move |inputs| {
        encoder.encode(inputs, &mut features);
        black_box(&mut features);
    })
}

fn versions(notify: &[[f32; 6]]) -> Vec<CallCase<'_, String>> {
    let maps = arm();
    let (naive, mut separable) = (NaiveEncoder::new(&maps, true), SeparableEncoder::new(&maps, true));
    let mut twin = Encoder::new(&maps, true);
    let mut features = twin.features();
    let (mut naive_out, mut separable_out) = (vec![0.0_f32; twin.units()], vec![0.0_f32; twin.units()]);
    let mut cases = vec![
        over_ring("naive".to_owned(), notify, move |inputs| {
            naive.encode(inputs, &mut naive_out);
            black_box(&mut naive_out);
        }),
        over_ring("separable".to_owned(), notify, move |inputs| {
            separable.encode(inputs, &mut separable_out);
            black_box(&mut separable_out);
        }),
        over_ring("scalar twin".to_owned(), notify, move |inputs| {
            twin.encode_scalar(inputs, &mut features);
            black_box(&mut features);
        }),
    ];
    cases.extend(SimdPath::all().map(|path| kernel(format!("final, {path}"), notify, &maps, path)));
    cases
}

/// Lines and planes of 2^power features.
fn shapes(power: u32) -> [(&'static str, Map); 2] {
    let axis = |input, units| Axis { input, units, min: -1.0, max: 1.0, radius: 0.5 };
    let slow = power / 2;
    [
        ("encode a line", Map::Line(axis(0, 1 << power))),
        ("encode a plane", Map::Plane(axis(0, 1 << slow), axis(1, 1 << (power - slow)))),
    ]
}

/// Measures.
///
/// # Errors
/// When the folder cannot be used, or a signal ends it.
pub fn encoder(asked: &CallsSettings) -> Result<CostsOutcome, BenchError> {
    asked.check()?;
    let signals = TerminationSignals::install().map_err(LaunchError::Signals)?;
    let folder = RunFolder::create(asked.out.as_deref(), None, "bench-encoder")?;
    let began = monotonic_ns();
    let machine = Machine::now(folder.path());
    let mut progress = ProgressLine::new(asked.progress);
    let notify = notify();
    progress.show("encoder: versions");
    let costs = in_turns(versions(&notify), asked.batches, &signals)?
        .into_iter()
        .map(|(version, ns)| CallCost { what: "encode the arm's 320 features".to_owned(), version, ns })
        .collect();
    progress.show("encoder: growth");
    let sizes = POWERS.flat_map(|power| shapes(power).map(|(name, map)| (power, name, map)));
    let sizes = sizes.flat_map(|(power, name, map)| SimdPath::all().map(move |path| (power, name, map, path)));
    let cases = sizes.map(|(power, name, map, path)| kernel((power, name, path), &notify, &[map], path)).collect();
    let mut growth: Vec<Growth> = in_turns(cases, asked.batches, &signals)?
        .into_iter()
        .map(|((power, name, path), ns)| Growth {
            what: name.to_owned(),
            path: path.to_string(),
            features: 1 << power,
            outputs: 1,
            ns,
            ns_each: ns.median / f64::from(1_u32 << power),
        })
        .collect();
    growth.sort_by(|a, b| (&a.what, &a.path, a.features).cmp(&(&b.what, &b.path, b.features)));
    let outcome = CostsOutcome {
        what: "encoder",
        costs,
        growth,
        machine,
        seconds: (monotonic_ns() - began) as f64 / 1e9,
        folder: folder.path().to_owned(),
    };
    folder.keep();
    outcome.write()?;
    Ok(outcome)
}
