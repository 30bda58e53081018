//! The source of the arm's targets: drawn at random from the reachable region, or a list.

use rand::RngExt as _;

use super::square;
use crate::plant::ArmConfig;
use crate::seed::{Rng, stream};
use crate::state::{Persist, StateVisitor};

/// The source of targets.
#[derive(Debug, Clone)]
pub(super) enum Targets {
    /// Uniform in the part of the square `arena` that is within the arm's reach from the base.
    Drawn { rng: Rng, arena: [f32; 2], base: [f32; 2] },
    /// A list, which is repeated when it ends.
    Given(Vec<[f32; 2]>),
}

impl Targets {
    /// The targets of a validated configuration; drawn ones come from the run's stream `targets`.
    pub fn of(config: &ArmConfig, seed: u64) -> Self {
        let pair = |[a, b]: [f64; 2]| [a as f32, b as f32];
        if config.targets.is_empty() {
            Self::Drawn { rng: stream(seed, "targets"), arena: pair(config.arena), base: pair(config.base) }
        } else {
            Self::Given(config.targets.iter().copied().map(pair).collect())
        }
    }

    /// Target `number`, counted from 0 and taken in turn, for an arm of these lengths.
    pub fn take(&mut self, number: u64, lengths: &[f32]) -> [f32; 2] {
        match self {
            Self::Given(list) => list[(number % list.len() as u64) as usize],
            Self::Drawn { rng, arena, base } => {
                let [near, far] = reach(lengths);
                loop {
                    let mut draw = || arena[0] + (arena[1] - arena[0]) * rng.random::<f32>();
                    let target = [draw(), draw()];
                    let distance = square(target[0] - base[0]) + square(target[1] - base[1]);
                    if (square(near)..=square(far)).contains(&distance) {
                        return target;
                    }
                }
            }
        }
    }
}

impl Persist for Targets {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        if let Self::Drawn { rng, .. } = self {
            visitor.nested("rng", rng);
        }
    }
}

/// The least and the greatest distance of the end-effector from the base if all joints turn freely.
fn reach(lengths: &[f32]) -> [f32; 2] {
    let far: f32 = lengths.iter().sum();
    // The distance that remains when all other segments fold back on the longest one.
    let near = lengths.iter().map(|l| 2.0 * l - far).fold(0.0, f32::max);
    [near, far]
}
