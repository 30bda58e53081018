//! Tests of the models.

use super::evidence::Evidence;
use super::features::{Basis, Features};
use super::layout::{Layout, Priors};
use super::regression::Regression;
use super::weighted::Weighted;
use crate::seed::{Rng, stream};
use rand_distr::{Distribution, StandardNormal};

fn normal(rng: &mut Rng) -> f64 {
    StandardNormal.sample(rng)
}

fn layout() -> Layout {
    let mut layout = Layout::new(5, [1.0, 0.5, 0.3, 1e-3]);
    let priors = Priors { linear: 0.3, square: 0.2, product: 0.7, smooth: 0.3 };
    layout.circle(0, 2.0, true, Some(0), priors);
    layout.circle(1, 2.5, true, Some(1), priors);
    layout.number(1, Some(1), priors);
    layout.number(2, Some(2), priors);
    layout.number(4, Some(3), priors);
    layout.number(3, None, priors);
    layout
}

#[test]
fn gradients_of_the_evidence_match_differences() {
    let layout = layout();
    let mut rng = stream(1, "test");
    let mut evidence = Evidence::new(&layout, 20, 2);
    for _ in 0..20 {
        let q: Vec<f64> = (0..5).map(|_| 0.6 * normal(&mut rng)).collect();
        evidence.push(&q, &[q[0] * q[1], q[2] + 0.1 * normal(&mut rng)]);
    }
    evidence.check_gradient(&layout);
}

#[test]
fn derivatives_of_a_model_match_differences() {
    let layout = layout();
    let mut rng = stream(2, "test");
    let features = Features::new(&layout, 6, 30, || normal(&mut rng));
    for outputs in [1, 3] {
        let mut model = Weighted::new(&layout, &features, outputs);
        let weights: Vec<f64> = (0..outputs * features.len).map(|_| normal(&mut rng)).collect();
        let mut posterior = Regression::new(features.len, outputs, 1e-3);
        posterior.weights.copy_from_slice(&weights);
        model.take(&layout, &features, &posterior, 0.5);
        let q = [0.3, -0.7, 0.9, -0.2, 0.5];
        let (mut y, mut jacobian) = (vec![0.0; outputs], vec![0.0; outputs * 5]);
        model.jacobian(&layout, &features, &q, &mut y, &mut jacobian);
        let mut phi = vec![0.0; features.len];
        features.evaluate(&layout, &q, &mut Basis::new(&layout, &features), &mut phi);
        for j in 0..outputs {
            let sum: f64 = phi.iter().zip(&weights[j * features.len..]).map(|(a, b)| a * b).sum();
            assert!((sum - y[j]).abs() < 1e-9, "{sum} {}", y[j]);
        }
        let step = 1e-5;
        for at in 0..5 {
            let mut sides = [-step, step].map(|step| {
                let mut q = q;
                q[at] += step;
                let (mut y, mut jacobian) = (vec![0.0; outputs], vec![0.0; outputs * 5]);
                model.jacobian(&layout, &features, &q, &mut y, &mut jacobian);
                (y, jacobian)
            });
            for j in 0..outputs {
                let slope = (sides[1].0[j] - sides[0].0[j]) / (2.0 * step);
                assert!((slope - jacobian[j * 5 + at]).abs() < 1e-6, "{at}: {slope} {}", jacobian[j * 5 + at]);
            }
            if outputs == 1 {
                let places = [4, 0, 1, 2];
                let (mut gradient, mut hessian) = ([0.0; 5], [0.0; 16]);
                model.hessian(&layout, &features, &q, &places, &mut gradient, &mut hessian);
                if let Some(r) = places.iter().position(|&p| p == at) {
                    for (c, &p) in places.iter().enumerate() {
                        let curve = (sides[1].1[p] - sides[0].1[p]) / (2.0 * step);
                        let h = hessian[r * 4 + c];
                        assert!((curve - h).abs() < 1e-5, "{at} {p}: {curve} {h}");
                    }
                }
            }
            sides[0].0[0] = 0.0;
        }
    }
}

#[test]
fn recursion_gives_what_the_normal_equations_give() {
    use super::linalg::{add_outer, add_scaled, cholesky, invert, packed, solve_lower, solve_lower_transposed};
    let (len, lambda) = (13, 1e-3);
    let mut rng = stream(3, "test");
    let mut regression = Regression::new(len, 1, lambda);
    let mut matrix = vec![0.0; packed(len)];
    for r in 0..len {
        matrix[packed(r) + r] = lambda;
    }
    let mut right = vec![0.0; len];
    let mut square = 0.0;
    for _ in 0..40 {
        let phi: Vec<f64> = (0..len).map(|_| normal(&mut rng)).collect();
        let y = normal(&mut rng);
        let mut predicted = [0.0];
        regression.predict(&phi, &mut predicted);
        regression.prepare(&phi);
        regression.update(&phi, &[y - predicted[0]], || 0.0);
        add_outer(&mut matrix, 1.0, &phi);
        add_scaled(&mut right, y, &phi);
        square += y * y;
    }
    assert!(cholesky(&mut matrix, len));
    let mut w = right.clone();
    solve_lower(&matrix, &mut w);
    solve_lower_transposed(&matrix, &mut w);
    let total = (square - w.iter().zip(&right).map(|(a, b)| a * b).sum::<f64>()) / lambda;
    invert(&mut matrix, len, &mut vec![0.0; len]);
    for k in 0..len {
        assert!((w[k] - regression.weights[k]).abs() < 1e-9);
    }
    for k in 0..packed(len) {
        assert!((lambda * matrix[k] - regression.covariance[k]).abs() < 1e-9);
    }
    // The sum of normalised squared errors is the quadratic form of the evidence.
    assert!((total / regression.squares[0] - 1.0).abs() < 1e-6, "{total} {}", regression.squares[0]);
}
