//! What `tectum bench encoder` and the criterion bench `encoder` time: every version of the encoder on the
//! arm's 320 features, and lines and planes of any number of features.
//!
//! Every call takes the next input of a ring, so that the branch predictor cannot learn an input by heart and
//! nothing is a constant.

use std::f64::consts::PI;
use std::hint::black_box;

use super::SCENARIO;
use super::calls::{CallCase, GrowthKey};
use crate::encoder::naive::{NaiveEncoder, SeparableEncoder};
use crate::encoder::{Axis, Encoder, Map};
use crate::scenario::{Scenario, ScenarioError};
use crate::simd::SimdPath;

/// Calls for which the arm's target holds.
const HELD_CALLS: u64 = 80;

/// Number of inputs in the ring; a power of two.
const RING: usize = 256;

/// A ring of inputs over the arm's ranges: target in m, angles in rad.
pub struct InputRing(Vec<[f32; 6]>);

impl Default for InputRing {
    /// Inputs from a fixed linear congruential generator.
    fn default() -> Self {
        let mut state = 2010u64;
        let mut draw = |half: f64| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (((state >> 11) as f64 / (1u64 << 53) as f64 * 2.0 - 1.0) * half) as f32
        };
        let mut input = || [draw(1.0), draw(1.0), draw(PI), draw(PI), draw(PI), draw(PI)];
        Self((0..RING).map(|_| input()).collect())
    }
}

impl InputRing {
    /// A case that encodes one input after the other.
    fn case<'a, K>(&'a self, key: K, mut encode: impl FnMut(&[f32]) + 'a) -> CallCase<'a, K> {
        let mut next = 0;
        CallCase::new(key, move || {
            next = (next + 1) % RING;
            encode(black_box(&self.0[next]));
        })
    }

    /// The case of the final encoder for `maps` on `path`.
    fn kernel_case<K>(&self, key: K, maps: &[Map], path: SimdPath) -> CallCase<'_, K> {
        let mut encoder = Encoder::new(maps, true).on(path);
        let mut features = encoder.features();
        self.case(key, move |inputs| {
            encoder.encode(inputs, &mut features);
            black_box(&mut features);
        })
    }

    /// A case of the arm's encoder, with new angles in every call and the target that `target` makes of the number of
    /// the call and a new target.
    fn target_case<'a, K>(
        &'a self,
        key: K,
        maps: &[Map],
        path: SimdPath,
        mut target: impl FnMut(u64, [f32; 2]) -> [f32; 2] + 'a,
    ) -> CallCase<'a, K> {
        let mut encoder = Encoder::new(maps, true).on(path);
        let mut features = encoder.features();
        let mut calls = 0;
        self.case(key, move |inputs| {
            let mut here = [0.0; 6];
            here.copy_from_slice(inputs);
            let [x, y] = target(calls, [here[0], here[1]]);
            (here[0], here[1]) = (x, y);
            calls += 1;
            encoder.encode(black_box(&here), &mut features);
            black_box(&mut features);
        })
    }

    /// The encoder of the paper's arm (section 4.2) in every version; their keys are (what is called, version).
    ///
    /// # Errors
    /// [`ScenarioError`], though the scenario is built in.
    pub fn versions(&self) -> Result<Vec<CallCase<'_, (String, String)>>, ScenarioError> {
        let key = |version: String| ("encode the arm's 320 features".to_owned(), version);
        let maps = Scenario::built_in(SCENARIO)?.plan()?.maps;
        let (naive, mut separable) = (NaiveEncoder::new(&maps, true), SeparableEncoder::new(&maps, true));
        let mut scalar = Encoder::new(&maps, true);
        let mut features = scalar.features();
        let (mut naive_out, mut separable_out) = (vec![0.0_f32; scalar.units()], vec![0.0_f32; scalar.units()]);
        let mut cases = vec![
            self.case(key("naive".to_owned()), move |inputs| {
                naive.encode(inputs, &mut naive_out);
                black_box(&mut naive_out);
            }),
            self.case(key("separable".to_owned()), move |inputs| {
                separable.encode(inputs, &mut separable_out);
                black_box(&mut separable_out);
            }),
            self.case(key("scalar twin".to_owned()), move |inputs| {
                scalar.encode_scalar(inputs, &mut features);
                black_box(&mut features);
            }),
        ];
        cases.extend(SimdPath::all().map(|path| self.kernel_case(key(format!("final, {path}")), &maps, path)));
        // A target that holds, as in the scenarios, and one that never does: a tracker's, with noise in its last bits.
        for path in SimdPath::all() {
            let mut held = [0.0; 2];
            cases.push(self.target_case(key(format!("target held, {path}")), &maps, path, move |call, new| {
                if call.is_multiple_of(HELD_CALLS) {
                    held = new;
                }
                held
            }));
            let jitter = |call: u64, _| [0.3, -0.4].map(|x: f32| f32::from_bits(x.to_bits() ^ (call as u32 & 7)));
            cases.push(self.target_case(key(format!("target jitters, {path}")), &maps, path, jitter));
        }
        Ok(cases)
    }

    /// The final encoder for 2^`power` features, as a line and as a plane, on every path. A line of n units needs n
    /// exponentials, a plane about `2 sqrt n`: its cost per feature falls with n.
    pub fn growth(&self, power: u32) -> Vec<CallCase<'_, GrowthKey>> {
        let axis = |input, units| Axis { input, units, min: -1.0, max: 1.0, radius: 0.5 };
        let slow = power / 2;
        let shapes = [
            ("encode a line", Map::Line(axis(0, 1 << power))),
            ("encode a plane", Map::Plane(axis(0, 1 << slow), axis(1, 1 << (power - slow)))),
        ];
        let cases = shapes.into_iter().flat_map(|shape| SimdPath::all().map(move |path| (shape, path)));
        let case = |((what, map), path): ((&str, Map), SimdPath)| {
            let key = GrowthKey { what: what.to_owned(), path, features: 1 << power, outputs: 1 };
            self.kernel_case(key, &[map], path)
        };
        cases.map(case).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_arm_has_a_plane_for_the_target_and_a_line_for_each_angle() {
        let axis = |input, half: f64| Axis { input, units: 16, min: -half, max: half, radius: 0.5 };
        let mut maps = vec![Map::Plane(axis(0, 1.0), axis(1, 1.0))];
        maps.extend((2..6).map(|input| Map::Line(axis(input, PI))));
        assert_eq!(Scenario::built_in(SCENARIO).unwrap().plan().unwrap().maps, maps);
    }
}
