//! Where the arm's targets come from: drawn from what it can reach, or a list.

use rand::RngExt as _;

use super::square;
use crate::plant::ArmConfig;
use crate::seed::{Rng, stream};
use crate::state::{Persist, StateVisitor};

/// Where targets come from.
#[derive(Debug, Clone)]
pub(super) enum Targets {
    /// Uniform in the square `arena`, as near to and far from the base as the arm reaches.
    Drawn { rng: Rng, arena: [f32; 2], base: [f32; 2] },
    /// A list, from the start again when it ends.
    Given(Vec<[f32; 2]>),
}

impl Targets {
    /// The targets of a validated table; drawn ones come from the run's stream `targets`.
    pub fn of(table: &ArmConfig, seed: u64) -> Self {
        let pair = |[a, b]: [f64; 2]| [a as f32, b as f32];
        if table.targets.is_empty() {
            Self::Drawn { rng: stream(seed, "targets"), arena: pair(table.arena), base: pair(table.base) }
        } else {
            Self::Given(table.targets.iter().copied().map(pair).collect())
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

/// How near to the base and how far from it the end comes if all joints turn freely.
fn reach(lengths: &[f32]) -> [f32; 2] {
    let far: f32 = lengths.iter().sum();
    // What the longest segment leaves when all others fold back on it.
    let near = lengths.iter().map(|l| 2.0 * l - far).fold(0.0, f32::max);
    [near, far]
}
