//! Property tests over random maps and inputs: the kernel and the scalar implementation agree bit for bit,
//! padding is 0, no feature is subnormal, and all errors are within the documented bound.

use std::f64::consts::PI;

use proptest::prelude::*;

use super::{Axis, Encoder, Map, SimdPath, naive};

/// Number of inputs of the random maps.
const INPUTS: usize = 5;

/// An axis with a radius between a thousandth and a thousand times its spacing.
fn axis() -> impl Strategy<Value = Axis> {
    (0..INPUTS, 2usize..=70, -10.0f64..10.0, -2.0f64..2.0, -3.0f64..3.0).prop_map(
        |(input, units, min, width, ratio)| {
            let width = 10f64.powf(width);
            let radius = 10f64.powf(ratio) * width / (units - 1) as f64;
            Axis { input, units, min, max: min + width, radius }
        },
    )
}

fn map() -> impl Strategy<Value = Map> {
    prop_oneof![axis().prop_map(Map::Line), (axis(), axis()).prop_map(|(slow, fast)| Map::Plane(slow, fast))]
}

/// Mostly near the ranges of the axes; sometimes far outside, or any finite number.
fn input() -> impl Strategy<Value = f32> {
    let finite = any::<f32>().prop_filter("finite", |x| x.is_finite());
    prop_oneof![6 => -20.0f32..20.0, 2 => -1e6f32..1e6, 1 => finite, 1 => Just(1e30f32)]
}

/// What happens to an input from one call to the next.
#[derive(Debug, Clone, Copy)]
enum Change {
    Hold,
    Jump(f32),
    Jitter,
    Sign,
    Scalar(f32),
}

fn change() -> impl Strategy<Value = Change> {
    prop_oneof![
        4 => Just(Change::Hold),
        2 => input().prop_map(Change::Jump),
        2 => Just(Change::Jitter),
        1 => Just(Change::Sign),
        1 => input().prop_map(Change::Scalar),
    ]
}

/// The error bound of the crate's documentation, for one axis.
fn bound(axis: &Axis, x: f64) -> f64 {
    let largest = axis.min.abs().max(axis.max.abs()).max(x.abs().min(1e9)) * 0.85 / axis.radius;
    (0.72 * largest * 2f64.powi(-23)).min(1.0) + 5e-7
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn the_kernel_equals_the_scalar_implementation(
        maps in prop::collection::vec(map(), 1..6),
        rounds in prop::collection::vec(prop::array::uniform5(input()), 1..4),
        normalise: bool,
    ) {
        let mut encoder = Encoder::new(&maps, normalise);
        let mut kernels: Vec<_> = SimdPath::all().map(|path| encoder.clone().on(path)).collect();
        let (mut fast, mut scalar) = (encoder.features(), encoder.features());
        let mut is_unit = vec![false; encoder.len()];
        encoder.positions().for_each(|at| is_unit[at] = true);
        prop_assert_eq!(is_unit.iter().filter(|&&unit| unit).count(), encoder.units());

        for inputs in rounds {
            encoder.encode_scalar(&inputs, &mut scalar);
            let bits = |features: &[f32]| features.iter().map(|g| g.to_bits()).collect::<Vec<_>>();
            for kernel in &mut kernels {
                fast.as_mut_slice().fill(f32::NAN); // every element must be overwritten
                kernel.encode(&inputs, &mut fast);
                prop_assert_eq!(bits(fast.as_slice()), bits(scalar.as_slice()));
            }
            for (g, unit) in fast.as_slice().iter().zip(&is_unit) {
                prop_assert!(if *unit { g.is_normal() && *g > 0.0 } else { g.to_bits() == 0 }, "{}", g);
            }
            if normalise {
                let norm = fast.as_slice().iter().map(|&g| f64::from(g).powi(2)).sum::<f64>().sqrt();
                prop_assert!((norm - 1.0).abs() < 1e-6, "norm {}", norm);
            }
        }
    }

    /// The activations of planes whose inputs keep their bits are not computed again.
    #[test]
    fn inputs_that_jump_hold_and_jitter_give_the_features_of_a_new_encoder(
        maps in prop::collection::vec(map(), 1..6),
        start in prop::array::uniform5(input()),
        changes in prop::collection::vec((0..INPUTS, change()), 1..30),
        normalise: bool,
    ) {
        let plain = Encoder::new(&maps, normalise);
        for path in SimdPath::all() {
            let (mut encoder, mut inputs) = (plain.clone().on(path), start);
            let (mut seen, mut expected) = (encoder.features(), encoder.features());
            for (input, change) in &changes {
                let x = &mut inputs[*input];
                match *change {
                    Change::Hold => {}
                    Change::Jump(to) => *x = to,
                    Change::Jitter => *x = f32::from_bits(x.to_bits() ^ 1),
                    Change::Sign => *x = -*x,
                    // The other implementation in between, which leaves its own activations.
                    Change::Scalar(to) => encoder.encode_scalar(&[to; INPUTS], &mut seen),
                }
                encoder.encode(&inputs, &mut seen);
                plain.clone().on(path).encode(&inputs, &mut expected);
                let bits = |features: &[f32]| features.iter().map(|g| g.to_bits()).collect::<Vec<_>>();
                prop_assert_eq!(bits(seen.as_slice()), bits(expected.as_slice()));
            }
        }
    }

    #[test]
    fn error_stays_within_the_bound(
        maps in prop::collection::vec(map(), 1..4),
        inputs in prop::array::uniform5(input()),
    ) {
        let mut encoder = Encoder::new(&maps, false);
        let mut features = encoder.features();
        encoder.encode(&inputs, &mut features);
        let exact = inputs.map(f64::from);
        let bounds = maps.iter().flat_map(|map| match map {
            Map::Line(axis) => vec![bound(axis, exact[axis.input]); axis.units],
            Map::Plane(slow, fast) => {
                vec![bound(slow, exact[slow.input]) + bound(fast, exact[fast.input]); slow.units * fast.units]
            }
        });
        let expected = naive::reference(&maps, &exact, false);
        for ((at, expected), bound) in encoder.positions().zip(expected).zip(bounds) {
            let error = (f64::from(features.as_slice()[at]) - expected).abs();
            prop_assert!(error <= bound, "{} instead of {}", features.as_slice()[at], expected);
        }
    }
}

fn line(input: usize, units: usize, radius: f64) -> Axis {
    Axis { input, units, min: -1.0, max: 1.0, radius }
}

#[test]
fn rows_are_padded_and_positions_skip_the_padding() {
    let maps = [Map::Line(line(0, 5, 0.5)), Map::Plane(line(1, 3, 0.5), line(0, 6, 0.5)), Map::Line(line(1, 4, 0.5))];
    let encoder = Encoder::new(&maps, true);
    assert_eq!((encoder.units(), encoder.len()), (5 + 18 + 4, 8 + 24 + 4));
    let positions: Vec<usize> = encoder.positions().collect();
    assert_eq!(positions[..5], [0, 1, 2, 3, 4]);
    assert_eq!(positions[5..12], [8, 9, 10, 11, 12, 13, 16]);
    assert_eq!(positions[23..], [32, 33, 34, 35]);
    assert_eq!((encoder.index(0, 0, 4), encoder.index(1, 2, 1), encoder.index(2, 0, 3)), (4, 25, 35));
    assert_eq!(encoder.features().as_slice().as_ptr() as usize % 64, 0);
}

#[test]
fn a_unit_whose_centre_is_the_input_has_activation_one() {
    for radius in [1e-300, 1e-45, 1e-3, 0.5, 1e3, 1e45, 1e300] {
        let mut encoder = Encoder::new(&[Map::Line(line(0, 3, radius))], false);
        let mut features = encoder.features();
        encoder.encode(&[0.0], &mut features);
        assert_eq!(features.as_slice()[1], 1.0, "radius {radius}");
        assert_eq!(features.as_slice()[3], 0.0, "radius {radius}");
    }
}

#[test]
fn far_inputs_and_nan_give_the_floor() {
    let maps = [Map::Plane(line(0, 16, 0.5), line(0, 6, 0.5)), Map::Line(line(0, 5, 0.5))];
    let mut raw = Encoder::new(&maps, false);
    let mut normalised = Encoder::new(&maps, true);
    let mut features = raw.features();
    for x in [1e3, -1e30, f32::MAX, f32::INFINITY, f32::NEG_INFINITY, f32::NAN] {
        raw.encode(&[x], &mut features);
        let (plane, line) = (features.as_slice()[0], features.as_slice()[raw.index(1, 0, 0)]);
        assert!((1.0..1.01).contains(&(f64::from(line) / (-30f64).exp())), "{x}: {line:e}");
        assert!((1.0..1.01).contains(&(f64::from(plane) / (-60f64).exp())), "{x}: {plane:e}");
        assert_eq!(features.as_slice()[raw.index(1, 0, 4) + 1..], [0.0; 3]);
        normalised.encode(&[x], &mut features);
        assert!(features.as_slice().iter().all(|g| g.is_finite()), "{x}");
    }
}

#[test]
fn a_plane_far_outside_still_has_norm_one() {
    // Squares of exp(-60) are below the range of single precision.
    let mut encoder = Encoder::new(&[Map::Plane(line(0, 16, 0.5), line(1, 16, 0.5))], true);
    let mut features = encoder.features();
    encoder.encode(&[1e9, -1e9], &mut features);
    features.as_slice().iter().for_each(|g| assert!((g - 1.0 / 16.0).abs() < 1e-7, "{g}"));
}

#[test]
fn baselines_agree_with_the_reference() {
    let axis = |input, half: f64| Axis { input, units: 13, min: -half, max: half, radius: 0.5 };
    let maps = [Map::Plane(axis(0, 1.0), axis(1, 2.0)), Map::Line(axis(2, PI))];
    let inputs = [0.3f32, -0.7, 2.9];
    for normalise in [false, true] {
        let expected = naive::reference(&maps, &inputs.map(f64::from), normalise);
        let mut plain = vec![f32::NAN; expected.len()];
        let mut check = |name: &str, encode: &mut dyn FnMut(&mut [f32])| {
            encode(&mut plain);
            plain.iter().zip(&expected).for_each(|(g, e)| assert!((f64::from(*g) - e).abs() < 1e-6, "{name}"));
        };
        check("naive", &mut |out| naive::NaiveEncoder::new(&maps, normalise).encode(&inputs, out));
        check("separable", &mut |out| naive::SeparableEncoder::new(&maps, normalise).encode(&inputs, out));
    }
}

#[test]
fn an_encoder_without_maps_has_no_features() {
    let mut encoder = Encoder::new(&[], true);
    let mut features = encoder.features();
    encoder.encode(&[], &mut features);
    assert!(encoder.is_empty() && features.is_empty() && features.as_slice().is_empty());
}

#[test]
fn scalars_follow_the_maps_unchanged() {
    let maps = [Map::Line(line(0, 5, 0.5))];
    let mut encoder = Encoder::new(&maps, true).with_scalars(&[2, 0]);
    let mut features = encoder.features();
    let inputs = [0.25, 9.0, -7.5];
    encoder.encode(&inputs, &mut features);
    let order: Vec<_> = encoder.positions().collect();
    assert_eq!((encoder.units(), encoder.len(), order.len()), (7, 12, 7));
    assert_eq!([features.as_slice()[order[5]], features.as_slice()[order[6]]], [-7.5, 0.25]);
    let norm: f32 = order[..5].iter().map(|&at| features.as_slice()[at].powi(2)).sum();
    assert!((norm - 1.0).abs() < 1e-6, "only the maps are normalised");
    // Scalars alone, as for the paper's scalar eye, over memory that was not cleared.
    let mut bare = Encoder::new(&[], true).with_scalars(&[1]);
    let mut features = bare.features();
    features.as_mut_slice().fill(3.0);
    bare.encode_scalar(&inputs, &mut features);
    assert_eq!(features.as_slice(), [9.0, 0.0, 0.0, 0.0]);
}
