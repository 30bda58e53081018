//! The controller's loop: observations in, commands and learning records out, and what survives its death.
//!
//! Every observation is noted in the vault before it is answered, and the whole state is kept there every [`KEEP`]
//! observations. A controller that comes back after a SIGKILL takes up the newest whole state and goes through what was
//! noted since. As it is a function of its observations alone, that brings it to the very state in which it died. What it
//! may have been about to say then it says again, under the same sequence number: who has heard it drops it.

use std::time::Duration;

use super::budget::{BudgetMeter, TickInstants};
use super::peer_monitor::PeerMonitor;
use super::policy_snapshots::SnapshotRecorder;
use super::stopwatch::Stopwatch;
use super::{Controller, ControllerReport, Participant, RuntimeError, Session};
use crate::channel::{ControllerPorts, CrashStore};
use crate::checkpoint;
use crate::clock::{Backoff, TimeSource};
use crate::scenario::Plan;
use crate::state::{self, Persist, StateVisitor};
use crate::wire::{Command, Header, Learning, Observation, ProcessState, Role};

/// Observations between two states that are kept.
const KEEP: u64 = 64;
/// Observations that stay noted: enough for the older of two states, should the newer one be torn.
const NOTED: usize = 4 * KEEP as usize;

/// The controller and what it said last.
struct ControllerLoopState {
    controller: Controller,
    command: Command,
    learning: Learning,
    /// Header of the observation that they answer.
    seen: Header,
    /// Observations answered.
    count: u64,
}

impl ControllerLoopState {
    fn new(plan: &Plan) -> Self {
        let (command, learning) = (Command::default(), Learning::default());
        Self { controller: Controller::new(plan), command, learning, seen: Header::default(), count: 0 }
    }

    /// The sequence number of the next observation, if none is lost.
    fn expected(&self) -> u64 {
        if self.count == 0 { 0 } else { self.seen.sequence + 1 }
    }

    /// Ticks that lie behind the controller, seen or not.
    fn ticks_done(&self) -> u64 {
        if self.count == 0 { 0 } else { self.seen.tick + 1 }
    }

    /// What a command waits for.
    fn respond(&mut self, observation: &Observation) {
        self.controller.report.unseen += observation.header.sequence - self.expected();
        self.seen = observation.header;
        self.controller.respond(observation, &mut self.command);
        self.command.header.sequence = self.count;
    }

    /// What nobody waits for, but for the learning record.
    fn after_command(&mut self, observation: &Observation) {
        self.controller.after_command(observation);
    }

    fn record(&mut self, observation: &Observation) {
        self.controller.record(observation, &mut self.learning);
        self.learning.header.sequence = self.count;
        self.count += 1;
    }

    /// Goes through an observation that was answered by the one before.
    fn relive(&mut self, observation: &Observation) {
        self.respond(observation);
        self.after_command(observation);
        self.record(observation);
    }

    /// Takes up what the vault holds, or the checkpoint that the run begins with. True if it was the vault.
    fn reopen(
        &mut self,
        crash_store: &mut CrashStore,
        participant: &Participant,
        snapshots: &mut Option<SnapshotRecorder>,
    ) -> Result<bool, RuntimeError> {
        if let Some((_, bytes)) = crash_store.newest() {
            if !state::load(self, bytes) {
                return Err(RuntimeError::Memory(Role::Controller.name()));
            }
        } else {
            participant.resume(self)?;
        }
        let before = (crash_store.newest().is_some(), self.count);
        crash_store.reopen();
        if let Some(snapshots) = snapshots {
            // A copy of this very tick may not have reached the disk.
            snapshots.skip_to(self.ticks_done().saturating_sub(1));
            snapshots.observe(self.ticks_done(), self.controller.policy());
        }
        while let Some(bytes) = crash_store.entry(self.count) {
            let observation = bytemuck::pod_read_unaligned(bytes);
            self.relive(&observation);
            if let Some(snapshots) = snapshots {
                snapshots.observe(self.ticks_done(), self.controller.policy());
            }
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
    fn checkpoint(&mut self, tick: u64, participant: &Participant) -> Vec<u8> {
        let facts = participant.facts(tick, self.count);
        let policy = self.controller.policy().clone();
        checkpoint::encode(&facts, self, Some(&policy))
    }

    fn stamp(&mut self, time: &TimeSource) {
        stamp(&mut self.command.header, &self.seen, time);
        stamp(&mut self.learning.header, &self.seen, time);
    }

    /// Shows how far the controller is.
    fn publish_status(&self, session: &mut Session) {
        let status = &mut session.status;
        status.ticks = self.seen.tick + 1;
        status.sent = self.count;
        status.lost = self.controller.report.unseen;
        (status.loss, status.end_error) = self.controller.statistics().now();
        session.publish_status();
    }

    /// Says the last answer, again.
    fn send(&self, ports: &ControllerPorts) -> Result<(), RuntimeError> {
        ports.command.send(&self.command)?;
        ports.learning.send(&self.learning)?;
        Ok(())
    }
}

impl Persist for ControllerLoopState {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.nested("controller", &mut self.controller);
        visitor.sample("command", &mut self.command);
        visitor.sample("learning", &mut self.learning);
        visitor.sample("seen", &mut self.seen);
        visitor.number("count", &mut self.count);
    }
}

/// Longest sleep while waiting for an observation in real time: how soon the end of a run is noticed.
const WAKE_TIMEOUT: Duration = Duration::from_millis(100);

/// Waits for the next observation; in real time for the newest. `None` when there will be none.
fn await_observation(
    ports: &mut ControllerPorts,
    plant: &mut PeerMonitor,
    session: &Session,
    real: bool,
) -> Result<Option<Observation>, RuntimeError> {
    let mut backoff = Backoff::default();
    loop {
        // Asked before the channel is: what the plant sent before it finished is still received. A plant that failed may
        // come back; whether it does, the launcher says.
        let over = ports.plant.get().state() == ProcessState::Finished;
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
            ports.wake.wait(WAKE_TIMEOUT);
            session.check()?;
            plant.check(&mut ports.plant, session)?;
        } else if backoff.pause() {
            session.check()?;
            plant.check(&mut ports.plant, session)?;
        }
    }
}

/// The controller's loop.
///
/// # Errors
/// When the process does not fit the run, or the run ends in disorder.
pub fn run_controller(participant: Participant) -> Result<ControllerReport, RuntimeError> {
    let mut loop_state = ControllerLoopState::new(&participant.plan);
    let (mut ports, status_board) = participant.open(ControllerPorts::open)?;
    let mut crash_store = participant.crash_store(state::size(&mut loop_state), [NOTED, size_of::<Observation>()])?;
    let mut snapshots = SnapshotRecorder::new(&participant.folder, &participant.plan);
    let returned = loop_state.reopen(&mut crash_store, &participant, &mut snapshots)?;
    let writer = participant.writer()?;
    // Writer of observations: the plant. Readers of commands: plant and logger; of learning records: the logger.
    let (mut session, mut time) = participant.begin(status_board, || {
        Ok(ports.observation.connect()? >= 1 && ports.command.connect()? >= 2 && ports.learning.connect()? >= 1)
    })?;
    let mut plant = PeerMonitor::new(Role::Plant);
    let real = time.is_real();
    loop_state.introduce(session.participant.manifest.run_id(), session.incarnation());
    if returned {
        time.step_to(loop_state.seen.tick);
        loop_state.stamp(&time);
        loop_state.send(&ports)?;
        loop_state.publish_status(&mut session);
    }
    let mut watch = Stopwatch::of(&session.participant);
    let mut meter = real.then(|| BudgetMeter::new(session.participant.plan.period_ns));

    while let Some(observation) = await_observation(&mut ports, &mut plant, &session, real)? {
        let seen = &observation.header;
        if session.interrupted() {
            session.check()?;
        }
        if seen.sequence < loop_state.expected() {
            // A plant that has come back says its last word again, and may not have heard the answer.
            loop_state.send(&ports)?;
            continue;
        }
        // Looked at while the plant waits: it announces its next checkpoint with the observation before it.
        let cut = ports.plant.get().checkpoint == seen.tick + 2;
        time.step_to(seen.tick);
        let arrived = time.now();
        watch.begin();
        crash_store.append(loop_state.count, bytemuck::bytes_of(&observation));
        loop_state.respond(&observation);
        stamp(&mut loop_state.command.header, seen, &time);
        watch.end();
        ports.command.send(&loop_state.command)?;

        // From here on nobody waits.
        let answered = time.now();
        loop_state.after_command(&observation);
        let improved = time.now();
        loop_state.record(&observation);
        stamp(&mut loop_state.learning.header, seen, &time);
        ports.learning.send(&loop_state.learning)?;

        if let Some(snapshots) = &mut snapshots {
            snapshots.observe(seen.tick + 1, loop_state.controller.policy());
            snapshots.flush(&writer);
        }
        if cut {
            writer.write(seen.tick + 1, loop_state.checkpoint(seen.tick + 1, &session.participant));
        }
        if loop_state.count.is_multiple_of(KEEP)
            && !crash_store.store(loop_state.count, |to| state::save(&mut loop_state, to))
        {
            return Err(RuntimeError::Memory(Role::Controller.name()));
        }
        if let Some(meter) = &mut meter {
            let (scheduled, done) = (seen.scheduled_ns, time.now());
            meter.record(TickInstants { scheduled, seen: arrived, answered, improved, done });
            session.status.learner_ns = meter.learner_ns;
        }
        loop_state.publish_status(&mut session);
    }
    let end = loop_state.ticks_done();
    if let Some(snapshots) = &mut snapshots {
        snapshots.finish(end, loop_state.controller.policy());
        snapshots.flush(&writer);
    }
    writer.write_last(end, loop_state.checkpoint(end, &session.participant), session.stopping());
    let report = &mut loop_state.controller.report;
    match writer.finish() {
        Ok(written) => report.checkpoints = written,
        Err(cause) => report.checkpoint_failure = Some(cause),
    }
    loop_state.controller.report.tick_budget = meter.and_then(|meter| meter.finish());
    let report = loop_state.controller.finish();
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
