//! A plant of your own instead of the simulator: a point on a line that has to follow a target.
//!
//! ```text
//! cargo build --release --bins --examples
//! target/release/tectum run examples/point.toml
//! ```
//!
//! A plant program is a type that implements `Plant`, and one call. The library provides channels, handshake, time,
//! hold policy and limits. Controller and logger are the same as with the simulator.

use std::process::ExitCode;

use rand::RngExt as _;
use tectum::plant::{Outcome, Plant};
use tectum::runtime::run_plant;
use tectum::seed::{Rng, stream};
use tectum::state::{Persist, StateVisitor};
use tectum::wire::{MAX_MEASURES, Role};

/// A point with a position and a target, both in [-1, 1] m.
struct Point {
    position: f32,
    target: f32,
    /// Targets shown so far.
    shown: u64,
    rng: Rng,
}

/// Ticks from one target to the next.
const TARGET_EVERY: u64 = 40;
/// How far a command of 1 moves the point in a tick, m.
const STRIDE: f32 = 0.1;

/// The state that the point needs to continue after its process was killed and restarted.
impl Persist for Point {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.number("position", &mut self.position);
        visitor.number("target", &mut self.target);
        visitor.number("shown", &mut self.shown);
        visitor.nested("rng", &mut self.rng);
    }
}

impl Plant for Point {
    fn sense(&mut self, tick: u64, inputs: &mut [f32]) -> bool {
        // Ticks may jump when the machine stalls; the sequence of targets stays the same.
        let due = tick / TARGET_EVERY + 1;
        let fresh = due > self.shown;
        while self.shown < due {
            self.target = self.rng.random_range(-1.0..1.0);
            self.shown += 1;
        }
        inputs[0] = self.position;
        inputs[1] = self.target;
        fresh
    }

    fn advance(&mut self, _tick: u64, applied: &[f32]) -> Outcome {
        self.position = (self.position + STRIDE * applied[0]).clamp(-1.0, 1.0);
        let error = (self.position - self.target).abs();
        let mut measures = [0.0; MAX_MEASURES];
        measures[0] = error;
        Outcome { reward: -error, measures }
    }
}

fn main() -> ExitCode {
    tectum::process::main(Role::Plant, "A point on a line that has to follow a target", |participant| {
        let rng = stream(participant.plan.scenario.seed, "targets");
        run_plant(participant, Point { position: 0.0, target: 0.0, shown: 0, rng })
    })
}
