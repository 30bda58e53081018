//! The floor: what the best movements cost, found with the true model of the arm.
//!
//! For each target in turn, from where the last movement ended: the angles of all ticks are the unknowns, Newton's method
//! with a growing ridge finds the nearest minimum, and many starts (postures drawn at random, turns either way) find the
//! best of them. The Hessian is block-tridiagonal, so a step costs as much as there are ticks.

use rand::RngExt as _;
use tectum::{scenario::ArmTable, seed::stream};

const STARTS: usize = 60;
const TURN: f64 = std::f64::consts::TAU;

/// The arm as the optimiser knows it; joints that are blocked stand at 0.
pub struct Arm<'a> {
    pub table: &'a ArmTable,
    pub period: f64,
    pub free: Vec<usize>,
}

type Vector = Vec<f64>;

impl Arm<'_> {
    fn wrapped(x: f64) -> f64 {
        x - TURN * (x / TURN).round()
    }

    /// What a posture costs in a tick, with gradient and Gauss-Newton Hessian (positive definite).
    fn posture(&self, free: &[f64], target: [f64; 2], g: &mut Vector, h: &mut Vector) -> f64 {
        let (n, reward) = (free.len(), &self.table.reward);
        let mut error = [self.table.base[0] - target[0], self.table.base[1] - target[1]];
        let mut rows = vec![[0.0; 2]; n];
        for (joint, length) in self.table.lengths.iter().enumerate() {
            let place = self.free.iter().position(|&f| f == joint);
            let (sin, cos) = place.map_or(0.0, |p| free[p]).sin_cos();
            error = [error[0] + length * cos, error[1] + length * sin];
            if let Some(p) = place {
                rows[p] = [-length * sin, length * cos];
            }
        }
        let mut cost = error[0] * error[0] + error[1] * error[1];
        for i in 0..n {
            let angle = Self::wrapped(free[i]);
            cost += reward.angle * angle * angle;
            g[i] = 2.0 * reward.scale * (rows[i][0] * error[0] + rows[i][1] * error[1] + reward.angle * angle);
            for j in 0..n {
                let ridge = if i == j { reward.angle } else { 0.0 };
                h[i * n + j] = 2.0 * reward.scale * (rows[i][0] * rows[j][0] + rows[i][1] * rows[j][1] + ridge);
            }
        }
        reward.scale * cost
    }

    fn cost(&self, from: &[f64], path: &[Vector], target: [f64; 2]) -> f64 {
        let n = from.len();
        let (mut g, mut h) = (vec![0.0; n], vec![0.0; n * n]);
        let mut last = from;
        let mut sum = 0.0;
        for at in path {
            sum += self.posture(at, target, &mut g, &mut h);
            sum += self.effort() * at.iter().zip(last).map(|(a, b)| (a - b) * (a - b)).sum::<f64>();
            last = at;
        }
        sum
    }

    /// What a squared change of an angle in a tick costs.
    fn effort(&self) -> f64 {
        self.table.reward.scale * self.table.reward.speed / (self.period * self.period)
    }

    /// Descends from `path` to the nearest minimum.
    fn descend(&self, from: &[f64], path: &mut Vec<Vector>, target: [f64; 2]) -> f64 {
        let n = from.len();
        let e = 2.0 * self.effort();
        let mut cost = self.cost(from, path, target);
        let mut ridge = 1e-3;
        for _ in 0..100 {
            let ticks = path.len();
            let mut gradients = vec![vec![0.0; n]; ticks];
            let mut blocks = vec![vec![0.0; n * n]; ticks];
            for k in 0..ticks {
                self.posture(&path[k], target, &mut gradients[k], &mut blocks[k]);
                for i in 0..n {
                    let before = if k == 0 { from[i] } else { path[k - 1][i] };
                    gradients[k][i] += e * (path[k][i] - before);
                    blocks[k][i * n + i] += e + ridge;
                    if k + 1 < ticks {
                        gradients[k][i] += e * (path[k][i] - path[k + 1][i]);
                        blocks[k][i * n + i] += e;
                    }
                }
            }
            let step = tridiagonal(&blocks, &gradients, e);
            let mut trial = path.clone();
            for (at, step) in trial.iter_mut().zip(&step) {
                for (a, s) in at.iter_mut().zip(step) {
                    *a -= s;
                }
            }
            let new = self.cost(from, &trial, target);
            if new < cost {
                let gain = cost - new;
                (*path, cost) = (trial, new);
                ridge = (ridge / 4.0).max(1e-9);
                if gain < 1e-9 {
                    break;
                }
            } else {
                ridge *= 8.0;
                if ridge > 1e6 {
                    break;
                }
            }
        }
        cost
    }

    /// Mean cost a tick and mean miss at the end, over `targets` in sequence for `ticks` each, from all angles 0.
    pub fn optimum(&self, targets: &[[f64; 2]], ticks: usize) -> (f64, f64) {
        let n = self.free.len();
        let mut rng = stream(0, "optimum");
        let mut from = vec![0.0; n];
        let (mut sum, mut miss) = (0.0, 0.0);
        for &target in targets {
            let mut best: Option<(f64, Vec<Vector>)> = None;
            for start in 0..STARTS {
                let goal: Vector =
                    from.iter().map(|f| if start == 0 { *f } else { f + TURN * (rng.random::<f64>() - 0.5) }).collect();
                let mut path: Vec<Vector> = (1..=ticks)
                    .map(|k| {
                        let done = 1.0 - (-(k as f64) / 3.0).exp();
                        from.iter().zip(&goal).map(|(f, g)| f + (g - f) * done).collect()
                    })
                    .collect();
                let cost = self.descend(&from, &mut path, target);
                if best.as_ref().is_none_or(|(b, _)| cost < *b) {
                    best = Some((cost, path));
                }
            }
            let (cost, path) = best.unwrap_or_default();
            sum += cost;
            from = path[ticks - 1].iter().map(|&a| Self::wrapped(a)).collect();
            let mut end = self.table.base;
            for (joint, length) in self.table.lengths.iter().enumerate() {
                let angle = self.free.iter().position(|&f| f == joint).map_or(0.0, |p| from[p]);
                end = [end[0] + length * angle.cos(), end[1] + length * angle.sin()];
            }
            if std::env::var("PER").is_ok() {
                println!("    opt {:.4} {target:.2?} {from:.2?}", cost / 80.0);
            }
            miss += (end[0] - target[0]).hypot(end[1] - target[1]);
        }
        (sum / (targets.len() * ticks) as f64, miss / targets.len() as f64)
    }
}

/// Solves a block-tridiagonal system whose off-diagonal blocks are `-e I`.
fn tridiagonal(blocks: &[Vector], right: &[Vector], e: f64) -> Vec<Vector> {
    let n = right[0].len();
    let mut carried: Vec<Vector> = Vec::new();
    let mut sides: Vec<Vector> = Vec::new();
    for (k, (block, right)) in blocks.iter().zip(right).enumerate() {
        let (mut block, mut right) = (block.clone(), right.clone());
        if k > 0 {
            let (last, side) = (&carried[k - 1], &sides[k - 1]);
            for i in 0..n * n {
                block[i] -= e * e * last[i];
            }
            for i in 0..n {
                right[i] += e * (0..n).map(|j| last[i * n + j] * side[j]).sum::<f64>();
            }
        }
        carried.push(inverse(&block, n));
        sides.push(right);
    }
    let mut out = vec![vec![0.0; n]; blocks.len()];
    for k in (0..blocks.len()).rev() {
        let mut side = sides[k].clone();
        if k + 1 < blocks.len() {
            for i in 0..n {
                side[i] += e * out[k + 1][i];
            }
        }
        for i in 0..n {
            out[k][i] = (0..n).map(|j| carried[k][i * n + j] * side[j]).sum();
        }
    }
    out
}

fn inverse(a: &[f64], n: usize) -> Vector {
    let mut a = a.to_vec();
    let mut b = vec![0.0; n * n];
    for i in 0..n {
        b[i * n + i] = 1.0;
    }
    for i in 0..n {
        let pivot = a[i * n + i];
        for j in 0..n {
            a[i * n + j] /= pivot;
            b[i * n + j] /= pivot;
        }
        for k in (0..n).filter(|&k| k != i) {
            let f = a[k * n + i];
            for j in 0..n {
                a[k * n + j] -= f * a[i * n + j];
                b[k * n + j] -= f * b[i * n + j];
            }
        }
    }
    b
}
