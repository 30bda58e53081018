//! The controller's loop: observations in, commands and learning records out, and what survives its death.
//!
//! Every observation is noted in the vault before it is answered, and the whole state is kept there every [`KEEP`]
//! observations. A controller that comes back after a SIGKILL takes up the newest whole state and goes through what was
//! noted since. As it is a function of its observations alone, that brings it to the very state in which it died. What it
//! may have been about to say then it says again, under the same sequence number: who has heard it drops it.

use std::time::Duration;

use super::budget::{Instants, Meter};
use super::peer::Peer;
use super::stopwatch::Stopwatch;
use super::{Controller, ControllerReport, RuntimeError, Seat, Session};
use crate::channel::{ControllerPorts, Vault};
use crate::checkpoint;
use crate::clock::{Backoff, TimeSource};
use crate::scenario::Plan;
use crate::state::{self, Ledger, Remember};
use crate::wire::{Command, Header, Learning, Observation, Role, State};

/// Observations between two states that are kept.
const KEEP: u64 = 64;
/// Observations that stay noted: enough for the older of two states, should the newer one be torn.
const NOTED: usize = 4 * KEEP as usize;

/// The controller and what it said last.
struct Answers {
    controller: Controller,
    command: Command,
    learning: Learning,
    /// Header of the observation that they answer.
    seen: Header,
    /// Observations answered.
    count: u64,
}

impl Answers {
    fn new(plan: &Plan) -> Self {
        let (command, learning) = (Command::default(), Learning::default());
        Self { controller: Controller::new(plan), command, learning, seen: Header::default(), count: 0 }
    }

    /// The sequence number of the next observation, if none is lost.
    fn expected(&self) -> u64 {
        if self.count == 0 { 0 } else { self.seen.sequence + 1 }
    }

    /// What a command waits for.
    fn respond(&mut self, observation: &Observation) {
        self.controller.report.unseen += observation.header.sequence - self.expected();
        self.seen = observation.header;
        self.controller.respond(observation, &mut self.command);
        self.command.header.sequence = self.count;
    }

    /// What nobody waits for, but for the learning record.
    fn settle(&mut self, observation: &Observation) {
        self.controller.settle(observation);
    }

    fn record(&mut self, observation: &Observation) {
        self.controller.record(observation, &mut self.learning);
        self.learning.header.sequence = self.count;
        self.count += 1;
    }

    /// Goes through an observation that was answered by the one before.
    fn relive(&mut self, observation: &Observation) {
        self.respond(observation);
        self.settle(observation);
        self.record(observation);
    }

    /// Takes up what the vault holds, or the checkpoint that the run begins with. True if it was the vault.
    fn take_up(&mut self, vault: &mut Vault, seat: &Seat) -> Result<bool, RuntimeError> {
        if let Some((_, bytes)) = vault.newest() {
            if !state::load(self, bytes) {
                return Err(RuntimeError::Memory(Role::Controller.name()));
            }
        } else {
            seat.resume(self)?;
        }
        let before = (vault.newest().is_some(), self.count);
        vault.take_up();
        while let Some(bytes) = vault.entry(self.count) {
            let observation = bytemuck::pod_read_unaligned(bytes);
            self.relive(&observation);
        }
        Ok(before.0 || self.count > before.1)
    }

    /// Tells the readers which run and which start of the process speaks.
    fn introduce(&mut self, run: u64, incarnation: u32) {
        for header in [&mut self.command.header, &mut self.learning.header] {
            (header.run, header.incarnation) = (run, incarnation);
        }
    }

    /// The state as a checkpoint, as of when `tick` begins.
    fn checkpoint(&mut self, tick: u64, seat: &Seat) -> Vec<u8> {
        let facts = seat.facts(tick, self.count);
        let policy = self.controller.policy().clone();
        checkpoint::encode(&facts, self, Some(&policy))
    }

    fn stamp(&mut self, time: &TimeSource) {
        stamp(&mut self.command.header, &self.seen, time);
        stamp(&mut self.learning.header, &self.seen, time);
    }

    /// Shows how far the controller is.
    fn show(&self, session: &mut Session) {
        let status = &mut session.status;
        status.ticks = self.seen.tick + 1;
        status.sent = self.count;
        status.lost = self.controller.report.unseen;
        (status.loss, status.end_error) = self.controller.tally().now();
        session.show();
    }

    /// Says the last answer, again.
    fn say(&self, ports: &ControllerPorts) -> Result<(), RuntimeError> {
        ports.command.send(&self.command)?;
        ports.learning.send(&self.learning)?;
        Ok(())
    }
}

impl Remember for Answers {
    fn remember(&mut self, ledger: &mut dyn Ledger) {
        ledger.part("controller", &mut self.controller);
        ledger.sample("command", &mut self.command);
        ledger.sample("learning", &mut self.learning);
        ledger.sample("seen", &mut self.seen);
        ledger.number("count", &mut self.count);
    }
}

/// Longest sleep while waiting for an observation in real time: how soon the end of a run is noticed.
const EAR_TIMEOUT: Duration = Duration::from_millis(100);

/// Waits for the next observation; in real time for the newest. `None` when there will be none.
fn await_observation(
    ports: &mut ControllerPorts,
    plant: &mut Peer,
    session: &Session,
    real: bool,
) -> Result<Option<Observation>, RuntimeError> {
    let mut backoff = Backoff::default();
    loop {
        // Asked before the channel is: what the plant sent before it finished is still received. A plant that failed may
        // come back; whether it does, the launcher says.
        let over = ports.plant.get().state() == State::Finished;
        if let Some(mut newest) = ports.observation.receive()? {
            // After a stall only the present counts; what was passed by shows in the sequence numbers.
            while let Some(newer) = if real { ports.observation.receive()? } else { None } {
                newest = newer;
            }
            return Ok(Some(newest));
        }
        if over {
            return Ok(None);
        }
        if real {
            ports.ear.listen(EAR_TIMEOUT);
            session.check()?;
            plant.look(&mut ports.plant, session)?;
        } else if backoff.pause() {
            session.check()?;
            plant.look(&mut ports.plant, session)?;
        }
    }
}

/// The controller's loop.
///
/// # Errors
/// When the process does not fit the run, or the run ends in disorder.
pub fn run_controller(seat: Seat) -> Result<ControllerReport, RuntimeError> {
    let mut answers = Answers::new(&seat.plan);
    let (mut ports, desk) = seat.open(ControllerPorts::open)?;
    let mut vault = seat.vault(state::size(&mut answers), [NOTED, size_of::<Observation>()])?;
    let came_back = answers.take_up(&mut vault, &seat)?;
    let writer = seat.writer()?;
    // Writer of observations: the plant. Readers of commands: plant and logger; of learning records: the logger.
    let (mut session, mut time) = seat.begin(desk, || {
        Ok(ports.observation.connect()? >= 1 && ports.command.connect()? >= 2 && ports.learning.connect()? >= 1)
    })?;
    let mut plant = Peer::new(Role::Plant);
    let real = time.is_real();
    answers.introduce(session.seat.card.run_id(), session.incarnation());
    if came_back {
        time.step_to(answers.seen.tick);
        answers.stamp(&time);
        answers.say(&ports)?;
        answers.show(&mut session);
    }
    let mut watch = Stopwatch::of(&session.seat);
    let mut meter = real.then(|| Meter::new(session.seat.plan.period_ns));

    while let Some(observation) = await_observation(&mut ports, &mut plant, &session, real)? {
        let seen = &observation.header;
        if session.interrupted() {
            session.check()?;
        }
        if seen.sequence < answers.expected() {
            // A plant that has come back says its last word again, and may not have heard the answer.
            answers.say(&ports)?;
            continue;
        }
        // Looked at while the plant waits: it announces its next checkpoint with the observation before it.
        let cut = ports.plant.get().checkpoint == seen.tick + 2;
        time.step_to(seen.tick);
        let arrived = time.now();
        watch.begin();
        vault.note(answers.count, bytemuck::bytes_of(&observation));
        answers.respond(&observation);
        stamp(&mut answers.command.header, seen, &time);
        watch.end();
        ports.command.send(&answers.command)?;

        // From here on nobody waits.
        let answered = time.now();
        answers.settle(&observation);
        let improved = time.now();
        answers.record(&observation);
        stamp(&mut answers.learning.header, seen, &time);
        ports.learning.send(&answers.learning)?;

        if cut {
            writer.write(seen.tick + 1, answers.checkpoint(seen.tick + 1, &session.seat));
        }
        if answers.count.is_multiple_of(KEEP) && !vault.keep(answers.count, |to| state::save(&mut answers, to)) {
            return Err(RuntimeError::Memory(Role::Controller.name()));
        }
        if let Some(meter) = &mut meter {
            let (scheduled, done) = (seen.scheduled_ns, time.now());
            meter.record(Instants { scheduled, seen: arrived, answered, improved, done });
            session.status.learner_ns = meter.learner_ns;
        }
        answers.show(&mut session);
    }
    let end = answers.seen.tick + u64::from(answers.count > 0);
    writer.write_last(end, answers.checkpoint(end, &session.seat), session.stopping());
    let report = &mut answers.controller.report;
    match writer.finish() {
        Ok(written) => report.checkpoints = written,
        Err(cause) => report.checkpoint_failure = Some(cause),
    }
    answers.controller.report.tick_budget = meter.and_then(|meter| meter.finish());
    let report = answers.controller.finish();
    watch.leave()?;
    session.finish(&report)?;
    Ok(report)
}

/// Stamps a sample of the observation's tick just before it is sent.
fn stamp(header: &mut Header, observation: &Header, time: &TimeSource) {
    header.scheduled_ns = observation.scheduled_ns;
    header.sensed_ns = observation.sensed_ns;
    header.published_ns = time.now();
}
