//! Tests of the models.

use super::evidence::Evidence;
use super::features::{BasisValues, ModelFeatures};
use super::layout::{Layout, Priors, Terms};
use super::regression::Regression;
use super::weighted::{ProductCurves, Weighted};
use crate::seed::{Rng, stream};
use rand_distr::{Distribution, StandardNormal};

fn normal(rng: &mut Rng) -> f64 {
    StandardNormal.sample(rng)
}

fn layout() -> Layout {
    let mut layout = Layout::new(5, [1.0, 0.9, 0.4, 0.5, 0.3, 1e-3]);
    let priors = Priors { linear: 0.3, square: 0.2, product: 0.7, smooth: 0.3 };
    layout.circle(0, 2.0, true, Some(0), priors);
    layout.circle(1, 2.5, true, Some(1), priors);
    layout.angle_sum(Terms::sum(&[(0, 2.0), (1, -1.5), (4, 0.7)]), Some(0), priors);
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
        evidence.push(&q, &[q[0] * q[1], q[2] + 0.1 * normal(&mut rng)], 1.0 + q[3] * q[3]);
    }
    evidence.check_gradient(&layout);
}

#[test]
fn derivatives_of_a_model_match_differences() {
    let layout = layout();
    let mut rng = stream(2, "test");
    let features = ModelFeatures::new(&layout, 6, 30, || normal(&mut rng));
    for outputs in [1, 3] {
        let mut model = Weighted::new(&layout, &features, outputs);
        let weights: Vec<f64> = (0..outputs * features.len).map(|_| normal(&mut rng)).collect();
        let mut posterior = Regression::new(features.len, outputs, 1, 1e-3);
        posterior.weights.copy_from_slice(&weights);
        model.take(&layout, &features, &posterior, 0.5);
        let q = [0.3, -0.7, 0.9, -0.2, 0.5];
        let (mut y, mut jacobian) = (vec![0.0; outputs], vec![0.0; outputs * 5]);
        model.jacobian(&layout, &features, &q, &mut y, &mut jacobian);
        let mut phi = vec![0.0; features.len];
        features.evaluate(&layout, &q, &mut BasisValues::new(&layout, &features), &mut phi);
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
                let mut curves = ProductCurves::new(features.most_nodes, layout.components, places.len());
                model.hessian((&layout, &features), &q, (&places, &mut curves), &mut gradient, &mut hessian);
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
    let mut regression = Regression::new(len, 1, 1, lambda);
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

/// The kernel as the documentation of the layout states it.
fn kernel(layout: &Layout, scales: &[f64], a: &[f64], b: &[f64]) -> f64 {
    use super::layout::{BIAS, PAIRS, PRODUCTS, SMOOTH, ScaleKind, TRIPLES};
    let at = |u: usize, s: ScaleKind| {
        if layout.units[u].scales[s as usize] { scales[Layout::scale(u, s)].exp() } else { 0.0 }
    };
    // That of a sum is in its terms.
    let frequency = |u: usize| if layout.units[u].terms.each().len() > 1 { 1.0 } else { at(u, ScaleKind::Frequency) };
    let inner = |u: usize| {
        let unit = &layout.units[u];
        if unit.circle {
            (frequency(u) * (unit.terms.value(a) - unit.terms.value(b))).cos()
        } else {
            a[unit.at] * b[unit.at]
        }
    };
    let of = |scale: usize| scales[scale].exp();
    let mut k = of(BIAS);
    let mut apart = 0.0_f64;
    for (u, unit) in layout.units.iter().enumerate() {
        k += at(u, ScaleKind::Linear) * inner(u) + at(u, ScaleKind::Square) * inner(u).powi(2);
        let square = if unit.circle { 2.0 - 2.0 * inner(u) } else { (a[unit.at] - b[unit.at]).powi(2) };
        apart += at(u, ScaleKind::Smooth) * square;
    }
    let of_group = |units: &Vec<usize>| units.iter().map(|&u| at(u, ScaleKind::Product) * inner(u)).sum::<f64>();
    let z: Vec<f64> = layout.groups.iter().map(of_group).collect();
    // Sums of the products of so many, from their definition.
    let mut e = [0.0; 5];
    for chosen in 0_u32..1 << z.len() {
        let product: f64 = z.iter().enumerate().filter(|(g, _)| chosen >> g & 1 == 1).map(|(_, z)| z).product();
        e[chosen.count_ones().min(4) as usize] += product;
    }
    k + of(PAIRS) * e[2] + of(TRIPLES) * e[3] + of(PRODUCTS) * e[4] + of(SMOOTH) * (-0.5 * apart).exp()
}

/// `log |A|` and `yᵀ A⁻¹ y`, by Gaussian elimination.
fn dense(mut a: Vec<Vec<f64>>, mut y: Vec<f64>) -> (f64, f64) {
    let (n, right) = (y.len(), y.clone());
    let mut log_determinant = 0.0;
    for k in 0..n {
        log_determinant += a[k][k].ln();
        for r in k + 1..n {
            let factor = a[r][k] / a[k][k];
            for c in k..n {
                a[r][c] -= factor * a[k][c];
            }
            y[r] -= factor * y[k];
        }
    }
    for k in (0..n).rev() {
        y[k] = (y[k] - (k + 1..n).map(|c| a[k][c] * y[c]).sum::<f64>()) / a[k][k];
    }
    (log_determinant, right.iter().zip(&y).map(|(a, b)| a * b).sum())
}

#[test]
fn the_evidence_is_that_of_a_dense_computation() {
    let layout = layout();
    let mut rng = stream(5, "test");
    let (n, floor) = (12, 1e-7);
    let mut evidence = Evidence::new(&layout, n, 2);
    let (mut points, mut targets) = (Vec::new(), [Vec::new(), Vec::new()]);
    for _ in 0..n {
        let q: Vec<f64> = (0..5).map(|_| 0.6 * normal(&mut rng)).collect();
        let y = [q[0] * q[1] + 0.2, q[2] + 0.1 * normal(&mut rng)];
        evidence.push(&q, &y, 1.0);
        targets[0].push(y[0]);
        targets[1].push(y[1]);
        points.push(q);
    }
    let scales = layout.prior.clone();
    let mut matrix: Vec<Vec<f64>> =
        points.iter().map(|a| points.iter().map(|b| kernel(&layout, &scales, a, b)).collect()).collect();
    let amplitude = (0..n).map(|i| matrix[i][i]).sum::<f64>() / n as f64;
    for (i, row) in matrix.iter_mut().enumerate() {
        row[i] += (floor + scales[super::layout::NOISE].exp()) * amplitude;
    }
    let expected: f64 = targets
        .iter()
        .map(|y| {
            let (log_determinant, square) = dense(matrix.clone(), y.clone());
            -0.5 * (log_determinant + n as f64 * (square / n as f64).ln())
        })
        .sum();
    // At the prior's mean the prior of the scales adds nothing.
    let found = evidence.step(&layout, 2.5, 0.0, floor).unwrap();
    assert!((found - expected).abs() < 1e-6 * expected.abs(), "{found} {expected}");
}

#[test]
fn features_give_the_kernel_where_there_is_no_smooth_part() {
    let mut layout = layout();
    layout.prior[super::layout::SMOOTH] = -60.0;
    let mut rng = stream(6, "test");
    let features = ModelFeatures::new(&layout, 4, 200, || normal(&mut rng));
    let mut basis = BasisValues::new(&layout, &features);
    let (mut a, mut b) = (vec![0.0; features.len], vec![0.0; features.len]);
    for _ in 0..20 {
        let q: Vec<f64> = (0..5).map(|_| 0.6 * normal(&mut rng)).collect();
        let r: Vec<f64> = (0..5).map(|_| 0.6 * normal(&mut rng)).collect();
        features.evaluate(&layout, &q, &mut basis, &mut a);
        features.evaluate(&layout, &r, &mut basis, &mut b);
        let found: f64 = a.iter().zip(&b).map(|(a, b)| a * b).sum();
        let expected = kernel(&layout, &layout.prior, &q, &r);
        assert!((found - expected).abs() < 1e-9, "{found} {expected}");
    }
}
