//! Collects the movements of a log, message by message: as recorded, and without exploration noise.

use super::cutter::{MovementCut, MovementCutter};
use super::groups::MovementRow;
use super::log_follower::LogFollower;
use super::movement::{Definitions, Measures, measure};
use super::{AnalyseError, LeftOut};
use crate::log::LogRecord;
use crate::scenario::Plan;
use crate::wire::{Command, Observation};

/// The movements of a log as far as it was read.
pub(super) struct MovementCollector {
    pub definitions: Definitions,
    /// Period of a tick, s.
    pub period_s: f64,
    pub rows: Vec<MovementRow>,
    /// Number of the first tick that was not read.
    pub ticks: u64,
    cutter: MovementCutter,
    /// Whether noiseless movements are wanted.
    noiseless: bool,
    follower: Option<LogFollower>,
    /// The tick and the measures of the current noiseless movement.
    current_noiseless: Option<(u64, Measures)>,
}

impl MovementCollector {
    /// A collector at the beginning of a log of `plan`.
    ///
    /// # Errors
    /// [`AnalyseError::NoMeasures`] if the plant does not measure error and end-effector.
    pub fn new(plan: &Plan, noiseless: bool) -> Result<Self, AnalyseError> {
        Ok(Self {
            definitions: Definitions::default(),
            period_s: plan.period_ns as f64 / 1e9,
            rows: Vec::new(),
            ticks: 0,
            cutter: MovementCutter::new(plan)?,
            noiseless,
            follower: if noiseless { LogFollower::new(plan) } else { None },
            current_noiseless: None,
        })
    }

    /// Takes the log's next message.
    pub fn take(&mut self, record: &LogRecord) {
        match record {
            LogRecord::Observation(observation) => self.observe(observation),
            LogRecord::Command(command) => self.command(command),
            LogRecord::Learning(_) | LogRecord::Gap(_) => {}
        }
    }

    fn observe(&mut self, observation: &Observation) {
        self.ticks = observation.header.tick + 1;
        if let Some(follower) = &mut self.follower {
            follower.observe(observation);
        }
        if let Some(MovementCut { from, movement }) = self.cutter.take(observation) {
            let noiseless = self.current_noiseless.take_if(|(tick, _)| *tick == from);
            self.rows.push(MovementRow {
                from,
                ticks: movement.errors.len() as u64,
                measured: measure(&movement, self.period_s, &self.definitions),
                noiseless: noiseless.map(|(_, measures)| measures),
            });
        }
    }

    fn command(&mut self, command: &Command) {
        let movement = self.follower.as_mut().and_then(|follower| follower.command(command, &self.cutter));
        if let Some((tick, mut movement)) = movement {
            // Where the target's position is not known, the first error stands for the distance.
            movement.distance = self.cutter.distance().unwrap_or(movement.errors[0]);
            self.current_noiseless = Some((tick, measure(&movement, self.period_s, &self.definitions)));
        }
    }

    /// Ends the log. Gives the numbers of movements that were left out.
    pub fn finish(&mut self) -> LeftOut {
        self.cutter.finish();
        self.cutter.left_out
    }

    /// Whether plant and controller are run again.
    pub fn follows(&self) -> bool {
        self.follower.is_some()
    }

    /// Why some or all noiseless movements are missing; `None` if none is.
    pub fn noiseless_missing(&self) -> Option<String> {
        match &self.follower {
            _ if !self.noiseless => Some("not asked for".to_owned()),
            None => Some("the plant is not the simulator's".to_owned()),
            Some(follower) => follower.lost_at().map(|tick| {
                format!(
                    "from tick {tick} on the log is not what this build makes of it: ticks were missed or lost, \
                     or another build wrote it"
                )
            }),
        }
    }
}
