//! The plant's side of the tick, and its loop.

use hdrhistogram::Histogram;

use super::reports::{Percentiles, histogram};
use super::{Gate, PlantReport, RuntimeError, Seat, Session};
use crate::channel::{BoardReader, ChannelError, LOG_BUFFER, PlantPorts, Receiver};
use crate::clock::{Backoff, Wake, precise_timers};
use crate::plant::{Outcome, Plant};
use crate::policy::Outputs;
use crate::scenario::Plan;
use crate::state::{Ledger, Remember};
use crate::wire::{Command, MAX_OUTPUTS, Observation, Status, flag};

/// A body behind its gate: the plant's half of every tick, without clock and transport.
#[derive(Debug, Clone)]
pub struct PlantSide<P> {
    body: P,
    gate: Gate,
    outputs: usize,
    outcome: Outcome,
    applied: Outputs,
    flags: u32,
    /// Counts so far.
    pub report: PlantReport,
}

impl<P: Plant> PlantSide<P> {
    /// `body` behind the gate of `plan`.
    pub fn new(body: P, plan: &Plan) -> Self {
        let outputs = plan.outputs.len();
        Self {
            body,
            gate: Gate::new(&plan.scenario.gate, outputs),
            outputs,
            outcome: Outcome::default(),
            applied: [0.0; MAX_OUTPUTS],
            flags: flag::FIRST,
            report: PlantReport::default(),
        }
    }

    /// The body.
    pub fn body_mut(&mut self) -> &mut P {
        &mut self.body
    }

    /// Lives through `tick` with the command that arrived for it; `None` if it was missed.
    pub fn live(&mut self, tick: u64, command: Option<&Command>) {
        let applied = self.gate.pass(command.map(|c| &c.drawn));
        self.report.missed += u64::from(applied.flags & flag::MISSED != 0);
        self.report.clamped += u64::from(applied.flags & flag::CLAMPED != 0);
        self.report.non_finite += u64::from(applied.flags & flag::NON_FINITE != 0);
        self.applied = applied.command;
        self.flags = applied.flags;
        self.outcome = self.body.advance(tick, &applied.command[..self.outputs]);
    }

    /// Lives through the ticks from `tick` up to but without `until` that nobody had time for.
    pub fn skip(&mut self, tick: u64, until: u64) {
        for tick in tick..until {
            self.live(tick, None);
        }
        self.report.skipped += until - tick;
    }

    /// Senses at the beginning of `tick`. `more` are flags that the loop adds; `skipped` ticks were passed over.
    pub fn observe(&mut self, tick: u64, more: u32, skipped: u32, observation: &mut Observation) {
        let fresh = self.body.sense(tick, &mut observation.inputs);
        let skip = if skipped > 0 { flag::SKIPPED } else { 0 };
        let target = if fresh { flag::NEW_TARGET } else { 0 };
        observation.header.tick = tick;
        observation.header.flags = self.flags | more | skip | target;
        observation.applied = self.applied;
        observation.reward = self.outcome.reward;
        observation.measures = self.outcome.measures;
        observation.skipped = skipped;
        self.report.ticks += 1;
    }
}

impl<P: Plant> Remember for PlantSide<P> {
    fn remember(&mut self, ledger: &mut dyn Ledger) {
        ledger.part("body", &mut self.body);
        ledger.part("gate", &mut self.gate);
        ledger.number("reward", &mut self.outcome.reward);
        ledger.numbers("measures", &mut self.outcome.measures);
        ledger.numbers("applied", &mut self.applied);
        ledger.number("flags", &mut self.flags);
        ledger.part("report", &mut self.report);
    }
}

/// Takes commands off the channel and sorts them by tick.
struct Inbox<'a> {
    channel: &'a Receiver<Command>,
    found: Option<Command>,
    late: u64,
    failure: Option<ChannelError>,
    answered: &'a mut Histogram<u64>,
    real: bool,
}

impl Inbox<'_> {
    /// Whether the command of `tick` is there. Older ones are counted as late and dropped.
    fn look_for(&mut self, tick: u64) -> bool {
        loop {
            match self.channel.receive() {
                Ok(None) => return self.found.is_some(),
                Ok(Some(command)) => {
                    if self.real {
                        // The command carries the instant at which its observation had been sensed.
                        let header = &command.header;
                        self.answered.saturating_record(header.published_ns.saturating_sub(header.sensed_ns));
                    }
                    if command.header.tick == tick {
                        self.found = Some(command);
                    } else {
                        self.late += 1;
                    }
                }
                Err(error) => {
                    // The wait must end; the loop tells the error.
                    self.failure = Some(error);
                    return true;
                }
            }
        }
    }
}

/// Ticks between two looks at how far the logger is. In lockstep the plant never runs further ahead of it than its
/// buffer, so that nothing overflows: the logger is inside the barrier, at the price of one look in so many ticks.
const CREDIT: u64 = LOG_BUFFER as u64 / 4;

/// The plant's loop: seats `body` in the run and lives through it.
///
/// # Errors
/// When the process does not fit the run, or the run ends in disorder.
pub fn run_plant<P: Plant>(seat: Seat, body: P) -> Result<PlantReport, RuntimeError> {
    let (ports, desk) = seat.open(PlantPorts::open)?;
    // Readers of the observation: controller and logger. Writer of the command: the controller.
    let connected = || Ok(ports.observation.connect()? >= 2 && ports.command.connect()? >= 1);
    let (mut session, mut time) = seat.begin(desk, connected)?;
    precise_timers();

    let real = time.is_real();
    let ticks = session.seat.plan.scenario.ticks;
    let mut side = PlantSide::new(body, &session.seat.plan);
    let (mut wake_up, mut answered, mut work) = (histogram(), histogram(), histogram());
    let mut inbox =
        Inbox { channel: &ports.command, found: None, late: 0, failure: None, answered: &mut answered, real };
    let mut observation = Observation::default();
    observation.header.run = session.seat.card.run_id();
    observation.header.incarnation = session.incarnation();

    let mut tick = 0;
    loop {
        let wake = time.await_tick(
            tick,
            || tick == 0 || inbox.look_for(tick - 1),
            // In real time a tick may be a second away; stepped, the answer to the last observation is under way.
            || if real { session.end().is_some() } else { session.must_end() },
        );
        if wake == Wake::Cancelled {
            break;
        }
        let woken = time.now();
        let late_before = side.report.late;
        if tick > 0 {
            inbox.look_for(tick - 1);
            if let Some(error) = inbox.failure.take() {
                return Err(error.into());
            }
            side.live(tick - 1, inbox.found.take().as_ref());
            side.report.late = inbox.late;
        }
        // Whoever wakes up a period late or more passes ticks over; never makes them up in a burst.
        let due = time.due().min(ticks).max(tick);
        if real {
            let now = time.now();
            for tick in tick..=due {
                wake_up.saturating_record(now.saturating_sub(time.scheduled(tick)));
            }
        }
        side.skip(tick, due);
        let skipped = due - tick;
        tick = due;
        session.status.ticks = tick;
        session.status.missed = side.report.missed;
        session.status.late = side.report.late;
        session.status.lost = side.report.skipped;
        session.show();
        if tick >= ticks || session.stopping() {
            break;
        }
        if !real && tick.is_multiple_of(CREDIT) && !await_credit(&ports.logger, &session, tick) {
            break;
        }

        let late = if side.report.late > late_before { flag::LATE } else { 0 };
        side.observe(tick, late, u32::try_from(skipped).unwrap_or(u32::MAX), &mut observation);
        observation.header.scheduled_ns = time.scheduled(tick);
        observation.header.sensed_ns = time.now();
        observation.header.published_ns = time.now();
        ports.observation.send(&observation)?;
        if real {
            ports.bell.ring();
            work.saturating_record(time.now().saturating_sub(woken));
        }
        observation.header.sequence += 1;
        session.status.sent = observation.header.sequence;
        tick += 1;
    }
    session.show();
    session.check()?;
    if real {
        side.report.wake_up = Percentiles::of(&wake_up);
        side.report.observation_to_command = Percentiles::of(&answered);
        side.report.work = Percentiles::of(&work);
    }
    session.finish(&side.report)?;
    // Whoever listens for another observation finds that there is none.
    ports.bell.ring();
    Ok(side.report)
}

/// Waits until the logger has room for the next [`CREDIT`] ticks. False when the run is to end first.
fn await_credit(logger: &BoardReader<Status>, session: &Session, tick: u64) -> bool {
    let mut backoff = Backoff::default();
    while logger.get().consumed + (LOG_BUFFER as u64) < tick + CREDIT {
        if backoff.pause() && session.end().is_some() {
            return false;
        }
    }
    true
}
