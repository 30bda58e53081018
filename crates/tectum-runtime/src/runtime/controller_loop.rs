//! The controller's loop: receives observations, sends commands and learning records, and keeps its state in
//! the crash store.
//!
//! Every observation is appended to the crash store's journal before it is answered, and the whole state is
//! stored every 64 observations, or as often as the agent wants ([`Agent::save_every`]). A controller that is
//! restarted after a SIGKILL restores the newest complete state and replays the observations of the journal since
//! then. As its state is a function of its observations alone, that is exactly the state in which it died. It then
//! sends its last command and learning record again, under the same sequence numbers. Receivers that have received
//! them drop them.

use std::time::Duration;

use super::budget::{BudgetMeter, TickInstants};
use super::peer_monitor::PeerMonitor;
use super::policy_snapshots::SnapshotRecorder;
use super::reports::write_columns;
use super::stopwatch::Stopwatch;
use super::{Controller, ControllerReport, Participant, RuntimeError, Session};
use crate::agent::{Agent, ShippedAgent};
use crate::channel::{ControllerPorts, CrashStore};
use crate::checkpoint::{self, CheckpointWriter};
use crate::clock::{Backoff, TimeSource, precise_timers};
use crate::scenario::{Plan, ScenarioError};
use crate::state::{self, Persist, StateVisitor};
use crate::wire::{Ahead, Command, Header, Learning, Observation, ProcessState, Role, Status};

/// Most observations between two states in the crash store.
const MOST_UNSAVED: u64 = 64;
/// Observations in the journal: enough for the older of the two states, in case the newer one is torn.
const JOURNAL: usize = 4 * MOST_UNSAVED as usize;

/// The part of the loop that survives the process: the controller and its last samples.
struct ControllerLoopState<A> {
    controller: Controller<A>,
    command: Command,
    learning: Learning,
    /// Header of the observation that they answer.
    answered: Header,
    /// Observations answered.
    count: u64,
}

impl<A: Agent> ControllerLoopState<A> {
    fn new(plan: &Plan, agent: A) -> Self {
        let (command, learning) = (Command::default(), Learning::default());
        Self {
            controller: Controller::with_agent(plan, agent),
            command,
            learning,
            answered: Header::default(),
            count: 0,
        }
    }

    /// The sequence number of the next observation, if none is lost.
    fn expected(&self) -> u64 {
        if self.count == 0 { 0 } else { self.answered.sequence + 1 }
    }

    /// Ticks that the controller has behind it, received or not.
    fn ticks_done(&self) -> u64 {
        if self.count == 0 { 0 } else { self.answered.tick + 1 }
    }

    /// Computes the command.
    fn respond(&mut self, observation: &Observation) {
        self.controller.report_mut().unseen += observation.header.sequence - self.expected();
        self.answered = observation.header;
        self.controller.respond(observation, &mut self.command);
        self.command.header.sequence = self.count;
    }

    /// Improves the policy and updates the statistics, after the command has been sent.
    fn after_command(&mut self, observation: &Observation) {
        self.controller.after_command(observation);
    }

    /// Fills the learning record and counts the observation as answered.
    fn record(&mut self, observation: &Observation) {
        self.controller.record(observation, &mut self.learning);
        self.learning.header.sequence = self.count;
        self.count += 1;
    }

    /// Repeats the tick of an observation that the process's predecessor had received.
    fn replay(&mut self, observation: &Observation) {
        self.respond(observation);
        self.after_command(observation);
        self.record(observation);
    }

    /// Restores the state from the crash store, or from the checkpoint with which the run resumes, if there is
    /// one. Returns true if it was the crash store: the process has been restarted. `snapshots` then continues
    /// where the process died. `before` is what its predecessors showed last.
    fn restore(
        &mut self,
        crash_store: &mut CrashStore,
        participant: &Participant,
        before: &Status,
        snapshots: &mut Option<SnapshotRecorder>,
    ) -> Result<bool, RuntimeError> {
        let first = participant.manifest.resumed.as_ref().map_or(0, |resumed| resumed.sequences[1]);
        if let Some((_, bytes)) = crash_store.newest() {
            if !state::load(self, bytes) {
                return Err(RuntimeError::Memory(Role::Controller.name()));
            }
        } else if before.sent > first && crash_store.entry(first).is_none() {
            self.start(participant)?;
            self.forget(participant, before)?;
        } else if !participant.resume(self)? {
            self.start(participant)?;
        }
        let (stored, count) = (crash_store.newest().is_some(), self.count);
        crash_store.reopen();
        if let Some(snapshots) = snapshots {
            // A copy of this very tick may not have reached the disk before the process died.
            snapshots.skip_to(self.ticks_done().saturating_sub(1));
            observe_policy(snapshots, self.ticks_done(), self.controller.agent());
        }
        while let Some(bytes) = crash_store.entry(self.count) {
            let observation = bytemuck::pod_read_unaligned(bytes);
            self.replay(&observation);
            if let Some(snapshots) = snapshots {
                observe_policy(snapshots, self.ticks_done(), self.controller.agent());
            }
        }
        Ok(stored || self.count > count)
    }

    /// Begins with what another run has learned, if this run is to.
    fn start(&mut self, participant: &Participant) -> Result<(), RuntimeError> {
        if let Some(checkpoint) = participant.start()? {
            self.controller.start_from(&checkpoint)?;
        }
        Ok(())
    }

    /// Goes on without what the predecessor remembered, which is gone, and learns anew. Sequence numbers and counts
    /// are those that its board showed last.
    fn forget(&mut self, participant: &Participant, before: &Status) -> Result<(), RuntimeError> {
        participant.refuse_without_memory()?;
        self.count = before.sent;
        self.answered.sequence = (before.sent + before.lost).saturating_sub(1);
        self.answered.tick = before.ticks.saturating_sub(1);
        let report = self.controller.report_mut();
        (report.ticks, report.unseen, report.forgot_at) = (before.sent, before.lost, Some(before.ticks));
        Ok(())
    }

    /// Sets run and incarnation in the headers.
    fn set_writer(&mut self, run: u64, incarnation: u32) {
        for header in [&mut self.command.header, &mut self.learning.header] {
            (header.run, header.incarnation) = (run, incarnation);
        }
    }

    /// The state as a checkpoint at the start of `tick`.
    fn checkpoint(&mut self, tick: u64, participant: &Participant) -> Vec<u8> {
        let facts = participant.facts(tick, self.count);
        let policy = self.controller.agent().policy().cloned();
        checkpoint::encode(&facts, self, policy.as_ref())
    }

    /// Fills in the instants of command and learning record, just before they are sent.
    fn stamp(&mut self, time: &TimeSource) {
        stamp(&mut self.command.header, &self.answered, time);
        stamp(&mut self.learning.header, &self.answered, time);
    }

    /// Publishes the counts on the controller's board.
    fn publish_status(&self, session: &mut Session) {
        let status = &mut session.status;
        status.ticks = self.answered.tick + 1;
        status.sent = self.count;
        status.lost = self.controller.report().unseen;
        (status.loss, status.end_error) = self.controller.statistics().now();
        session.publish_progress();
    }

    /// Sends the last command and learning record.
    fn send(&self, ports: &mut ControllerPorts) -> Result<(), RuntimeError> {
        self.send_command(ports)?;
        self.send_learning(ports)
    }

    /// Sends the command, and before it what goes with it: the plant looks for that when it has the command.
    fn send_command(&self, ports: &mut ControllerPorts) -> Result<(), RuntimeError> {
        let ahead = self.controller.ahead().filter(|ahead| ahead.header.tick == self.command.header.tick);
        if let (Some(to), Some(ahead)) = (&ports.ahead, ahead) {
            to.send(&Ahead { header: Header { flags: 0, ..self.command.header }, ..*ahead })?;
        }
        ports.command.send(&self.command)?;
        ports.wake_plant.notify_waiting();
        Ok(())
    }

    /// Sends the learning record, and appends both to the log.
    fn send_learning(&self, ports: &mut ControllerPorts) -> Result<(), RuntimeError> {
        ports.command_log.append(&self.command);
        ports.learning_log.append(&self.learning);
        Ok(ports.learning.send_if_read(&self.learning)?)
    }
}

impl<A: Agent> Persist for ControllerLoopState<A> {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.nested("controller", &mut self.controller);
        visitor.words("command", &mut self.command);
        visitor.words("learning", &mut self.learning);
        visitor.words("seen", &mut self.answered);
        visitor.number("count", &mut self.count);
    }
}

/// Longest sleep while waiting for an observation in real time: the longest time until the end of a run is
/// noticed.
const WAKE_TIMEOUT: Duration = Duration::from_millis(100);

/// Hands the policy to `snapshots`, if the agent has one.
fn observe_policy<A: Agent>(snapshots: &mut SnapshotRecorder, tick: u64, agent: &A) {
    if let Some(policy) = agent.policy() {
        snapshots.observe(tick, policy);
    }
}

/// The controller's loop, with the agent that `build` makes of the run's plan. `build` checks the scenario's tables
/// for it; its error ends the process with exit code 2.
///
/// # Errors
/// When the agent refuses the scenario, the process does not fit the run, or the run ends abnormally.
pub fn run_controller<A: Agent>(
    participant: Participant,
    build: impl FnOnce(&Plan) -> Result<A, ScenarioError>,
) -> Result<ControllerReport, RuntimeError> {
    let agent = build(&participant.plan)?;
    let mut controller_loop = ControllerLoop::start(participant, agent)?;
    while let Some(observation) = controller_loop.await_observation()? {
        controller_loop.run_tick(&observation)?;
    }
    controller_loop.finish()
}

/// [`run_controller`] with a learner that Tectum ships. It is compiled here, with full optimisation.
///
/// # Errors
/// As for [`run_controller`].
pub fn run_shipped_controller(
    participant: Participant,
    build: fn(&Plan) -> Result<ShippedAgent, ScenarioError>,
) -> Result<ControllerReport, RuntimeError> {
    run_controller(participant, build)
}

/// The loop in progress. Fields are dropped in this order, so that a loop that fails publishes so before its
/// ports close.
struct ControllerLoop<A> {
    /// In real time only.
    meter: Option<BudgetMeter>,
    stopwatch: Stopwatch,
    plant: PeerMonitor,
    time: TimeSource,
    session: Session,
    writer: CheckpointWriter,
    /// Where the plant is the simulator's arm.
    snapshots: Option<SnapshotRecorder>,
    crash_store: CrashStore,
    ports: ControllerPorts,
    state: ControllerLoopState<A>,
    /// Observations between two states in the crash store.
    save_every: u64,
    backoff: Backoff,
    real: bool,
}

impl<A: Agent> ControllerLoop<A> {
    /// Joins the run. After a restart, sends the last answer again.
    fn start(participant: Participant, agent: A) -> Result<Self, RuntimeError> {
        if !agent.columns().is_empty() {
            write_columns(&participant.folder, agent.columns())?;
        }
        let save_every = agent.save_every().clamp(1, MOST_UNSAVED);
        let mut state = ControllerLoopState::new(&participant.plan, agent);
        let (mut ports, status_board) = participant.open(ControllerPorts::open)?;
        if participant.plan.scenario.link.ahead > 0 {
            ports.open_ahead()?;
        }
        if participant.manifest.frozen {
            state.controller.freeze();
        }
        let mut crash_store = participant.crash_store(state::size(&mut state), [JOURNAL, size_of::<Observation>()])?;
        let mut snapshots = SnapshotRecorder::new(&participant.folder, &participant.plan);
        let restarted = state.restore(&mut crash_store, &participant, &status_board.before, &mut snapshots)?;
        let begun = participant.manifest.started_from.as_ref().map(|start| start.tick);
        state.controller.report_mut().started_from = begun;
        let writer = participant.checkpoint_writer()?;
        // The plant writes the observations and reads the commands.
        let (session, time) = participant
            .begin(status_board, || Ok(ports.observation.connect()? >= 1 && ports.command.connect()? >= 1))?;
        precise_timers();
        let real = time.is_real();
        let backoff = ports.lockstep_wake.take().map_or_else(Backoff::default, Backoff::woken_by);
        state.set_writer(session.participant.manifest.run_id(), session.incarnation());
        let mut controller_loop = Self {
            meter: real.then(|| BudgetMeter::new(session.participant.plan.period_ns)),
            stopwatch: Stopwatch::of(&session.participant),
            plant: PeerMonitor::new(Role::Plant),
            time,
            session,
            writer,
            snapshots,
            crash_store,
            ports,
            state,
            save_every,
            backoff,
            real,
        };
        if restarted {
            controller_loop.send_again()?;
        }
        Ok(controller_loop)
    }

    /// After a restart, sends the last command and learning record again.
    fn send_again(&mut self) -> Result<(), RuntimeError> {
        self.time.step_to(self.state.answered.tick);
        self.state.stamp(&self.time);
        self.state.send(&mut self.ports)?;
        self.state.publish_status(&mut self.session);
        Ok(())
    }

    /// Waits for the next observation; in real time for the newest. `None` when the plant has finished, or will not
    /// return.
    fn await_observation(&mut self) -> Result<Option<Observation>, RuntimeError> {
        self.backoff.begin();
        // In lockstep the plant's board is read only after some turns.
        let mut looks = self.real;
        loop {
            // Read before the channel is, so that samples sent before the plant finished are still received. A
            // plant that failed may be restarted; the launcher decides that.
            let finished = looks
                && (self.ports.plant.get().state() == ProcessState::Finished || self.session.is_gone(Role::Plant));
            if let Some(mut newest) = self.ports.observation.receive()? {
                // After a stall only the newest observation counts. The sequence numbers show the skipped ones.
                while let Some(newer) = if self.real { self.ports.observation.receive()? } else { None } {
                    newest = newer;
                }
                return Ok(Some(newest));
            }
            if finished {
                return Ok(None);
            }
            if self.real {
                self.ports.wake.wait(WAKE_TIMEOUT);
            } else {
                looks = self.backoff.pause();
                if !looks {
                    continue;
                }
            }
            self.session.check()?;
            self.plant.check(&mut self.ports.plant, &self.session)?;
        }
    }

    /// One tick: answers an observation, then learns from it. An observation that was answered before is
    /// answered again.
    fn run_tick(&mut self, observation: &Observation) -> Result<(), RuntimeError> {
        if self.session.interrupted() {
            self.session.check()?;
        }
        let Header { sequence, tick, .. } = observation.header;
        if tick >= self.session.participant.plan.scenario.ticks || sequence > tick {
            // No plant sends this. Believing it would make all later observations look like duplicates.
            return Ok(());
        }
        if sequence < self.state.expected() {
            // A restarted plant sends its last observation again, and may not have received the command.
            return self.state.send(&mut self.ports);
        }
        // Read while the plant waits: it announces its next checkpoint together with the observation before it.
        let checkpoint = self.ports.plant.get().checkpoint == observation.header.tick + 2;
        let (arrived, answered) = self.answer(observation)?;
        self.after_command(observation, arrived, answered, checkpoint)
    }

    /// Computes and sends the command. Returns the instants at which the observation had arrived and the
    /// command was sent.
    fn answer(&mut self, observation: &Observation) -> Result<(u64, u64), RuntimeError> {
        let header = &observation.header;
        self.time.step_to(header.tick);
        let arrived = self.time.now();
        self.stopwatch.begin();
        self.crash_store.append(self.state.count, bytemuck::bytes_of(observation));
        self.state.respond(observation);
        stamp(&mut self.state.command.header, header, &self.time);
        self.stopwatch.end();
        self.state.send_command(&mut self.ports)?;
        Ok((arrived, self.time.now()))
    }

    /// The work for which the plant does not wait: improves the policy, sends the learning record, saves the
    /// state, and publishes the status.
    fn after_command(
        &mut self,
        observation: &Observation,
        arrived: u64,
        answered: u64,
        checkpoint: bool,
    ) -> Result<(), RuntimeError> {
        let header = &observation.header;
        self.state.after_command(observation);
        let improved = self.time.now();
        self.state.record(observation);
        stamp(&mut self.state.learning.header, header, &self.time);
        self.state.send_learning(&mut self.ports)?;

        if let Some(snapshots) = &mut self.snapshots {
            observe_policy(snapshots, header.tick + 1, self.state.controller.agent());
            snapshots.flush(&self.writer);
        }
        if checkpoint {
            let next = header.tick + 1;
            self.writer.write(next, self.state.checkpoint(next, &self.session.participant));
            self.session.status.checkpoint = next + 1;
        }
        let (every, state) = (self.save_every, &mut self.state);
        if state.count.is_multiple_of(every) && !self.crash_store.store(state.count, |to| state::save(state, to)) {
            return Err(RuntimeError::Memory(Role::Controller.name()));
        }
        if let Some(meter) = &mut self.meter {
            let (scheduled, done) = (header.scheduled_ns, self.time.now());
            meter.record(TickInstants { scheduled, arrived, answered, improved, done });
            self.session.status.learner_ns = meter.learner_ns;
        }
        self.state.publish_status(&mut self.session);
        Ok(self.ports.command.prepare(&self.state.command)?)
    }

    /// Ends the loop: writes the last checkpoint and the report.
    fn finish(mut self) -> Result<ControllerReport, RuntimeError> {
        self.session.enter(ProcessState::Closing);
        let end = self.state.ticks_done();
        if let (Some(snapshots), Some(policy)) = (&mut self.snapshots, self.state.controller.agent().policy()) {
            snapshots.finish(end, policy);
            snapshots.flush(&self.writer);
        }
        let checkpoint = self.state.checkpoint(end, &self.session.participant);
        self.writer.write_last(end, checkpoint, self.session.stopping());
        let report = self.state.controller.report_mut();
        match self.writer.finish() {
            Ok(written) => report.checkpoints = written,
            Err(cause) => report.checkpoint_failure = Some(cause),
        }
        self.state.controller.report_mut().tick_budget = self.meter.and_then(|meter| meter.finish());
        let report = self.state.controller.finish();
        self.stopwatch.write()?;
        self.session.finish(&report)?;
        Ok(report)
    }
}

/// Fills in the instants of a sample of the observation's tick, just before it is sent.
fn stamp(header: &mut Header, observation: &Header, time: &TimeSource) {
    header.scheduled_ns = observation.scheduled_ns;
    header.sensed_ns = observation.sensed_ns;
    header.published_ns = time.now();
}
