//! Compares the encoder with features that another program computed in double precision
//! (`tests/reference/make_reference.py`).
//!
//! The file's features belong to its double-precision inputs; the encoder takes `f32`. Two comparisons separate the
//! error of rounded inputs from the encoder's own error:
//!
//! - with the definition in double precision *at the rounded inputs*: the difference is the encoder's own error, and
//!   must stay within 1e-6;
//! - with the file: rounding an input moves it by up to `|x| 2^-24`, and a feature by at most `0.607 / radius` times
//!   that (the steepest slope of a Gaussian, `exp(-1/2) / radius`). For radius 0.5 and an angle of pi that is 2.3e-7;
//!   a plane takes the sum over its two axes, at most 3e-7 for the log-polar eye. So 1e-6 + 3e-7 must hold here.
//!
//! The same tolerances cover normalised features: the norm is above 1, and the error of the norm is smaller still.

use std::f64::consts::PI;

use serde_json::Value;
use tectum::encoder::{Axis, Encoder, Map, naive};

/// The largest allowed error of the encoder itself.
const ENCODER_ERROR: f64 = 1e-6;

/// The largest error that rounding the inputs to `f32` may add.
const ROUNDED_INPUTS: f64 = 3e-7;

fn reference() -> Value {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/reference/encoder.json");
    serde_json::from_str(&std::fs::read_to_string(path).expect("the reference file")).expect("JSON")
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().expect("an array").iter().map(|x| x.as_f64().expect("a number")).collect()
}

fn axis(input: usize, min: f64, max: f64) -> Axis {
    Axis { input, units: 16, min, max, radius: 0.5 }
}

/// Compares the kernel and the scalar twin with the file and with the definition at the rounded inputs. Returns the
/// largest error of the latter comparison.
fn check(maps: &[Map], normalise: bool, inputs: &[f64], expected: &[f64]) -> f64 {
    let inputs: Vec<f32> = inputs.iter().map(|&x| x as f32).collect();
    let exact = naive::reference(maps, &inputs.iter().map(|&x| f64::from(x)).collect::<Vec<_>>(), normalise);
    let mut encoder = Encoder::new(maps, normalise);
    assert_eq!(encoder.units(), expected.len());
    let mut worst: f64 = 0.0;
    for twin in [false, true] {
        let mut features = encoder.features();
        if twin {
            encoder.encode_scalar(&inputs, &mut features)
        } else {
            encoder.encode(&inputs, &mut features)
        };
        for ((at, exact), expected) in encoder.positions().zip(&exact).zip(expected) {
            let feature = f64::from(features.as_slice()[at]);
            worst = worst.max((feature - exact).abs());
            let error = (feature - expected).abs();
            assert!(
                error <= ENCODER_ERROR + ROUNDED_INPUTS,
                "feature {at}: {feature} instead of {expected}, twin: {twin}"
            );
        }
    }
    assert!(worst <= ENCODER_ERROR, "error {worst:e}, normalise: {normalise}");
    worst
}

#[test]
fn the_arms_features_match_the_reference() {
    let mut maps = vec![Map::Plane(axis(0, -1.0, 1.0), axis(1, -1.0, 1.0))];
    maps.extend((2..6).map(|input| Map::Line(axis(input, -PI, PI))));
    let reference = reference();
    let cases = reference["arm"].as_array().expect("cases");
    assert!(cases.len() >= 10);
    let (mut raw, mut normalised): (f64, f64) = (0.0, 0.0);
    for case in cases {
        let inputs = [numbers(&case["target"]), numbers(&case["theta"])].concat();
        raw = raw.max(check(&maps, false, &inputs, &numbers(&case["features"])));
        normalised = normalised.max(check(&maps, true, &inputs, &numbers(&case["normalised"])));
    }
    println!("largest error, arm: {raw:.2e} raw, {normalised:.2e} normalised");
}

/// The retina's log-polar transform, distortion B = 4, in double precision.
fn log_polar(p: &[f64]) -> [f64; 2] {
    const B: f64 = 4.0;
    [(1.0 + B * p[0].hypot(p[1])).ln() / (1.0 + B).ln(), p[1].atan2(p[0])]
}

#[test]
fn the_eyes_features_match_the_reference() {
    let plane = |range: [(f64, f64); 2], input| {
        Map::Plane(axis(input, range[0].0, range[0].1), axis(input + 1, range[1].0, range[1].1))
    };
    let reference = reference();
    let cases = reference["eye"].as_array().expect("cases");
    let mut counts = [0, 0];
    let mut worst: f64 = 0.0;
    for case in cases {
        let (position, velocity) = (numbers(&case["position"]), numbers(&case["velocity"]));
        let (range, inputs) = match case["retina"].as_str() {
            Some("linear") => {
                counts[0] += 1;
                ([(-1.0, 1.0), (-1.0, 1.0)], [position, velocity].concat())
            }
            Some("log_polar") => {
                counts[1] += 1;
                ([(0.0, 1.0), (-PI, PI)], [log_polar(&position), log_polar(&velocity)].concat())
            }
            other => panic!("unknown retina {other:?}"),
        };
        worst = worst.max(check(&[plane(range, 0), plane(range, 2)], false, &inputs, &numbers(&case["features"])));
    }
    assert!(counts[0] >= 4 && counts[1] >= 4, "cases of each retina: {counts:?}");
    println!("largest error, eye: {worst:.2e}");
}

/// The file has few inputs. This sweep over the arm's ranges searches for the largest error.
#[test]
fn features_over_the_arms_ranges_match_double_precision() {
    let mut maps = vec![Map::Plane(axis(0, -1.0, 1.0), axis(1, -1.0, 1.0))];
    maps.extend((2..6).map(|input| Map::Line(axis(input, -PI, PI))));
    for normalise in [false, true] {
        let mut encoder = Encoder::new(&maps, normalise);
        let mut features = encoder.features();
        let mut worst: f64 = 0.0;
        for step in 0..20_000 {
            let part = |k: f64| ((f64::from(step) * k).fract() * 2.0 - 1.0) as f32;
            let (a, b) = (part(0.618_034), part(0.414_214));
            let pi = PI as f32;
            let inputs = [a, b, a * pi, b * pi, part(0.732_051) * pi, part(0.236_068) * pi];
            encoder.encode(&inputs, &mut features);
            let exact = naive::reference(&maps, &inputs.map(f64::from), normalise);
            for (at, exact) in encoder.positions().zip(exact) {
                worst = worst.max((f64::from(features.as_slice()[at]) - exact).abs());
            }
        }
        println!("largest error, sweep: {worst:.2e}, normalise: {normalise}");
        assert!(worst <= ENCODER_ERROR, "error {worst:e}");
    }
}
