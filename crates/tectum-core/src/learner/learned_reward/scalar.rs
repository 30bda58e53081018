//! Rollouts in plain `f32`, one after the other: the test oracle of the loops over lanes. Both do the same operations
//! in the same order, so they must agree bit for bit.

use rand::RngExt as _;
use tectum_encoder::{Axis, Map};

use super::basis::Basis;
use super::map_features::{AxisKernels, MapFeatures};
use super::rollout_cost::RolloutCost;
use super::rollouts::State;
use super::tests::spec;
use super::*;
use crate::MAX_OUTPUTS;
use crate::angle::wrap;
use crate::learner::{ModelBasis, dot};

/// The features of one rollout, and the values and slopes of all lines.
#[derive(Clone, Default)]
struct Encoded {
    features: Vec<f32>,
    lines: Vec<[Vec<f32>; 2]>,
    squares: f32,
}

fn eval(line: &AxisKernels, inputs: &State) -> [Vec<f32>; 2] {
    let [mut values, mut slopes] = [(); 2].map(|()| vec![0.0; line.row.units]);
    line.row.eval(inputs[line.input], &mut values, &mut slopes);
    [values, slopes]
}

fn encode(group: &MapFeatures, inputs: &State) -> Encoded {
    let mut encoded = Encoded::default();
    let squares = |line: &[f32]| line.iter().map(|v| v * v).sum::<f32>();
    let mut totals = Vec::new();
    for map in &group.maps {
        let fast = eval(&map.fast, inputs);
        let slow = map.slow.as_ref().map(|slow| eval(slow, inputs));
        match &slow {
            Some([slow, _]) => encoded.features.extend(slow.iter().flat_map(|s| fast[0].iter().map(move |f| s * f))),
            None => encoded.features.extend_from_slice(&fast[0]),
        }
        totals.push(squares(&fast[0]) * slow.as_ref().map_or(1.0, |slow| squares(&slow[0])));
        encoded.lines.extend(slow);
        encoded.lines.push(fast);
    }
    encoded.squares = totals.iter().sum();
    encoded
}

fn backpropagate(group: &MapFeatures, encoded: &Encoded, along: &[f32], fixed: usize, slopes: &mut State) {
    let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>();
    let (mut rest, mut lines) = (along, encoded.lines.iter());
    for map in &group.maps {
        let here = rest.split_off(..map.units()).unwrap();
        let Some(slow) = &map.slow else {
            slopes[map.fast.input - fixed] += dot(here, &lines.next().unwrap()[1]);
            continue;
        };
        let ([slow_values, slow_slopes], [v, d]) = (lines.next().unwrap(), lines.next().unwrap());
        for (i, row) in here.chunks_exact(v.len()).enumerate() {
            if map.fast.input >= fixed {
                slopes[map.fast.input - fixed] += slow_values[i] * dot(row, d);
            }
            if slow.input >= fixed {
                slopes[slow.input - fixed] += slow_slopes[i] * dot(row, v);
            }
        }
    }
}

fn functions(bases: &[Basis], inputs: &[f32]) -> [Vec<Vec<f32>>; 2] {
    let mut both = [Vec::new(), Vec::new()];
    for (basis, &x) in bases.iter().zip(inputs) {
        let [mut values, mut slopes] = [(); 2].map(|()| vec![0.0; basis.len()]);
        basis.eval(x, &mut values, &mut slopes);
        both[0].push(values);
        both[1].push(slopes);
    }
    both
}

/// The constant part of the cost, and the coefficients of the moved inputs' functions.
fn linear_cost(cost: &RolloutCost, inputs: &State) -> (f32, Vec<f32>) {
    let first = cost.terms.starts[cost.terms.fixed];
    let [values, _] = functions(&cost.terms.bases[..cost.terms.fixed], inputs);
    let mut linear = vec![0.0; cost.moved_functions()];
    let mut constant = -cost.weights[0];
    if let Some(singles) = cost.terms.singles {
        linear.iter_mut().zip(&cost.weights[singles + first..]).for_each(|(l, w)| *l = -w);
        constant -= values.concat().iter().zip(&cost.weights[singles..]).map(|(v, w)| v * w).sum::<f32>();
    }
    for &(i, j, start) in cost.terms.pairs.iter().filter(|(i, _, _)| *i < cost.terms.fixed) {
        let columns = cost.terms.bases[j].len();
        let rows = cost.weights[start..].chunks_exact(columns).zip(&values[i]);
        if j < cost.terms.fixed {
            let along = |row: &[f32]| row.iter().zip(&values[j]).map(|(w, b)| w * b).sum::<f32>();
            constant -= rows.map(|(row, a)| a * along(row)).sum::<f32>();
            continue;
        }
        for (row, v) in rows {
            linear[cost.terms.starts[j] - first..].iter_mut().zip(row).for_each(|(l, w)| *l -= v * w);
        }
    }
    (constant, linear)
}

/// The part of the cost that depends on the moved inputs `inputs`, and its slopes along them.
fn moved_cost(cost: &RolloutCost, inputs: &[f32], linear: &[f32]) -> (f32, Vec<f32>) {
    let [values, slopes] = functions(&cost.terms.bases[cost.terms.fixed..], inputs);
    let mut along = linear.to_vec();
    for (row, v) in cost.products.chunks_exact(linear.len()).zip(values.iter().flatten()) {
        along.iter_mut().zip(row).for_each(|(out, w)| *out += v * w);
    }
    let mut rest = &along[..];
    let slopes = slopes.iter().map(|slopes| {
        let here = rest.split_off(..slopes.len()).unwrap();
        here.iter().zip(slopes).map(|(g, d)| g * d).sum()
    });
    let slopes = slopes.collect();
    let twice = along.iter().zip(linear).zip(values.iter().flatten());
    (0.5 * twice.map(|((s, l), v)| (s + l) * v).sum::<f32>(), slopes)
}

/// One tick of a rollout.
struct Tick {
    encoded: Encoded,
    scale: f32,
    mean: Outputs,
    changes: State,
    cost_slopes: Vec<f32>,
}

/// Simulates one rollout, adds cost and slope to those of `candidate`, and returns where it ends.
fn simulate(rollouts: &Rollouts, candidate: &mut CandidatePolicy, movement: &MovementModel, inputs: &State) -> State {
    let (constants, groups) = (&rollouts.constants, &rollouts.feature_groups);
    let (fixed, moved) = (constants.fixed, constants.wraps.len());
    let (constant, linear) = linear_cost(&rollouts.cost, inputs);
    let target = encode(&groups[0], inputs);
    let mut of_target = [0.0; MAX_OUTPUTS];
    let rows = candidate.weights[0].chunks_exact(target.features.len().max(1));
    of_target.iter_mut().zip(rows).for_each(|(output, row)| *output = dot(row, &target.features));
    let (mut last, mut state, mut ticks, before) = (0.0, *inputs, Vec::new(), candidate.cost);
    for _ in 0..rollouts.ticks.len() {
        let encoded = encode(&groups[1], &state);
        let scale = if constants.normalise { 1.0 / (target.squares + encoded.squares).sqrt() } else { 1.0 };
        let mut mean = [0.0; MAX_OUTPUTS];
        let rows = candidate.weights[1].chunks_exact(encoded.features.len().max(1));
        for ((mean, of_target), row) in mean.iter_mut().zip(of_target).zip(rows) {
            *mean = (of_target + dot(row, &encoded.features)) * scale;
        }
        let applied: Outputs =
            std::array::from_fn(|i| mean[i].clamp(-constants.max_command[i], constants.max_command[i]));
        let mut changes = [0.0; MAX_INPUTS];
        for (i, &wraps) in constants.wraps.iter().enumerate() {
            changes[i] = movement.gains[i].iter().zip(&applied).map(|(b, u)| b * u).sum();
            let reached = state[fixed + i] + changes[i];
            state[fixed + i] = if wraps { wrap(reached) } else { reached };
        }
        let (part, cost_slopes) = moved_cost(&rollouts.cost, &state[fixed..fixed + moved], &linear);
        last = constant + part;
        let efforts = changes.iter().enumerate().take(moved).map(|(i, c)| rollouts.cost.effort(i) * c * c);
        candidate.cost += last + efforts.sum::<f32>();
        ticks.push(Tick { encoded, scale, mean, changes, cost_slopes });
    }
    candidate.cost += (constants.last_counts - 1.0) * last;
    candidate.add_deviation(candidate.cost - before);
    descend(rollouts, candidate, movement, &target.features, &ticks);
    state
}

/// Adds the slope of the cost of a rollout.
fn descend(
    rollouts: &Rollouts,
    candidate: &mut CandidatePolicy,
    movement: &MovementModel,
    target: &[f32],
    ticks: &[Tick],
) {
    let (constants, group) = (&rollouts.constants, &rollouts.feature_groups[1]);
    let (mut later, mut of_target) = ([0.0; MAX_INPUTS], [0.0; MAX_OUTPUTS]);
    let mut weight = constants.last_counts;
    let add = |to: &mut [f32], from: &[f32], factor: f32| to.iter_mut().zip(from).for_each(|(t, f)| *t += factor * f);
    for tick in ticks.iter().rev() {
        let mut slopes = [0.0; MAX_OUTPUTS];
        for (i, later) in later.iter_mut().enumerate().take(constants.wraps.len()) {
            *later += weight * tick.cost_slopes[i];
            let along = *later + 2.0 * rollouts.cost.effort(i) * tick.changes[i];
            add(&mut slopes, &movement.gains[i], along);
        }
        weight = 1.0;
        for ((slope, &mean), limit) in slopes.iter_mut().zip(&tick.mean).zip(&constants.max_command) {
            if mean.abs() > *limit && *slope * mean < 0.0 {
                *slope = 0.0;
            }
        }
        let norm: f32 = tick.mean.iter().zip(&slopes).map(|(u, o)| u * o).sum();
        let norm = if constants.normalise { norm * tick.scale * tick.scale } else { 0.0 };
        let mut along: Vec<f32> = tick.encoded.features.iter().map(|f| -norm * f).collect();
        of_target.iter_mut().zip(slopes).for_each(|(sum, slope)| *sum += slope * tick.scale);
        let n = along.len().max(1);
        let rows = candidate.weights[1].chunks_exact(n).zip(candidate.slope[1].chunks_exact_mut(n));
        for ((weights, slope), output) in rows.zip(slopes) {
            add(slope, &tick.encoded.features, output * tick.scale);
            add(&mut along, weights, output * tick.scale);
        }
        backpropagate(group, &tick.encoded, &along, constants.fixed, &mut later);
    }
    let rows = candidate.slope[0].chunks_exact_mut(target.len().max(1));
    rows.zip(of_target).for_each(|(slope, output)| add(slope, target, output));
}

/// Specifications that cover all cases: the arm, planes over moved and fixed inputs, rows that no block of lanes fits,
/// one output and all, no normalisation, no map of the target, inputs that do not wrap.
fn specs() -> Vec<LearnerSpec> {
    let axis = |input: usize, units: usize| Axis { input, units, min: -1.5, max: 1.5, radius: 0.6 };
    let plane = |slow, fast| Map::Plane(slow, fast);
    let maps = [
        vec![
            plane(axis(3, 5), axis(1, 6)),
            Map::Line(axis(0, 9)),
            plane(axis(0, 3), axis(4, 7)),
            Map::Line(axis(5, 17)),
        ],
        vec![plane(axis(2, 7), axis(5, 5)), Map::Line(axis(3, 2))],
        vec![Map::Line(axis(0, 20)), plane(axis(0, 4), axis(1, 5))],
    ];
    let mut specs = vec![spec(ModelBasis::Smooth), spec(ModelBasis::Maps)];
    for (maps, (outputs, normalise, wraps)) in
        maps.into_iter().zip([(1, true, None), (MAX_OUTPUTS, false, Some(false)), (5, true, None)])
    {
        let mut spec = LearnerSpec { maps, outputs, normalise, ..spec(ModelBasis::Smooth) };
        spec.inputs[3].wraps = wraps;
        specs.push(spec);
    }
    specs
}

/// A state in the input box, sometimes far outside.
fn draw_state(rule: &mut LearnedReward) -> State {
    let mut state = rule.sample_box();
    for x in &mut state[..rule.inputs.len()] {
        if rule.rng.random_bool(0.03) {
            *x *= 1e3;
        }
    }
    state
}

#[test]
fn rollouts_side_by_side_equal_rollouts_one_after_the_other() {
    for spec in specs() {
        let encoder = Encoder::new(&spec.maps, spec.normalise);
        let mut rule = LearnedReward::of(&spec, &encoder);
        let weights: Vec<f64> = rule.reward.weights().iter().map(|_| rule.rng.random::<f64>() - 0.6).collect();
        rule.rollouts.cost.load(&weights);
        for gain in rule.movement.gains.iter_mut().flat_map(|row| &mut row[..spec.outputs]) {
            *gain = 40.0 * (rule.rng.random::<f32>() - 0.5);
        }
        for weight in rule.champion.weights.iter_mut().flatten() {
            *weight = 0.2 * (rule.rng.random::<f32>() - 0.5);
        }
        let states: Vec<_> = (0..rule.config.movements + 5).map(|_| draw_state(&mut rule)).collect();
        let mut expected = rule.champion.clone();
        let ends: Vec<_> =
            states.iter().map(|state| simulate(&rule.rollouts, &mut expected, &rule.movement, state)).collect();
        assert!(expected.cost.is_finite() && expected.slope.iter().flatten().any(|s| *s != 0.0));
        let mut longer = Rollouts::new(
            rule.rollouts.feature_groups.clone(),
            &rule.reward,
            rule.rollouts.constants.clone(),
            rule.config.horizon,
            states.len(),
        );
        longer.cost.load(&weights);
        for path in SimdPath::all() {
            let (mut seen, mut moved) = (rule.champion.clone(), states.clone());
            longer.set_targets(path, &states);
            longer.simulate(path, &mut seen, &rule.movement, &mut moved);
            let bits = |states: &[State]| states.iter().flatten().map(|x| x.to_bits()).collect::<Vec<_>>();
            assert_eq!(bits(&moved), bits(&ends), "{path}");
            assert_eq!(seen.cost.to_bits(), expected.cost.to_bits(), "{path}");
            for (seen, expected) in seen.slope.iter().zip(&expected.slope) {
                for (at, (a, b)) in seen.iter().zip(expected).enumerate() {
                    assert_eq!(a.to_bits(), b.to_bits(), "{path}: {a} instead of {b} at {at}");
                }
            }
        }
    }
}

#[test]
fn features_match_the_encoder() {
    let axis = |input, units| Axis { input, units, min: -1.0, max: 1.0, radius: 0.4 };
    let maps = [Map::Plane(axis(0, 5), axis(1, 6)), Map::Line(axis(2, 7)), Map::Plane(axis(2, 3), axis(0, 4))];
    let mut encoder = Encoder::new(&maps, true);
    let mut inputs = [0.0; MAX_INPUTS];
    inputs[..3].copy_from_slice(&[0.3, -0.8, 0.1]);
    let mut features = encoder.features();
    encoder.encode(&inputs[..3], &mut features);
    let groups = MapFeatures::of(&maps, &encoder, &[0, 1, 2], 2, 0.01);
    let encoded = groups.each_ref().map(|group| encode(group, &inputs));
    let norm = encoded.iter().map(|encoded| encoded.squares).sum::<f32>().sqrt();
    for (group, encoded) in groups.iter().zip(&encoded) {
        for (&at, x) in group.positions.iter().zip(&encoded.features) {
            assert!((features.as_slice()[at] - x / norm).abs() < 1e-6);
        }
    }
}
