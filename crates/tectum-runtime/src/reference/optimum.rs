//! The trajectory optimum: the least cost of movements to the test's targets, found with the true arm and the
//! true reward.
//!
//! Each target is planned in turn, from the posture in which the last movement ended. The unknowns are the
//! angles of all ticks. Gauss-Newton steps with a ridge that grows where they fail (Levenberg-Marquardt) find
//! the nearest minimum. Many first guesses (random postures, with joints that turn either way) find the best
//! of the minima. The Hessian is block-tridiagonal, so that the cost of a step is linear in the number of
//! ticks. Each target is planned by itself: no movement costs more in order that the next one costs less.

use rand::RngExt as _;

use super::{FixedArm, Score};
use crate::scenario::ArmConfig;
use crate::seed::stream;

/// Number of first guesses per target. Ten times as many give the same result to four digits.
pub const STARTS: usize = 20;

const TURN: f64 = std::f64::consts::TAU;
/// Largest number of steps in a descent.
const STEPS: usize = 100;
/// A descent ends with a step that lowers the cost by less than this.
const GAIN: f64 = 1e-7;
/// Ticks after which a first guess has covered two thirds of the way.
const GUESS_TICKS: f64 = 3.0;

/// A movement of N joints: their angles at the end of each tick, rad, not wrapped.
type Trajectory<const N: usize> = Vec<[f64; N]>;
type MatrixBlock<const N: usize> = [[f64; N]; N];

/// Mean loss per tick and mean miss of the best movements to `targets` in sequence, `ticks` each, from all
/// angles 0. Calls `go_on` before each first guess; the result is `None` once that returns false.
pub(super) fn trajectory_optimum(
    arm: &FixedArm,
    targets: &[[f64; 2]],
    ticks: usize,
    starts: usize,
    go_on: impl Fn() -> bool,
) -> Option<Score> {
    let movements = best_movements(arm, targets, ticks, starts, go_on)?;
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

/// The best movements that [`trajectory_optimum`] scores, in the order of the targets.
pub(super) fn best_movements(
    arm: &FixedArm,
    targets: &[[f64; 2]],
    ticks: usize,
    starts: usize,
    go_on: impl Fn() -> bool,
) -> Option<Vec<BestMovement>> {
    // The compiler has to know the number of joints: most of the time goes into matrices of that size.
    macro_rules! by_joints {
        ($($n:literal)*) => {
            match arm.free().len() {
                $($n => Planner::<$n>::new(arm).best_movements(targets, ticks, starts, go_on),)*
                // No scenario has more joints.
                _ => None,
            }
        };
    }
    by_joints!(0 1 2 3 4 5 6 7 8)
}

/// The arm as the optimiser uses it: N joints that move, and the constant part of the joints that stand
/// still.
struct Planner<'a, const N: usize> {
    config: &'a ArmConfig,
    lengths: [f64; N],
    /// The end-effector's position without the segments that move, m.
    base: [f64; 2],
    /// Cost per tick of the angles of joints that stand still.
    fixed_cost: f64,
    /// Cost of a squared change of an angle within one tick, 1/rad^2.
    effort: f64,
}

/// The angle between -pi and pi, rad.
fn wrapped(x: f64) -> f64 {
    x - TURN * libm::round(x / TURN)
}

impl<'a, const N: usize> Planner<'a, N> {
    fn new(arm: &'a FixedArm) -> Self {
        let (config, free) = (arm.config(), arm.free());
        let (mut base, mut squares) = (config.base, 0.0);
        for (length, fixed) in config.lengths.iter().zip(arm.fixed()) {
            if let Some(angle) = fixed {
                let (sin, cos) = libm::sincos(*angle);
                base = [base[0] + length * cos, base[1] + length * sin];
                squares += angle * angle;
            }
        }
        let reward = &config.reward;
        Self {
            config,
            lengths: std::array::from_fn(|i| config.lengths[free[i]]),
            base,
            fixed_cost: reward.scale * reward.angle * squares,
            effort: reward.scale * reward.speed / (arm.period_s() * arm.period_s()),
        }
    }

    /// The vector from the target to the end-effector, m, and its derivative by each angle, m/rad.
    fn error(&self, at: &[f64; N], target: [f64; 2]) -> ([f64; 2], [[f64; 2]; N]) {
        let mut error = [self.base[0] - target[0], self.base[1] - target[1]];
        let rows = std::array::from_fn(|i| {
            let (sin, cos) = libm::sincos(at[i]);
            error = [error[0] + self.lengths[i] * cos, error[1] + self.lengths[i] * sin];
            [-self.lengths[i] * sin, self.lengths[i] * cos]
        });
        (error, rows)
    }

    /// The cost of a posture in one tick.
    fn posture(&self, at: &[f64; N], target: [f64; 2]) -> f64 {
        let ([x, y], _) = self.error(at, target);
        let squares: f64 = at.iter().map(|a| wrapped(*a) * wrapped(*a)).sum();
        self.fixed_cost + self.config.reward.scale * (x * x + y * y + self.config.reward.angle * squares)
    }

    /// The gradient of a posture's cost and its Gauss-Newton Hessian, which is positive definite.
    fn derivatives(&self, at: &[f64; N], target: [f64; 2]) -> ([f64; N], MatrixBlock<N>) {
        let (error, rows) = self.error(at, target);
        let (scale, angle) = (2.0 * self.config.reward.scale, self.config.reward.angle);
        let product = |a: [f64; 2], b: [f64; 2]| a[0] * b[0] + a[1] * b[1];
        let gradient = std::array::from_fn(|i| scale * (product(rows[i], error) + angle * wrapped(at[i])));
        let hessian = std::array::from_fn(|i| {
            std::array::from_fn(|j| scale * (product(rows[i], rows[j]) + if i == j { angle } else { 0.0 }))
        });
        (gradient, hessian)
    }

    /// The cost of a movement that starts at `from`.
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

    /// Descends from `path` to the nearest minimum and gives its cost.
    fn descend(&self, from: &[f64; N], path: &mut Trajectory<N>, target: [f64; 2]) -> f64 {
        let mut cost = self.cost(from, path, target);
        let mut ridge = 1e-3;
        let mut system = NewtonSystem { sides: vec![[0.0; N]; path.len()], inverses: vec![[[0.0; N]; N]; path.len()] };
        let mut trial = path.clone();
        for _ in 0..STEPS {
            self.eliminate(&mut system, from, path, target, ridge);
            self.substitute(&system, path, &mut trial);
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

    /// Builds the equations of a Gauss-Newton step and eliminates their unknowns from the first tick to the
    /// last. Off the diagonal, the blocks of the Hessian are `-e I` with `e` twice the effort.
    fn eliminate(
        &self,
        system: &mut NewtonSystem<N>,
        from: &[f64; N],
        path: &Trajectory<N>,
        target: [f64; 2],
        ridge: f64,
    ) {
        let e = 2.0 * self.effort;
        for k in 0..path.len() {
            let (mut side, mut block) = self.derivatives(&path[k], target);
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
                let (inverse, last): (&MatrixBlock<N>, &[f64; N]) = (&system.inverses[k - 1], &system.sides[k - 1]);
                for i in 0..N {
                    for j in 0..N {
                        block[i][j] -= e * e * inverse[i][j];
                        side[i] += e * inverse[i][j] * last[j];
                    }
                }
            }
            (system.inverses[k], system.sides[k]) = (inverse(block), side);
        }
    }

    /// Solves the eliminated equations from the last tick to the first, and writes `path` after the step into
    /// `trial`.
    fn substitute(&self, system: &NewtonSystem<N>, path: &Trajectory<N>, trial: &mut Trajectory<N>) {
        let e = 2.0 * self.effort;
        let NewtonSystem { sides, inverses } = system;
        let mut step = [0.0; N];
        for k in (0..path.len()).rev() {
            let side: [f64; N] = std::array::from_fn(|i| sides[k][i] + e * step[i]);
            step = std::array::from_fn(|i| (0..N).map(|j| inverses[k][i][j] * side[j]).sum());
            trial[k] = std::array::from_fn(|i| path[k][i] - step[i]);
        }
    }

    /// The best movements to all `targets` in sequence; see [`trajectory_optimum`].
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
                // The first of the guesses is to stay. Half a turn either way leads to any posture.
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

/// The equations of a Gauss-Newton step after elimination: for each tick the right-hand side, and the inverse
/// of the block on the diagonal.
struct NewtonSystem<const N: usize> {
    sides: Vec<[f64; N]>,
    inverses: Vec<MatrixBlock<N>>,
}

/// The inverse of a positive definite matrix, by Gauss-Jordan elimination.
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
