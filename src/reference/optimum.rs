//! The trajectory optimum: what the best movements cost, found with the true arm and the true reward.
//!
//! For each target in turn, from where the last movement ended: the angles of all ticks are the unknowns, Gauss-Newton
//! steps with a ridge that grows where they fail (Levenberg-Marquardt) find the nearest minimum, and many first guesses
//! (postures drawn at random, joints turning either way) find the best of them. The Hessian is block-tridiagonal, so that a step
//! costs as much as there are ticks. Each target is planned by itself: no movement costs more so that the next may cost
//! less.

use rand::RngExt as _;

use super::{FixedArm, Score};
use crate::scenario::ArmConfig;
use crate::seed::stream;

/// First guesses for a target that make the result the same to four digits as ten times as many do.
pub const STARTS: usize = 20;

const TURN: f64 = std::f64::consts::TAU;
/// Most steps of a descent.
const STEPS: usize = 100;
/// A step that gains less ends it.
const GAIN: f64 = 1e-7;
/// Ticks in which a first guess is two thirds of the way there.
const GUESS_TICKS: f64 = 3.0;

/// A movement of N joints: their angles at the end of each tick, rad, without wrapping.
type Trajectory<const N: usize> = Vec<[f64; N]>;
type MatrixBlock<const N: usize> = [[f64; N]; N];

/// Mean loss a tick and mean miss of the best movements to `targets` in sequence, `ticks` each, from all angles 0. `go_on`
/// is asked before each first guess; `None` when it says false.
pub fn trajectory_optimum(
    world: &FixedArm,
    targets: &[[f64; 2]],
    ticks: usize,
    starts: usize,
    go_on: impl Fn() -> bool,
) -> Option<Score> {
    let movements = best_movements(world, targets, ticks, starts, go_on)?;
    let sum = |value: fn(&BestMovement) -> f64| movements.iter().map(value).sum::<f64>();
    let count = targets.len();
    Some(Score { loss: sum(|m| m.cost) / (count * ticks) as f64, miss_m: sum(|m| m.miss_m) / count as f64 })
}

/// The best movement to one target.
pub(super) struct BestMovement {
    /// Sum of the losses of its ticks.
    pub cost: f64,
    /// Distance from the target at its end, m.
    pub miss_m: f64,
}

/// The best movements themselves, as [`trajectory_optimum`] finds them, in the order of the targets.
pub(super) fn best_movements(
    world: &FixedArm,
    targets: &[[f64; 2]],
    ticks: usize,
    starts: usize,
    go_on: impl Fn() -> bool,
) -> Option<Vec<BestMovement>> {
    // The number of joints is known to the compiler: most of the time goes into matrices of that size.
    macro_rules! by_joints {
        ($($n:literal)*) => {
            match world.free().len() {
                $($n => Planner::<$n>::new(world).best_movements(targets, ticks, starts, go_on),)*
                // No scenario has more.
                _ => None,
            }
        };
    }
    by_joints!(0 1 2 3 4 5 6 7 8)
}

/// The arm as the optimiser knows it: N joints that move, and what the others add.
struct Planner<'a, const N: usize> {
    table: &'a ArmConfig,
    lengths: [f64; N],
    /// Where the end-effector would be without the segments that move, m.
    base: [f64; 2],
    /// What the angles of joints that stand still cost a tick.
    standing: f64,
    /// What a squared change of an angle in a tick costs.
    effort: f64,
}

fn wrapped(x: f64) -> f64 {
    x - TURN * libm::round(x / TURN)
}

impl<'a, const N: usize> Planner<'a, N> {
    fn new(world: &'a FixedArm) -> Self {
        let (table, free) = (world.table(), world.free());
        let (mut base, mut squares) = (table.base, 0.0);
        for (length, fixed) in table.lengths.iter().zip(world.fixed()) {
            if let Some(angle) = fixed {
                let (sin, cos) = libm::sincos(*angle);
                base = [base[0] + length * cos, base[1] + length * sin];
                squares += angle * angle;
            }
        }
        let reward = &table.reward;
        Self {
            table,
            lengths: std::array::from_fn(|i| table.lengths[free[i]]),
            base,
            standing: reward.scale * reward.angle * squares,
            effort: reward.scale * reward.speed / (world.period_s() * world.period_s()),
        }
    }

    /// From the target to the end-effector, m, and how it moves with each angle.
    fn error(&self, at: &[f64; N], target: [f64; 2]) -> ([f64; 2], [[f64; 2]; N]) {
        let mut error = [self.base[0] - target[0], self.base[1] - target[1]];
        let rows = std::array::from_fn(|i| {
            let (sin, cos) = libm::sincos(at[i]);
            error = [error[0] + self.lengths[i] * cos, error[1] + self.lengths[i] * sin];
            [-self.lengths[i] * sin, self.lengths[i] * cos]
        });
        (error, rows)
    }

    /// What a posture costs in a tick.
    fn posture(&self, at: &[f64; N], target: [f64; 2]) -> f64 {
        let ([x, y], _) = self.error(at, target);
        let squares: f64 = at.iter().map(|a| wrapped(*a) * wrapped(*a)).sum();
        self.standing + self.table.reward.scale * (x * x + y * y + self.table.reward.angle * squares)
    }

    /// The gradient of that and its Gauss-Newton Hessian, which is positive definite.
    fn slope(&self, at: &[f64; N], target: [f64; 2]) -> ([f64; N], MatrixBlock<N>) {
        let (error, rows) = self.error(at, target);
        let (scale, angle) = (2.0 * self.table.reward.scale, self.table.reward.angle);
        let product = |a: [f64; 2], b: [f64; 2]| a[0] * b[0] + a[1] * b[1];
        let gradient = std::array::from_fn(|i| scale * (product(rows[i], error) + angle * wrapped(at[i])));
        let hessian = std::array::from_fn(|i| {
            std::array::from_fn(|j| scale * (product(rows[i], rows[j]) + if i == j { angle } else { 0.0 }))
        });
        (gradient, hessian)
    }

    fn cost(&self, from: &[f64; N], path: &Trajectory<N>, target: [f64; 2]) -> f64 {
        let mut last = from;
        let mut sum = 0.0;
        for at in path {
            sum += self.posture(at, target);
            sum += self.effort * at.iter().zip(last).map(|(a, b)| (a - b) * (a - b)).sum::<f64>();
            last = at;
        }
        sum
    }

    /// Descends from `path` to the nearest minimum; gives its cost.
    fn descend(&self, from: &[f64; N], path: &mut Trajectory<N>, target: [f64; 2]) -> f64 {
        let (ticks, e) = (path.len(), 2.0 * self.effort);
        let mut cost = self.cost(from, path, target);
        let mut ridge = 1e-3;
        let mut sides = vec![[0.0; N]; ticks];
        let mut inverses = vec![[[0.0; N]; N]; ticks];
        let mut trial = path.clone();
        for _ in 0..STEPS {
            // Elimination from the first tick to the last; off the diagonal the blocks are -e I.
            for k in 0..ticks {
                let (mut side, mut block) = self.slope(&path[k], target);
                let before = if k == 0 { from } else { &path[k - 1] };
                let after = path.get(k + 1);
                for i in 0..N {
                    side[i] += e * (path[k][i] - before[i]);
                    block[i][i] += e + ridge;
                    if let Some(after) = after {
                        side[i] += e * (path[k][i] - after[i]);
                        block[i][i] += e;
                    }
                }
                if k > 0 {
                    let (inverse, last): (&MatrixBlock<N>, &[f64; N]) = (&inverses[k - 1], &sides[k - 1]);
                    for i in 0..N {
                        for j in 0..N {
                            block[i][j] -= e * e * inverse[i][j];
                            side[i] += e * inverse[i][j] * last[j];
                        }
                    }
                }
                (inverses[k], sides[k]) = (inverse(block), side);
            }
            // And back.
            let mut step = [0.0; N];
            for k in (0..ticks).rev() {
                let side: [f64; N] = std::array::from_fn(|i| sides[k][i] + e * step[i]);
                step = std::array::from_fn(|i| (0..N).map(|j| inverses[k][i][j] * side[j]).sum());
                trial[k] = std::array::from_fn(|i| path[k][i] - step[i]);
            }
            let new = self.cost(from, &trial, target);
            if new < cost {
                let gain = cost - new;
                std::mem::swap(path, &mut trial);
                cost = new;
                ridge = (ridge / 4.0).max(1e-9);
                if gain < GAIN {
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

    fn best_movements(
        &self,
        targets: &[[f64; 2]],
        ticks: usize,
        starts: usize,
        go_on: impl Fn() -> bool,
    ) -> Option<Vec<BestMovement>> {
        let mut rng = stream(0, "optimum");
        let mut from = [0.0; N];
        let mut movements = Vec::with_capacity(targets.len());
        for &target in targets {
            let mut best: Option<(f64, [f64; N])> = None;
            for start in 0..starts.max(1) {
                if !go_on() {
                    return None;
                }
                // The first guess of all is to stay; half a turn either way leads to any posture.
                let goal = from.map(|f| if start == 0 { f } else { f + TURN * (rng.random::<f64>() - 0.5) });
                let mut path: Trajectory<N> = (1..=ticks)
                    .map(|k| {
                        let done = 1.0 - libm::exp(-(k as f64) / GUESS_TICKS);
                        std::array::from_fn(|i| from[i] + (goal[i] - from[i]) * done)
                    })
                    .collect();
                let cost = self.descend(&from, &mut path, target);
                if best.is_none_or(|(least, _)| cost < least) {
                    best = path.last().map(|end| (cost, *end));
                }
            }
            let (cost, end) = best?;
            from = end.map(wrapped);
            let ([x, y], _) = self.error(&from, target);
            movements.push(BestMovement { cost, miss_m: libm::hypot(x, y) });
        }
        Some(movements)
    }
}

/// The inverse of a positive definite matrix, by Gauss and Jordan.
fn inverse<const N: usize>(mut a: MatrixBlock<N>) -> MatrixBlock<N> {
    let mut b: MatrixBlock<N> = std::array::from_fn(|i| std::array::from_fn(|j| if i == j { 1.0 } else { 0.0 }));
    for i in 0..N {
        let pivot = 1.0 / a[i][i];
        for j in 0..N {
            a[i][j] *= pivot;
            b[i][j] *= pivot;
        }
        for k in (0..N).filter(|&k| k != i) {
            let factor = a[k][i];
            for j in 0..N {
                a[k][j] -= factor * a[i][j];
                b[k][j] -= factor * b[i][j];
            }
        }
    }
    b
}
