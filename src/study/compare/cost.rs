//! What one tick of a learner costs, by the clock.

use std::time::Instant;

use serde::{Deserialize, Serialize};

use crate::runtime::PipeError;
use crate::study::subject::Subject;
use crate::wire::{Command, Observation};

/// The cost of one tick, ns. That of a program of its own includes the way there and back.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct TickCost {
    /// From the observation to the command: learning, encoding, drawing.
    pub before: f64,
    /// After the command was sent.
    pub after: f64,
}

/// The cost of reading the clock, ns, which is not counted.
#[derive(Debug, Clone, Copy)]
pub(super) struct ClockCost(f64);

impl ClockCost {
    /// Measures it.
    pub fn measure() -> Self {
        const READS: u32 = 10_000;
        let began = Instant::now();
        for _ in 0..READS {
            std::hint::black_box(Instant::now());
        }
        Self(began.elapsed().as_nanos() as f64 / f64::from(READS))
    }

    /// One tick of `subject`, and what it cost.
    ///
    /// # Errors
    /// When the controller's program fails.
    pub fn timed(
        self,
        subject: &mut Subject,
        observation: &Observation,
        command: &mut Command,
    ) -> Result<TickCost, PipeError> {
        let began = Instant::now();
        subject.respond(observation, command)?;
        let answered = Instant::now();
        subject.after_command(observation)?;
        Ok(TickCost { before: self.between(began, answered), after: self.between(answered, Instant::now()) })
    }

    fn between(self, from: Instant, to: Instant) -> f64 {
        ((to - from).as_nanos() as f64 - self.0).max(0.0)
    }
}
