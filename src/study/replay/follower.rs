//! Runs plant and controller again along a log, and compares every sample.
//!
//! The controller answers every observation that it receives, in the order of ticks. So it received exactly
//! the observations whose command is in the log. In real time it may not receive an observation, and a late
//! sample stands after samples of later ticks on other channels. So samples wait here for the samples that
//! belong before them.

use std::collections::VecDeque;

use super::controller::ReplayedController;
use super::off_policy::OffPolicyLearner;
use super::plant_replay::PlantReplay;
use super::sample_diff::{Difference, compare};
use super::stamps::StampChecker;
use crate::log::LogRecord;
use crate::runtime::PipeError;
use crate::scenario::Plan;
use crate::wire::{Command, Learning, Observation, flag};

/// Numbers of samples checked so far.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct CheckCounts {
    /// Commands.
    pub answers: u64,
    /// Learning records.
    pub records: u64,
    /// Hashes of the weights.
    pub hashes: u64,
    /// Observations that the controller never received.
    pub unseen: u64,
}

/// Why a replay stops before the end of the log.
pub(super) enum Parted {
    /// The log differs from its replay.
    Difference(Box<Difference>),
    /// The controller's program failed.
    Pipe(PipeError),
}

impl From<Box<Difference>> for Parted {
    fn from(difference: Box<Difference>) -> Self {
        Self::Difference(difference)
    }
}

impl From<PipeError> for Parted {
    fn from(error: PipeError) -> Self {
        Self::Pipe(error)
    }
}

/// A run that is replayed along its log.
pub(super) struct ReplayFollower {
    stamps: StampChecker,
    plant: PlantReplay,
    /// The log's own learner.
    pub controller: ReplayedController,
    /// Another learner, which gets the same experience.
    pub other: Option<OffPolicyLearner>,
    /// Samples that were read and not yet replayed.
    observations: VecDeque<Observation>,
    commands: VecDeque<Command>,
    learnings: VecDeque<Learning>,
    /// Replayed learning records whose logged counterpart was not read yet, with the observations that they
    /// belong to.
    unmatched: VecDeque<(Observation, Learning)>,
    /// The last command that was replayed.
    answer: Option<Command>,
    /// Incarnations of the writers of commands and learning records so far. They only rise.
    incarnations: [u32; 2],
    /// Numbers of samples checked.
    pub counts: CheckCounts,
}

impl ReplayFollower {
    /// The beginning of a run of `plan`.
    pub fn new(
        plan: &Plan,
        stamps: StampChecker,
        controller: ReplayedController,
        other: Option<OffPolicyLearner>,
    ) -> Self {
        Self {
            stamps,
            plant: PlantReplay::new(plan),
            controller,
            other,
            observations: VecDeque::new(),
            commands: VecDeque::new(),
            learnings: VecDeque::new(),
            unmatched: VecDeque::new(),
            answer: None,
            incarnations: [0; 2],
            counts: CheckCounts::default(),
        }
    }

    /// The replayed plant.
    pub fn plant(&self) -> &PlantReplay {
        &self.plant
    }

    /// Takes the log's next message and replays as far as the messages so far allow.
    pub fn take(&mut self, record: &LogRecord) -> Result<(), Parted> {
        match record {
            LogRecord::Observation(s) => self.observations.push_back(*s),
            LogRecord::Command(s) => self.commands.push_back(*s),
            LogRecord::Learning(s) => self.learnings.push_back(*s),
            LogRecord::Gap(_) => {}
        }
        self.advance()
    }

    fn advance(&mut self) -> Result<(), Parted> {
        self.advance_ticks()?;
        self.match_learning()
    }

    /// Replays all ticks up to the last command that was read.
    fn advance_ticks(&mut self) -> Result<(), Parted> {
        while let Some(command) = self.commands.front() {
            let Some(observation) = self.observations.front() else { break };
            let (observed, answered) = (observation.header.tick, command.header.tick);
            if observed > answered {
                return Err(unpaired("command", answered, "an answer to an observation that is not there", "none"));
            }
            let observation = *observation;
            self.observations.pop_front();
            self.plant.check(
                &observation,
                self.answer.as_ref().filter(|a| self.plant.last() == Some(a.header.tick)),
                &self.stamps,
            )?;
            if observed == answered {
                self.answer(&observation)?;
            } else if self.stamps.lockstep {
                return Err(unpaired("command", observed, "none", "an answer to the observation"));
            } else {
                self.counts.unseen += 1;
            }
        }
        Ok(())
    }

    /// Compares the replayed learning records with those of the log that were read.
    fn match_learning(&mut self) -> Result<(), Parted> {
        while let (Some((observation, replayed)), Some(logged)) = (self.unmatched.front_mut(), self.learnings.front()) {
            let (header, known) = (&mut replayed.header, self.incarnations[1]);
            self.stamps.stamp_answer(header, &observation.header, self.counts.records, known, &logged.header);
            compare("learning", observation.header.tick, logged, replayed)?;
            self.incarnations[1] = logged.header.incarnation;
            self.stamps.check_order(&logged.header, "learning")?;
            self.counts.hashes += u64::from(logged.header.flags & flag::HASHED != 0);
            self.counts.records += 1;
            self.unmatched.pop_front();
            self.learnings.pop_front();
        }
        Ok(())
    }

    /// Replays the controller's tick, and compares its answer with the next command of the log.
    fn answer(&mut self, observation: &Observation) -> Result<(), Parted> {
        let Some(logged) = self.commands.pop_front() else { return Ok(()) };
        let (mut command, mut learning) = (Command::default(), Learning::default());
        self.controller.answer(observation, &mut command, &mut learning)?;
        let (header, known) = (&mut command.header, self.incarnations[0]);
        self.stamps.stamp_answer(header, &observation.header, self.counts.answers, known, &logged.header);
        compare("command", observation.header.tick, &logged, &command)?;
        self.incarnations[0] = logged.header.incarnation;
        self.stamps.check_order(&logged.header, "command")?;
        if let Some(other) = &mut self.other {
            other.learn(observation, &command);
        }
        self.unmatched.push_back((*observation, learning));
        self.answer = Some(logged);
        self.counts.answers += 1;
        Ok(())
    }

    /// Ends the log. If it is not `whole`, it was cut off, and samples of the last ticks may be missing.
    /// `complete` means that the run reached its planned end of `ticks`.
    pub fn end(&mut self, whole: bool, complete: bool, ticks: u64) -> Result<(), Parted> {
        self.advance()?;
        while let Some(observation) = self.observations.pop_front() {
            let command = self.answer.as_ref().filter(|a| self.plant.last() == Some(a.header.tick));
            if !whole && command.is_none() {
                // The answers before this observation were lost with the end of the log.
                break;
            }
            self.plant.check(&observation, command, &self.stamps)?;
            self.counts.unseen += 1;
            if self.stamps.lockstep && complete {
                return Err(unpaired("command", observation.header.tick, "none", "an answer to the observation"));
            }
        }
        if let (true, Some(command)) = (whole, self.commands.front()) {
            return Err(unpaired(
                "command",
                command.header.tick,
                "an answer to an observation that is not there",
                "none",
            ));
        }
        if let (true, Some(learning)) = (whole, self.learnings.front()) {
            return Err(unpaired("learning", learning.header.tick, "a record of a tick without an answer", "none"));
        }
        if let (true, true, Some((observation, _))) = (whole, complete, self.unmatched.front()) {
            return Err(unpaired("learning", observation.header.tick, "none", "a record of the tick"));
        }
        if whole && complete && self.stamps.lockstep && self.plant.seen() != ticks {
            return Err(unpaired("observation", self.plant.seen(), "none", "an observation"));
        }
        Ok(())
    }
}

/// The difference for a sample that exists only in the log or only in the replay.
fn unpaired(channel: &'static str, tick: u64, logged: &str, replayed: &str) -> Parted {
    let field = "the whole sample".to_owned();
    Parted::Difference(Box::new(Difference {
        tick,
        channel,
        field,
        logged: logged.to_owned(),
        replayed: replayed.to_owned(),
    }))
}
