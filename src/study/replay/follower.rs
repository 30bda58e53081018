//! A run followed through its log: which observations its controller saw, and what it then did.
//!
//! The controller answers every observation that it sees, in the order of ticks, and no other; so it saw those whose
//! command is in the log. In real time it may pass observations by, and a sample that came late stands behind later ticks'
//! samples of other channels; so samples wait here for those that belong before them.

use std::collections::VecDeque;

use super::compare::{Difference, compare};
use super::off_policy::OffPolicyLearner;
use super::plant_replay::PlantReplay;
use super::stamps::StampChecker;
use crate::log::LogRecord;
use crate::runtime::Controller;
use crate::scenario::Plan;
use crate::wire::{Command, Learning, Observation, flag};

/// What was checked so far.
#[derive(Debug, Clone, Copy, Default)]
pub struct CheckCounts {
    /// Commands, and the learning records that belong to them.
    pub answers: u64,
    /// Learning records.
    pub records: u64,
    /// Hashes of the weights.
    pub hashes: u64,
    /// Observations that the controller never saw.
    pub unseen: u64,
}

/// The run, as its log's beginning makes it go on.
pub struct ReplayFollower {
    clock: StampChecker,
    plant: PlantReplay,
    /// The log's own learner.
    pub controller: Controller,
    /// Another one, which is given the same experience.
    pub other: Option<OffPolicyLearner>,
    /// Read and not yet followed.
    observations: VecDeque<Observation>,
    commands: VecDeque<Command>,
    learnings: VecDeque<Learning>,
    /// What the learner did in ticks whose record has not come yet, with the observation that it answered.
    due: VecDeque<(Observation, Learning)>,
    /// The last command followed.
    answer: Option<Command>,
    /// Start numbers of the writers of commands and learning records: they only rise.
    incarnations: [u32; 2],
    /// What was checked.
    pub counts: CheckCounts,
}

impl ReplayFollower {
    /// The beginning of a run of `plan`.
    pub fn new(plan: &Plan, clock: StampChecker, other: Option<OffPolicyLearner>) -> Self {
        Self {
            clock,
            plant: PlantReplay::new(plan),
            controller: Controller::new(plan),
            other,
            observations: VecDeque::new(),
            commands: VecDeque::new(),
            learnings: VecDeque::new(),
            due: VecDeque::new(),
            answer: None,
            incarnations: [0; 2],
            counts: CheckCounts::default(),
        }
    }

    /// The plant's half.
    pub fn plant(&self) -> &PlantReplay {
        &self.plant
    }

    /// Takes the log's next message in and follows as far as that goes.
    pub fn take(&mut self, record: &LogRecord) -> Result<(), Box<Difference>> {
        match record {
            LogRecord::Observation(s) => self.observations.push_back(*s),
            LogRecord::Command(s) => self.commands.push_back(*s),
            LogRecord::Learning(s) => self.learnings.push_back(*s),
            LogRecord::Gap(_) => {}
        }
        self.advance()
    }

    fn advance(&mut self) -> Result<(), Box<Difference>> {
        while let Some(command) = self.commands.front() {
            let Some(observation) = self.observations.front() else { break };
            let (seen, answered) = (observation.header.tick, command.header.tick);
            if seen > answered {
                return Err(lone("command", answered, "an answer to an observation that is not there", "none"));
            }
            let observation = *observation;
            self.observations.pop_front();
            self.plant.check(
                &observation,
                self.answer.as_ref().filter(|a| self.plant.last() == Some(a.header.tick)),
                &self.clock,
            )?;
            if seen == answered {
                self.answer(&observation)?;
            } else if self.clock.lockstep {
                return Err(lone("command", seen, "none", "an answer to the observation"));
            } else {
                self.counts.unseen += 1;
            }
        }
        while let (Some((observation, replayed)), Some(logged)) = (self.due.front_mut(), self.learnings.front()) {
            let (header, known) = (&mut replayed.header, self.incarnations[1]);
            self.clock.stamp_answer(header, &observation.header, self.counts.records, known, &logged.header);
            compare("learning", observation.header.tick, logged, replayed)?;
            self.incarnations[1] = logged.header.incarnation;
            self.clock.check_order(&logged.header, "learning")?;
            self.counts.hashes += u64::from(logged.header.flags & flag::HASHED != 0);
            self.counts.records += 1;
            self.due.pop_front();
            self.learnings.pop_front();
        }
        Ok(())
    }

    /// The controller's tick, held against the first command that waits.
    fn answer(&mut self, observation: &Observation) -> Result<(), Box<Difference>> {
        let Some(logged) = self.commands.pop_front() else { return Ok(()) };
        let (mut command, mut learning) = (Command::default(), Learning::default());
        self.controller.respond(observation, &mut command);
        let (header, known) = (&mut command.header, self.incarnations[0]);
        self.clock.stamp_answer(header, &observation.header, self.counts.answers, known, &logged.header);
        compare("command", observation.header.tick, &logged, &command)?;
        self.incarnations[0] = logged.header.incarnation;
        self.clock.check_order(&logged.header, "command")?;
        self.controller.after_command(observation);
        self.controller.record(observation, &mut learning);
        if let Some(other) = &mut self.other {
            other.take(observation, &command);
        }
        self.due.push_back((*observation, learning));
        self.answer = Some(logged);
        self.counts.answers += 1;
        Ok(())
    }

    /// The log has ended: `whole`, or cut off, and then samples of the last ticks may be missing. `complete` says that the
    /// run came to its planned end of `ticks`.
    pub fn end(&mut self, whole: bool, complete: bool, ticks: u64) -> Result<(), Box<Difference>> {
        self.advance()?;
        while let Some(observation) = self.observations.pop_front() {
            let command = self.answer.as_ref().filter(|a| self.plant.last() == Some(a.header.tick));
            if !whole && command.is_none() {
                // The answers in between were behind the cut.
                break;
            }
            self.plant.check(&observation, command, &self.clock)?;
            self.counts.unseen += 1;
            if self.clock.lockstep && complete {
                return Err(lone("command", observation.header.tick, "none", "an answer to the observation"));
            }
        }
        if let (true, Some(command)) = (whole, self.commands.front()) {
            return Err(lone("command", command.header.tick, "an answer to an observation that is not there", "none"));
        }
        if let (true, Some(learning)) = (whole, self.learnings.front()) {
            return Err(lone("learning", learning.header.tick, "a record of a tick without an answer", "none"));
        }
        if let (true, true, Some((observation, _))) = (whole, complete, self.due.front()) {
            return Err(lone("learning", observation.header.tick, "none", "a record of the tick"));
        }
        if whole && complete && self.clock.lockstep && self.plant.seen() != ticks {
            return Err(lone("observation", self.plant.seen(), "none", "an observation"));
        }
        Ok(())
    }
}

/// A sample that is there and should not be, or the other way round.
fn lone(channel: &'static str, tick: u64, logged: &str, replayed: &str) -> Box<Difference> {
    let field = "the whole sample".to_owned();
    Box::new(Difference { tick, channel, field, logged: logged.to_owned(), replayed: replayed.to_owned() })
}
