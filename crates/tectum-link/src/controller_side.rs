//! The controller's machine: takes the plant's place in its run.
//!
//! It hands the observations of the other machine to controller and logger, with their instants on this machine's
//! clock, and sends back what the controller answers. When the plant's machine begins a new run, its ticks go on behind
//! those that this run has had.

use std::time::Duration;

use tectum::channel::{LOG_BUFFER, LogTail, PlantPorts};
use tectum::clock::{monotonic_ns, pause, precise_timers};
use tectum::runtime::{Participant, PlantReport, RuntimeError, Session};
use tectum::supervise::StandIn;
use tectum::wire::{Ahead, Command, Learning, Observation, ProcessState, Role, Status};

use crate::LinkError;
use crate::connection::{Arrival, LinkConnection};
use crate::legs::LinkReport;
use crate::message::{AnswerMessage, LearningMessage, LockstepMessage, Message, ObservationMessage};
use crate::stand_in::{StandInSettings, await_report, mirror, say_done, say_farewell};

/// Longest wait for an observation while none is being answered.
const SLEEP: Duration = Duration::from_millis(20);
/// For how long the controller's answer is polled for without a sleep, ns: it mostly comes within that time.
const EAGER_NS: u64 = 300_000;
/// Interval at which it is polled for after that, ns.
const NAP_NS: u64 = 50_000;
/// For how long an answer is polled for at all before the loop sleeps until the next observation, ns.
const PATIENT_NS: u64 = 20_000_000;
/// In lockstep: after this time without an answer the controller gets the observation again, ns: it had died.
const REPEAT_NS: u64 = 500_000_000;
/// How often the loop looks around, ns.
const LOOK_NS: u64 = 20_000_000;
/// How long the plant's report may take, and the other machine to take the controller's.
const REPORT_LIMIT: Duration = Duration::from_secs(5);
/// Real time: how long observations that were sent may be under way when the plant has finished, ns.
const LAST_NS: u64 = 300_000_000;

/// How the ticks of the other run become ticks of this one.
#[derive(Debug, Clone, Copy)]
struct Numbering {
    run: u64,
    ticks: u64,
    sequences: u64,
}

/// The loop in progress.
struct ControllerSideLoop {
    connection: LinkConnection,
    session: Session,
    ports: PlantPorts,
    records: LogTail<Learning>,
    real: bool,
    numbering: Option<Numbering>,
    /// The observation that the controller had last, and when it came, ns.
    last: Option<(Observation, u64)>,
    /// Whether its answer, and its learning record, have come.
    answered: bool,
    command: Option<Command>,
    /// In lockstep: the answer, in case it is lost.
    answer: Option<LockstepMessage>,
    /// What came with the last command: commands for the ticks after it.
    ahead: Option<Box<Ahead>>,
    looked_ns: u64,
    given_ns: u64,
    peer_session: u64,
    report: LinkReport,
}

/// Takes the plant's place in the run until it is over.
///
/// # Errors
/// As for the plant's side.
pub fn stand_in(participant: Participant, settings: &StandInSettings) -> Result<(), LinkError> {
    let (mut ports, board) = participant.open(PlantPorts::open)?;
    if participant.plan.scenario.link.ahead > 0 {
        ports.open_ahead()?;
    }
    let mut records = LogTail::watch(&participant.manifest.domain, "learning")?;
    records.skip_to_newest(0);
    let connection = settings.connect(&participant, None)?;
    let first = board.incarnation == 0;
    let before = board.before;
    if first {
        settings.await_peer(&connection, &participant, &board)?;
    }
    let folder = participant.folder.clone();
    let (session, time) = participant.begin(board, || {
        let connected = ports.observation.connect()? >= 1 && ports.command.connect()? >= 1;
        if connected && first {
            say_ready(&connection, &folder);
        }
        Ok(connected && leave_start(&connection, &folder))
    })?;
    precise_timers();
    if !first {
        say_ready(&connection, &folder);
    }
    let report = LinkReport {
        side: settings.side.name(),
        address: settings.endpoint.text.clone(),
        key: settings.key.is_some(),
        ..LinkReport::default()
    };
    let mut controller_side = ControllerSideLoop {
        peer_session: connection.peer().map_or(0, |peer| peer.session),
        connection,
        session,
        ports,
        records,
        real: time.is_real(),
        numbering: None,
        last: None,
        answered: true,
        command: None,
        answer: None,
        ahead: None,
        looked_ns: 0,
        given_ns: 0,
        report,
    };
    (controller_side.session.status.sent, controller_side.session.status.ticks) = (before.sent, before.ticks);
    let outcome = controller_side.run().and_then(|early| controller_side.finish(early));
    if let Err(error) = &outcome {
        say_farewell(&controller_side.connection, &format!("the controller's machine ended its run: {error}"));
    }
    controller_side.write_report()?;
    outcome
}

/// Says that all processes on this machine have their ports, and how the agent's columns are called.
fn say_ready(connection: &LinkConnection, folder: &std::path::Path) {
    if connection.peer_says(|hello| hello.t0_ns.is_some()) == Some(true) {
        return;
    }
    let columns = tectum::runtime::read_columns(folder);
    connection.say(|own| (own.ready, own.columns) = (true, columns));
}

/// Leaves the start of tick 0 for the launcher, once the other machine has it. True when it is there.
fn leave_start(connection: &LinkConnection, folder: &std::path::Path) -> bool {
    let Some(Some(t0_ns)) = connection.peer_says(|hello| hello.t0_ns) else { return false };
    let Some(clock) = connection.offset() else { return false };
    // Without the file the launcher takes an instant of its own; only a full disk does that.
    let _ = std::fs::write(StandIn::start_path(folder), clock.to_own(t0_ns).to_string());
    true
}

impl ControllerSideLoop {
    /// Returns why the run ends before its last tick, if it does.
    fn run(&mut self) -> Result<Option<String>, LinkError> {
        let mut finished_ns = None;
        loop {
            let awaited = !self.answered && (!self.real || monotonic_ns() - self.given_ns < PATIENT_NS);
            match self.connection.receive(if awaited { Duration::ZERO } else { SLEEP }) {
                Some(arrival) => self.take(&arrival)?,
                None if awaited => self.rest(),
                None => {}
            }
            self.take_answers()?;
            let now = monotonic_ns();
            if now - self.looked_ns > LOOK_NS {
                self.looked_ns = now;
                if let Some(end) = self.look_around()? {
                    return Ok(end);
                }
            }
            if self.connection.board().is_some_and(|board| board.state() == ProcessState::Finished) {
                let since = *finished_ns.get_or_insert(now);
                let whole = self.connection.board().is_some_and(|board| board.sent <= self.report_sequence());
                if (whole || self.real && now - since > LAST_NS) && (self.answered || now - since > LAST_NS) {
                    return Ok(self.early());
                }
            }
        }
    }

    /// Observations that this run has had of the other one's current run.
    fn report_sequence(&self) -> u64 {
        let added = self.numbering.map_or(0, |numbering| numbering.sequences);
        self.last.map_or(0, |(last, _)| (last.header.sequence + 1).saturating_sub(added))
    }

    /// Why the plant's run is over before its last tick, if it is.
    fn early(&self) -> Option<String> {
        let added = self.numbering.map_or(0, |numbering| numbering.ticks);
        let done = self.connection.board().map_or(0, |board| board.ticks) + added;
        let scenario = &self.session.participant.plan.scenario;
        let text = || format!("the plant's machine ended its run at tick {done}, before the last one");
        (done < scenario.ticks && !scenario.is_endless()).then(text)
    }

    fn rest(&self) {
        // In lockstep the controller polls as well, and would take turns with this process.
        let eager = self.real && monotonic_ns() - self.given_ns < EAGER_NS;
        if eager { std::thread::yield_now() } else { pause(if self.real { NAP_NS } else { NAP_NS / 5 }) }
    }

    /// What needs to be done only now and then. `Some` when the run ends.
    fn look_around(&mut self) -> Result<Option<Option<String>>, LinkError> {
        self.session.check()?;
        self.ports.controller.set_incarnation(self.session.incarnation_of(Role::Controller))?;
        self.ports.logger.set_incarnation(self.session.incarnation_of(Role::Logger))?;
        self.session.publish_status();
        if self.answered {
            self.connection.send(&Message::Board(Box::new(self.ports.controller.get())));
        }
        if let Some(peer) = self.connection.peer() {
            self.report.sessions += u64::from(peer.session != self.peer_session);
            self.peer_session = peer.session;
            if let Some(text) = peer.hello.farewell {
                return Ok(Some(Some(text)));
            }
        }
        if self.session.stopping() {
            say_farewell(&self.connection, "the controller's machine ended the run");
            return Ok(Some(None));
        }
        if self.session.is_gone(Role::Controller) {
            return Ok(Some(Some("the controller ended before the run was over".to_owned())));
        }
        if !self.real && !self.answered && monotonic_ns() - self.given_ns > REPEAT_NS {
            self.report.repeated += 1;
            self.give_again()?;
        }
        Ok(None)
    }

    fn take(&mut self, arrival: &Arrival) -> Result<(), LinkError> {
        let Message::Observation(message) = &arrival.message else { return Ok(()) };
        let numbering = self.numbering_of(message)?;
        let mut observation = message.observation;
        let header = &mut observation.header;
        header.run = self.session.participant.manifest.run_id();
        header.tick += numbering.ticks;
        header.sequence += numbering.sequences;
        if let (true, Some(clock)) = (self.real, self.connection.offset()) {
            for instant in [&mut header.scheduled_ns, &mut header.sensed_ns, &mut header.published_ns] {
                *instant = clock.to_own(*instant);
            }
        }
        if let Some((last, _)) = &self.last
            && observation.header.tick <= last.header.tick
        {
            return self.take_again(&observation);
        }
        self.await_logger(&observation)?;
        self.last = Some((observation, arrival.at_ns));
        self.report.observations += 1;
        self.mirror(&message.status, &observation);
        self.give(&observation)?;
        self.ports.log.append(&observation);
        self.session.publish_status();
        Ok(())
    }

    /// An observation that came before. In lockstep its answer was lost, or is on its way.
    fn take_again(&mut self, observation: &Observation) -> Result<(), LinkError> {
        let tick = observation.header.tick;
        match self.answer {
            Some(answer) if answer.answer.command.header.tick == tick => {
                self.report.repeated += 1;
                self.connection.send(&Message::Lockstep(Box::new(answer), self.ahead.clone()));
            }
            _ => {}
        }
        Ok(())
    }

    /// How the ticks of the run that `message` comes from are counted here.
    fn numbering_of(&mut self, message: &ObservationMessage) -> Result<Numbering, LinkError> {
        let run = message.observation.header.run;
        if let Some(numbering) = self.numbering.filter(|numbering| numbering.run == run) {
            return Ok(numbering);
        }
        let status = self.session.status;
        let begun = self.numbering.is_some() || status.sent > message.observation.header.sequence + 1;
        if begun && !self.real {
            let text = "the plant's machine began another run; in lockstep none can go on with it";
            return Err(LinkError::Ended(text.to_owned()));
        }
        let (ticks, sequences) = if begun { (status.ticks + 1, status.sent) } else { (0, 0) };
        let numbering = Numbering { run, ticks, sequences };
        self.numbering = Some(numbering);
        Ok(numbering)
    }

    /// Shows the plant's numbers on its board in this run: never more samples than were handed on.
    fn mirror(&mut self, other: &Status, observation: &Observation) {
        mirror(&mut self.session, other);
        let ticks = self.numbering.map_or(0, |numbering| numbering.ticks);
        let status = &mut self.session.status;
        status.sent = observation.header.sequence + 1;
        status.ticks = observation.header.tick;
        status.checkpoint = if other.checkpoint == 0 { 0 } else { other.checkpoint + ticks };
        // Before the observation, because the controller takes its checkpoint after it.
        self.session.publish_status();
    }

    fn give(&mut self, observation: &Observation) -> Result<(), LinkError> {
        self.given_ns = monotonic_ns();
        (self.answered, self.command) = (false, None);
        self.ports.observation.send(observation)?;
        if self.real {
            self.ports.wake.notify();
        }
        Ok(())
    }

    /// Hands the last observation to a controller that may have died before it had it.
    fn give_again(&mut self) -> Result<(), LinkError> {
        let Some((observation, _)) = self.last else { return Ok(()) };
        self.give(&observation)
    }

    /// In lockstep: waits until the logger has room, so that no sample is lost.
    fn await_logger(&mut self, observation: &Observation) -> Result<(), LinkError> {
        let tick = observation.header.tick;
        while !self.real && self.ports.logger.get().consumed + (LOG_BUFFER as u64) < tick {
            self.session.check()?;
            if self.session.stopping() || self.session.is_gone(Role::Logger) {
                return Ok(());
            }
            self.ports.logger.set_incarnation(self.session.incarnation_of(Role::Logger))?;
            pause(NAP_NS);
        }
        Ok(())
    }

    /// Sends what the controller has answered.
    fn take_answers(&mut self) -> Result<(), LinkError> {
        while let Some(command) = self.ports.command.receive()? {
            self.take_ahead(&command)?;
            if self.real {
                self.send_command(&command);
            }
            self.command = Some(command);
        }
        while let Some(record) = self.records.receive() {
            if self.real {
                self.send_record(&record);
            } else if let Some(command) = self.command.filter(|c| c.header.tick == record.header.tick) {
                let answer = LockstepMessage { answer: self.answer_message(&command), learning: self.renumber(record) };
                self.connection.send(&Message::Lockstep(Box::new(answer), self.ahead.clone()));
                (self.answer, self.answered) = (Some(answer), true);
                self.report.commands += 1;
                self.report.learning_records += 1;
            }
        }
        Ok(())
    }

    /// Takes what came with `command`: it was sent just before.
    fn take_ahead(&mut self, command: &Command) -> Result<(), LinkError> {
        self.ahead = None;
        let Some(channel) = &self.ports.ahead else { return Ok(()) };
        while let Some(ahead) = channel.receive()? {
            if ahead.header.tick == command.header.tick {
                self.ahead = Some(Box::new(ahead));
            }
        }
        Ok(())
    }

    fn send_command(&mut self, command: &Command) {
        let message = self.answer_message(command);
        self.connection.send(&Message::Answer(Box::new(message), self.ahead.clone()));
        self.report.commands += 1;
    }

    fn answer_message(&self, command: &Command) -> AnswerMessage {
        let received_ns = self.last.map_or(0, |(_, at)| at);
        let mut command = *command;
        command.header.tick = command.header.tick.saturating_sub(self.numbering.map_or(0, |n| n.ticks));
        AnswerMessage { sent_ns: monotonic_ns(), received_ns, status: self.ports.controller.get(), command }
    }

    fn send_record(&mut self, record: &Learning) {
        let (status, learning) = (self.ports.controller.get(), self.renumber(*record));
        self.connection.send(&Message::Learning(Box::new(LearningMessage { status, learning })));
        self.report.learning_records += 1;
        self.answered |= self.last.is_some_and(|(last, _)| last.header.tick == record.header.tick);
    }

    /// The record with the tick of the other run.
    fn renumber(&self, mut record: Learning) -> Learning {
        record.header.tick = record.header.tick.saturating_sub(self.numbering.map_or(0, |n| n.ticks));
        record
    }

    /// The plant has finished: takes its report, and gives the controller's to the other machine.
    fn finish(&mut self, early: Option<String>) -> Result<(), LinkError> {
        let limit = if self.session.stopping() { Duration::ZERO } else { REPORT_LIMIT };
        if let Some(board) = self.connection.board() {
            let ticks = self.numbering.map_or(0, |numbering| numbering.ticks);
            mirror(&mut self.session, &board);
            self.session.status.ticks = board.ticks + ticks;
        }
        self.session.enter(ProcessState::Closing);
        let (session, connection) = (&self.session, &self.connection);
        let report = await_report(connection, limit, || Ok(session.check()?))?;
        let status = self.session.status;
        match report {
            Some(report) => self.session.finish(&report)?,
            // What its board showed last.
            None => self.session.finish(&PlantReport {
                ticks: status.sent,
                missed: status.missed,
                late: status.late,
                skipped: status.lost,
                ..PlantReport::default()
            })?,
        }
        self.ports.wake.notify();
        self.give_controllers_report()?;
        say_done(&self.connection, REPORT_LIMIT);
        early.map_or(Ok(()), |text| Err(LinkError::Ended(text)))
    }

    /// Waits for the end of the controller, and gives its report to the other machine.
    fn give_controllers_report(&mut self) -> Result<(), LinkError> {
        while self.ports.controller.get().state() != ProcessState::Finished {
            self.ports.controller.set_incarnation(self.session.incarnation_of(Role::Controller))?;
            match self.session.check() {
                Err(RuntimeError::Aborted) => return Ok(()),
                other => other?,
            }
            if self.session.is_gone(Role::Controller) {
                return Ok(());
            }
            pause(NAP_NS * 20);
        }
        if let Ok(report) = std::fs::read(self.session.participant.folder.join("controller.json")) {
            self.connection.set_report(report);
        }
        Ok(())
    }

    fn write_report(&mut self) -> Result<(), LinkError> {
        self.report.clock = self.connection.offset();
        self.report.refused = self.connection.counts();
        self.report.write(&self.session.participant.folder)
    }
}
