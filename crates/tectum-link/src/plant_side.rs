//! The plant's machine: takes the controller's place in its run.
//!
//! It sends each observation to the other machine, and hands the commands and learning records that come back to plant
//! and logger. In real time nothing is sent twice: a command that does not come in time is missed, as one of a
//! controller that is late, and the gate beside the plant holds, decays and stops. In lockstep the last observation is
//! sent again until its answer has come.

use std::collections::VecDeque;
use std::time::Duration;

use tectum::channel::{ControllerPorts, WakeNotifier};
use tectum::clock::{monotonic_ns, precise_timers};
use tectum::runtime::{ControllerReport, Participant, Session};
use tectum::wire::{Ahead, Command, Header, Learning, Observation, ProcessState, Role, Status};

use crate::LinkError;
use crate::connection::{Arrival, LinkConnection};
use crate::legs::{Instants, Legs, LinkReport};
use crate::message::{AnswerMessage, Message, ObservationMessage};
use crate::stand_in::{StandInSettings, await_report, mirror, say_done, say_farewell};

/// Longest sleep without an observation or a command.
const SLEEP: Duration = Duration::from_millis(20);
/// The same in lockstep.
const LOCKSTEP_SLEEP: Duration = Duration::from_micros(50);
/// How often the loop looks around, ns.
const LOOK_NS: u64 = 2_000_000;
/// From one board to the next when nothing else is sent, ns.
const BOARD_NS: u64 = 50_000_000;
/// In lockstep: after this time without an answer the observation is sent again, ns; at least two round trips.
const REPEAT_NS: u64 = 5_000_000;
/// Headers of observations that are remembered for their answers.
const REMEMBERED: usize = 256;
/// In real time: how long the answer to the last observation is waited for, ns.
const LAST_ANSWER_NS: u64 = 1_000_000_000;
/// How long the controller's report may take after the last tick.
const REPORT_LIMIT: Duration = Duration::from_secs(20);
/// The same when a signal ends the run: the launcher waits for no more.
const REPORT_LIMIT_STOPPED: Duration = Duration::from_millis(400);

/// An observation that was sent.
struct Asked {
    header: Header,
    sent_ns: u64,
}

/// The loop in progress.
struct PlantSideLoop {
    connection: LinkConnection,
    session: Session,
    ports: ControllerPorts,
    real: bool,
    asked: VecDeque<Asked>,
    /// The observation that waits for its answer, in lockstep.
    unanswered: Option<ObservationMessage>,
    /// Commands handed to the plant.
    sent: u64,
    /// The next tick whose command counts.
    next_tick: u64,
    /// The next tick whose learning record counts.
    next_record: u64,
    /// The other run, and what is added to its sequence numbers so that they go on here.
    numbering: Option<(u64, u64)>,
    peer_session: u64,
    boarded_ns: u64,
    looked_ns: u64,
    legs: Legs,
    report: LinkReport,
}

/// Takes the controller's place in the run until it is over.
///
/// # Errors
/// When the other machine does not come, does not fit or ends the run, or the run on this machine ends abnormally.
pub fn stand_in(participant: Participant, settings: &StandInSettings) -> Result<(), LinkError> {
    let (mut ports, board) = participant.open(ControllerPorts::open)?;
    if participant.plan.scenario.link.ahead > 0 {
        ports.open_ahead()?;
    }
    let wake = WakeNotifier::open(&participant.manifest.domain)?;
    let connection = settings.connect(&participant, Some(wake))?;
    let (before, first) = (board.before, board.incarnation == 0);
    if first {
        settings.await_peer(&connection, &participant, &board)?;
        leave_columns(&participant, &connection)?;
    }
    let ready = || connection.peer_says(|hello| hello.ready) == Some(true);
    let connected = || Ok(ports.observation.connect()? >= 1 && ports.command.connect()? >= 1 && ready());
    let (session, time) = participant.begin(board, connected)?;
    precise_timers();
    connection.say(|own| own.t0_ns = Some(time.scheduled(0)));
    ports.plant.set_incarnation(session.incarnation_of(Role::Plant))?;
    let report = LinkReport {
        side: settings.side.name(),
        address: settings.endpoint.text.clone(),
        key: settings.key.is_some(),
        ..LinkReport::default()
    };
    let mut plant_side = PlantSideLoop {
        peer_session: connection.peer().map_or(0, |peer| peer.session),
        connection,
        session,
        ports,
        real: time.is_real(),
        asked: VecDeque::new(),
        unanswered: None,
        sent: before.sent,
        next_tick: if before.sent > 0 { before.ticks } else { 0 },
        next_record: if before.sent > 0 { before.ticks } else { 0 },
        numbering: None,
        boarded_ns: 0,
        looked_ns: 0,
        legs: Legs::default(),
        report,
    };
    let outcome = plant_side.run().and_then(|()| plant_side.finish());
    if let Err(error) = &outcome {
        say_farewell(&plant_side.connection, &format!("the plant's machine ended its run: {error}"));
    }
    plant_side.write_report()?;
    outcome
}

/// Leaves the names of the agent's columns for the logger, which reads them before the first tick.
fn leave_columns(participant: &Participant, connection: &LinkConnection) -> Result<(), LinkError> {
    let columns = connection.peer_says(|hello| hello.columns.clone()).unwrap_or_default();
    if columns.is_empty() {
        return Ok(());
    }
    let path = participant.folder.join("controller.columns.json");
    let text = serde_json::to_string(&columns).unwrap_or_default();
    std::fs::write(&path, text).map_err(|cause| LinkError::File { path, cause })
}

impl PlantSideLoop {
    fn run(&mut self) -> Result<(), LinkError> {
        let mut finished_ns = None;
        loop {
            // In lockstep the plant wakes nobody. It polls for the command meanwhile, so that a second process that
            // only yields would take the network's core.
            self.ports.wake.wait(if self.real { SLEEP } else { LOCKSTEP_SLEEP });
            // Read before the channel is, so that nothing that was sent before is left.
            let finished =
                self.ports.plant.get().state() == ProcessState::Finished || self.session.is_gone(Role::Plant);
            let mut any = false;
            while let Some(arrival) = self.connection.receive(Duration::ZERO) {
                any = true;
                self.take(&arrival)?;
            }
            while let Some(observation) = self.ports.observation.receive()? {
                any = true;
                self.send_observation(&observation);
            }
            if monotonic_ns() - self.looked_ns > LOOK_NS {
                self.looked_ns = monotonic_ns();
                self.look_around()?;
            }
            if finished && !any {
                let since = *finished_ns.get_or_insert_with(monotonic_ns);
                let answered = self.asked.back().is_none_or(|last| last.header.tick < self.next_record);
                let patience = if self.real { LAST_ANSWER_NS } else { u64::MAX };
                let ends = self.session.stopping() || monotonic_ns() - since > patience;
                if answered || ends {
                    return Ok(());
                }
            }
        }
    }

    /// What needs to be done only now and then.
    fn look_around(&mut self) -> Result<(), LinkError> {
        self.session.check()?;
        self.ports.plant.set_incarnation(self.session.incarnation_of(Role::Plant))?;
        let now = monotonic_ns();
        if now - self.boarded_ns > BOARD_NS {
            self.boarded_ns = now;
            self.connection.send(&Message::Board(Box::new(self.ports.plant.get())));
            if let Some(board) = self.connection.board() {
                mirror(&mut self.session, &board);
            }
            self.session.publish_status();
            let Some(peer) = self.connection.peer() else { return Ok(()) };
            self.report.sessions += u64::from(peer.session != self.peer_session);
            self.peer_session = peer.session;
            if let Some(text) = peer.hello.farewell {
                return Err(LinkError::Ended(text));
            }
        }
        let round_trip = self.connection.offset().map_or(0, |offset| offset.round_trip_ns);
        let since = self.asked.back().map_or(0, |asked| now - asked.sent_ns);
        if since > REPEAT_NS.max(2 * round_trip)
            && let Some(message) = self.unanswered
        {
            self.report.repeated += 1;
            self.send_message(message);
        }
        Ok(())
    }

    fn send_observation(&mut self, observation: &Observation) {
        let status = self.ports.plant.get();
        let message = ObservationMessage { sent_ns: 0, status, observation: *observation };
        self.report.observations += 1;
        if !self.real {
            self.unanswered = Some(message);
        }
        self.send_message(message);
    }

    fn send_message(&mut self, message: ObservationMessage) {
        let sent_ns = monotonic_ns();
        let header = message.observation.header;
        self.connection.send(&Message::Observation(Box::new(ObservationMessage { sent_ns, ..message })));
        if self.asked.len() == REMEMBERED {
            self.asked.pop_front();
        }
        self.asked.retain(|asked| asked.header.tick != header.tick);
        self.asked.push_back(Asked { header, sent_ns });
    }

    fn take(&mut self, arrival: &Arrival) -> Result<(), LinkError> {
        match &arrival.message {
            Message::Answer(answer, ahead) => {
                self.take_command(answer, ahead.as_deref(), arrival.at_ns)?;
                self.show(&answer.status);
            }
            Message::Learning(message) => {
                self.take_record(&message.learning)?;
                self.show(&message.status);
            }
            Message::Lockstep(message, ahead) => {
                let answered = self
                    .unanswered
                    .is_some_and(|asked| asked.observation.header.tick == message.answer.command.header.tick);
                if answered {
                    self.unanswered = None;
                }
                // The record first, because the plant goes on with the command.
                self.take_record(&message.learning)?;
                self.take_command(&message.answer, ahead.as_deref(), arrival.at_ns)?;
                self.show(&message.answer.status);
            }
            _ => {}
        }
        Ok(())
    }

    /// Puts the controller's numbers on its board in this run.
    fn show(&mut self, other: &Status) {
        mirror(&mut self.session, other);
        (self.session.status.sent, self.session.status.ticks) = (self.sent, self.next_tick);
        self.session.publish_status();
    }

    /// The sequence number in this run of the other run's number. Another run, which began anew on the other machine,
    /// goes on where the one before stopped.
    fn number(&mut self, other: u64) -> u64 {
        let run = self.connection.peer().map_or(0, |peer| peer.hello.run);
        let added = match self.numbering {
            _ if !self.real => 0,
            Some((known, added)) if known == run => added,
            _ => self.sent.saturating_sub(other),
        };
        self.numbering = Some((run, added));
        other + added
    }

    fn take_command(&mut self, answer: &AnswerMessage, ahead: Option<&Ahead>, at_ns: u64) -> Result<(), LinkError> {
        let tick = answer.command.header.tick;
        let Some(asked) = self.asked.iter().find(|asked| asked.header.tick == tick) else { return Ok(()) };
        let (asked, sent_ns) = (asked.header, asked.sent_ns);
        let again = tick < self.next_tick;
        if again && (self.real || tick + 1 < self.next_tick) {
            return Ok(());
        }
        let mut command: Command = answer.command;
        command.header = self.header(&asked, &answer.command.header);
        if let (Some(channel), Some(ahead)) = (&self.ports.ahead, ahead) {
            channel.send(&Ahead { header: Header { flags: 0, ..command.header }, ..*ahead })?;
        }
        self.ports.command.send(&command)?;
        let given = monotonic_ns();
        if again {
            // The plant asked again: this process or the plant had died, and it may lack this command.
            return Ok(());
        }
        self.ports.command_log.append(&command);
        self.sent = command.header.sequence + 1;
        self.next_tick = tick + 1;
        self.report.commands += 1;
        if let (true, Some(clock)) = (self.real, self.connection.offset()) {
            let (received_there, sent_there) = (clock.to_own(answer.received_ns), clock.to_own(answer.sent_ns));
            let published = asked.published_ns;
            let received = at_ns;
            self.legs.record(&Instants { published, sent: sent_ns, received_there, sent_there, received, given });
        }
        Ok(())
    }

    fn take_record(&mut self, learning: &Learning) -> Result<(), LinkError> {
        let tick = learning.header.tick;
        let Some(asked) = self.asked.iter().find(|asked| asked.header.tick == tick) else { return Ok(()) };
        let asked = asked.header;
        if tick < self.next_record {
            return Ok(());
        }
        let mut record = *learning;
        record.header = self.header(&asked, &learning.header);
        self.ports.learning_log.append(&record);
        self.ports.learning.send_if_read(&record)?;
        self.next_record = tick + 1;
        self.report.learning_records += 1;
        Ok(())
    }

    /// The header in this run of an answer to the observation `asked`: its instants on this machine's clock.
    fn header(&mut self, asked: &Header, other: &Header) -> Header {
        let published_ns = match self.connection.offset() {
            // Within the uncertainty, the instant could lie before that of the observation.
            Some(clock) if self.real => clock.to_own(other.published_ns).max(asked.published_ns),
            _ => other.published_ns,
        };
        Header {
            run: self.session.participant.manifest.run_id(),
            tick: other.tick,
            sequence: self.number(other.sequence),
            scheduled_ns: asked.scheduled_ns,
            sensed_ns: asked.sensed_ns,
            published_ns,
            incarnation: self.session.incarnation(),
            flags: other.flags,
        }
    }

    /// The plant has finished: gives its report to the other machine, and takes the controller's.
    fn finish(&mut self) -> Result<(), LinkError> {
        self.session.enter(ProcessState::Closing);
        self.connection.send(&Message::Board(Box::new(self.ports.plant.get())));
        if let Ok(report) = std::fs::read(self.session.participant.folder.join("plant.json")) {
            self.connection.set_report(report);
        }
        let limit = if self.session.stopping() { REPORT_LIMIT_STOPPED } else { REPORT_LIMIT };
        let (session, connection, plant) = (&self.session, &self.connection, &self.ports.plant);
        let mut boarded = 0;
        let report = await_report(connection, limit, || {
            if monotonic_ns() - boarded > BOARD_NS {
                boarded = monotonic_ns();
                connection.send(&Message::Board(Box::new(plant.get())));
            }
            Ok(session.check()?)
        })?;
        match report {
            Some(report) => self.session.finish(&report)?,
            // What its board showed last.
            None => self.session.finish(&ControllerReport {
                ticks: self.sent,
                unseen: self.session.status.lost,
                ..ControllerReport::default()
            })?,
        }
        say_done(&self.connection, Duration::from_millis(500));
        Ok(())
    }

    fn write_report(&mut self) -> Result<(), LinkError> {
        self.report.commands_lost = self.report.observations.saturating_sub(self.report.commands);
        self.report.clock = self.connection.offset();
        self.report.refused = self.connection.counts();
        self.report.legs = self.legs.percentiles();
        self.report.write(&self.session.participant.folder)
    }
}
