//! The plant on servos: one synchronous read at the beginning of a tick, one synchronous write when its command
//! arrives.
//!
//! *Measured and modelled quantities.* Angles are measured. The position of the end-effector is computed from
//! the measured angles with the model in `[plant.arm]`, and error and reward from that position; the
//! end-effector itself is not measured. The model is used only for reward and measures; targets are drawn as in
//! the simulator. The speed in the reward is the measured one, because a motor lags behind its goal. An ideal
//! chain of servos has the same reward as the simulator, within the resolution of the servos.
//!
//! *Vision.* With `sight = "vision"`, trackers report target and end-effector, and error and reward are
//! computed from these. The model is then used only for segments that cross. Without a recent sample the arm is
//! [blind](flag::BLIND): it holds its position with torque on, nothing is learned, and it continues with the
//! next recent sample. Torque does not come on before the first one.
//!
//! *A leader.* With `[plant.leader]` the arm follows another one that a user moves by hand (`leader`). There is no
//! model then, and the error is the difference of angles.
//!
//! *Joints that are held.* Joints in `held` are no outputs: they keep the position at which torque came on.
//!
//! *Virtual time.* With emulated servos in the bridge's own process and a clock that ticks step, a run in lockstep is a
//! function of scenario and seed.
//!
//! *Motors and outputs.* A motor turns a segment relative to the previous one. With `angles = "absolute"` the
//! inputs are the directions of the segments, running sums of the motors' angles, and a motor's rate is the
//! difference of two outputs. Limits apply to motors: if a motor would exceed its `max_speed`, all rates are
//! scaled by the same factor; a motor that would leave its `range` moves to the end of it. The observation
//! reports the command after these limits as the applied one.
//!
//! *Bus time.* Each instruction is limited by the bus's [`BusBudget`], whatever the bus does. A tick has one
//! read and one write. There are more instructions only when a servo reports an error, when torque comes on,
//! and every 20 ticks, to check that torque is on. Both durations are measures: `bus_read_us`, `bus_write_us`.

mod chain;
mod checks;
mod leader;
mod limits;
mod motors;
mod presence;
mod report;
mod safety;
mod task;
mod vision;

pub use checks::{BridgeError, joints_of};
pub(crate) use checks::{check_registers, read_kept};
pub use report::{BridgeReport, TripEvent};
pub use safety::{DriveCommand, RECOVERY, SafetyMachine, SafetyState, TripCause};
pub use vision::VisionReport;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use hdrhistogram::Histogram;
use tectum_core::angle::wrap_f64;

use super::bus::{Bus, BusBudget, BusError};
use super::emulator::SteppedClock;
use crate::plant::{JointState, Outcome, Plant};

use crate::scenario::{Angles, JointConfig, LeaderConfig, Plan, ServosConfig};
use crate::state::{Persist, StateVisitor};
use crate::stats::histogram;
use crate::wire::{MAX_MEASURES, MAX_OUTPUTS, OutputValues, Vision, flag};
use task::ArmTask;
use vision::VisionInput;

/// Ticks over which commands grow after torque came on, if the gate has no ramp.
const RAMP: u32 = 20;

/// Interval between checks that torque is still on, ticks.
const TORQUE_CHECK_INTERVAL: u64 = 20;

/// The source of trackers' samples: returns the next sample, if there is one.
pub type VisionSource = Box<dyn FnMut() -> Option<Vision>>;

/// Maximum number of samples that are received in a tick: the buffers of eight trackers.
const MAX_SAMPLES_PER_TICK: usize = 32;

/// The plant on servos.
pub struct Bridge {
    bus: Bus,
    config: ServosConfig,
    joints: Vec<JointConfig>,
    ids: Vec<u8>,
    /// Number of joints that commands move, the first ones; the others are held.
    moving: usize,
    task: ArmTask,
    angles: Angles,
    /// Number of the task's measures.
    measures: usize,
    /// rad/s for a command of 1.
    gain: f32,
    /// Length of a tick, s.
    period: f32,
    /// Time for which the command of a tick is awaited, ns after its beginning.
    command_within: u64,
    safety: SafetyMachine,
    /// Largest command of each output.
    max_command: OutputValues,
    /// Ticks over which commands grow to the largest one after torque came on.
    ramp: u32,
    /// Ticks since torque came on.
    torque_ticks: u32,
    /// Angles of the motors, rad.
    motors: [f64; MAX_OUTPUTS],
    /// Angles of the outputs, rad.
    theta: OutputValues,
    /// Positions of the motors, steps.
    raw: [i32; MAX_OUTPUTS],
    /// Whether the last read failed.
    read_failed: bool,
    /// Why the first read since the last good one failed: which servo, and what came instead of its answer.
    silence: Option<BusError>,
    /// The trackers' samples, if the scenario uses them.
    vision: Option<VisionInput>,
    vision_source: Option<VisionSource>,
    leader_config: Option<LeaderConfig>,
    /// The leader's chain, if the scenario has one.
    leader: Option<leader::Leader>,
    /// In virtual time: the clock, and the time of tick 0, ns, when it has begun.
    stepped: Option<(SteppedClock, Option<u64>)>,
    /// The outcome of the last tick with vision.
    last_outcome: Outcome,
    /// Positions of the motors when the arm began to hold its position, steps.
    hold_position: Option<[i32; MAX_OUTPUTS]>,
    /// Positions of the motors when torque came on, steps.
    held_at: Option<[i32; MAX_OUTPUTS]>,
    /// Duration of the tick's writes, ns.
    write_ns: u64,
    /// What tells the bridge that the line, the machine or the guard is still there.
    presence: presence::Presence,
    /// Set to request arming.
    arm_request: Arc<AtomicBool>,
    /// Shows a message to the user.
    notify: Box<dyn FnMut(&str)>,
    /// Counts so far.
    pub report: BridgeReport,
    /// Ticks between two writes of the report.
    report_interval: u64,
    /// Durations of reads and writes, ns.
    times: [Histogram<u64>; 2],
    /// The counts of the run's earlier bridges.
    earlier: BridgeReport,
    /// File for the report.
    report_file: Option<report::ReportFile>,
}

impl Bridge {
    /// The plant of `plan` on `bus`. Turns torque off, which a killed bridge may have left on, and otherwise
    /// only reads. Messages for the user go to `notify`.
    ///
    /// # Errors
    /// When the plan has no servos, or the servos of the bus are not those of the plan.
    pub fn new(
        plan: &Plan,
        mut bus: Bus,
        joints: Vec<JointConfig>,
        notify: Box<dyn FnMut(&str)>,
    ) -> Result<Self, BridgeError> {
        let plant = &plan.scenario.plant;
        let (Some(config), Some(task)) = (&plant.servos, ArmTask::new(plan)) else { return Err(BridgeError::NoServos) };
        // Before any check: an open port keeps the guard of a killed bridge from turning torque off, and the
        // checks may fail.
        bus.torque_off(&joints.iter().map(|joint| joint.id).collect::<Vec<_>>());
        checks::patiently(&mut bus, |bus| checks::identify(bus, &joints))?;
        let period_s = plan.scenario.period_ms / 1000.0;
        let within_ms = config.command_within_ms.unwrap_or(plan.scenario.period_ms / 2.0);
        let mut bridge = Self {
            ids: joints.iter().map(|joint| joint.id).collect(),
            moving: joints.iter().filter(|joint| !config.held.contains(&joint.id)).count(),
            task,
            angles: ArmTask::angles(plan),
            measures: ArmTask::measures(plan),
            gain: ArmTask::gain(plan),
            period: period_s as f32,
            command_within: (within_ms * 1e6) as u64,
            safety: SafetyMachine::new(config.lost_after, config.rearm.is_automatic()),
            max_command: std::array::from_fn(|i| plan.scenario.gate.max_command.of(i) as f32),
            ramp: match plan.scenario.gate.ramp_ticks {
                0 => RAMP,
                ticks => ticks,
            },
            torque_ticks: 0,
            motors: [0.0; MAX_OUTPUTS],
            theta: [0.0; MAX_OUTPUTS],
            raw: [0; MAX_OUTPUTS],
            read_failed: false,
            silence: None,
            vision: (!config.sight.is_model()).then(|| VisionInput::new(config, plan.period_ns)),
            vision_source: None,
            leader_config: plant.leader.clone(),
            leader: None,
            stepped: None,
            last_outcome: Outcome::default(),
            hold_position: None,
            held_at: None,
            write_ns: 0,
            presence: presence::Presence::new(plan.period_ns, config.reopen_within_ns()),
            arm_request: Arc::default(),
            notify,
            report: BridgeReport::default(),
            report_interval: (1_000_000_000 / plan.period_ns.max(1)).max(1),
            times: [histogram(), histogram()],
            earlier: BridgeReport::default(),
            report_file: None,
            config: config.clone(),
            joints,
            bus,
        };
        bridge.measured()?;
        bridge.task.stands(&bridge.theta);
        Ok(bridge)
    }

    /// Lets the ticks step `clock`, which is the clock of the bus: a tick lasts a period from the first one on.
    pub fn set_virtual_time(&mut self, clock: SteppedClock) {
        self.stepped = Some((clock, None));
    }

    /// In virtual time: steps the clock to the beginning of `tick`.
    fn step_to(&mut self, tick: u64) {
        let Some((clock, start)) = &mut self.stepped else { return };
        let period_ns = self.presence.period();
        let start = *start.get_or_insert(clock.now().saturating_sub(tick * period_ns));
        clock.step_to(start + tick * period_ns);
    }

    /// Sets the source of trackers' samples, for a scenario with `sight = "vision"`. Without a source there is
    /// no vision.
    pub fn set_vision_source(&mut self, source: VisionSource) {
        self.vision_source = Some(source);
    }

    /// The bus budget of a tick of `plan`.
    pub fn budget(plan: &Plan) -> BusBudget {
        BusBudget::of(plan.period_ns)
    }

    /// A flag that requests arming. The bridge reads and clears it once per tick.
    pub fn arm_request(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.arm_request)
    }

    /// The state of the safety machine.
    pub fn state(&self) -> SafetyState {
        self.safety.state()
    }

    /// Does all checks before torque, sets modes and limits of the servos, and arms. Torque comes on with the
    /// first command.
    ///
    /// # Errors
    /// When a check fails; the bridge is then not armed.
    pub fn arm(&mut self) -> Result<(), BridgeError> {
        self.measured()?;
        checks::prepare(&mut self.bus, &self.joints, self.config.goal(), &self.motors)?;
        self.safety.arm();
        Ok(())
    }

    /// Arms, and tries again for a second while servos are silent. For the time before the first tick.
    ///
    /// # Errors
    /// As for [`Bridge::arm`].
    pub fn arm_patiently(&mut self) -> Result<(), BridgeError> {
        let until = self.bus.now() + checks::PATIENCE;
        loop {
            match self.arm() {
                Err(error) if error.is_silence() && self.bus.now() < until => {}
                armed => return armed,
            }
        }
    }

    /// Measures; a read that fails is an error.
    fn measured(&mut self) -> Result<(), BridgeError> {
        match self.measure().0 {
            Some(_) => Ok(()),
            None => Err(BridgeError::NoAnswer(self.silence.as_ref().map_or_else(String::new, BusError::to_string))),
        }
    }

    /// Receives samples of trackers at the beginning of `tick`. Their number is limited, so that a tracker that
    /// floods the channel does not delay the tick.
    fn update_vision(&mut self, tick: u64) {
        let Some(vision) = &mut self.vision else { return };
        let now = self.bus.now();
        let mut next = || self.vision_source.as_mut().and_then(|source| source());
        for sample in std::iter::from_fn(&mut next).take(MAX_SAMPLES_PER_TICK) {
            vision.receive(&sample, now);
        }
        if vision.begin_tick(now) {
            let text = match (vision.sees, vision.latest_age) {
                (true, _) => "target and end-effector are seen".to_owned(),
                (false, age) => format!(
                    "nothing is seen any more: the newest sample of a tracker is {} ms old; the arm stands still",
                    age.unwrap_or_default() / 1_000_000
                ),
            };
            (self.notify)(&format!("tick {tick}: {text}"));
        }
    }

    /// Whether what the task needs besides the arm is known: vision, a leader, or nothing.
    fn sees(&self) -> bool {
        self.vision.as_ref().is_none_or(|vision| vision.sees) && self.knows_leader()
    }

    /// The outcome of a tick. With trackers it is computed from their samples, or, without vision, it is that
    /// of the last tick with vision.
    fn outcome(&mut self, tick: u64, rates: &[f32]) -> Outcome {
        let Some(vision) = &self.vision else { return self.task.measured(tick, &self.theta, rates, None) };
        if vision.sees {
            self.last_outcome = self.task.measured(tick, &self.theta, rates, Some(vision.end()));
        } else {
            self.task.stands(&self.theta);
        }
        self.last_outcome
    }

    /// Arms the bridge if that was requested. Returns whether it was armed, and so checked, in this tick.
    fn arm_on_request(&mut self, tick: u64) -> bool {
        if !self.arm_request.swap(false, Ordering::Relaxed) || self.safety.state() == SafetyState::Driving {
            return false;
        }
        let armed = self.arm();
        if let Err(error) = &armed {
            (self.notify)(&format!("tick {tick}: not armed: {error}"));
        }
        armed.is_ok()
    }

    /// Turns torque on, after the checks unless they were done in this tick. After a loss of bus or power, or
    /// if the arm may have been moved, all checks are repeated. Trips and returns false when that fails.
    fn start(&mut self, tick: u64, checked: bool) -> bool {
        let result = if checked {
            Ok(())
        } else {
            checks::prepare(&mut self.bus, &self.joints, self.config.goal(), &self.motors)
        };
        if let Err(error) = &result {
            (self.notify)(&format!("tick {tick}: {error}"));
        }
        let cause = match result {
            // The guard watches from here on.
            Ok(()) => (!self.beat(true) || !self.turn_torque_on()).then_some(TripCause::BusLost),
            // A servo that does not answer has not refused.
            Err(error) if error.is_silence() => Some(TripCause::BusLost),
            Err(_) => Some(TripCause::Refused),
        };
        if let Some(cause) = cause {
            self.safety.trip(cause);
        }
        cause.is_none()
    }

    /// Follows the command: limits it and writes the motors' goals. Returns the flags of what was limited.
    fn follow(&mut self, applied: &mut [f32], first: bool) -> u32 {
        self.torque_ticks = if first { 0 } else { self.torque_ticks.saturating_add(1) };
        let mut flags = self.limit_to_ramp(applied);
        let (rates, limited) = self.limit_to_motors(applied);
        flags |= limited;
        if !self.write_goals(&rates) {
            self.report.unwritten += 1;
            self.safety.trip(TripCause::BusLost);
            applied.fill(0.0);
            flags |= flag::TRIPPED;
        }
        flags
    }

    /// Keeps torque off, and returns the flag of the reason.
    fn stay_off(&mut self, applied: &mut [f32]) -> u32 {
        applied.fill(0.0);
        if self.safety.state() != SafetyState::ReadOnly {
            self.turn_torque_off();
        }
        self.report.count_without_torque(self.safety.state());
        if matches!(self.safety.state(), SafetyState::Tripped(_)) { flag::TRIPPED } else { flag::UNARMED }
    }
}

impl Plant for Bridge {
    fn sense(&mut self, tick: u64, inputs: &mut [f32]) -> bool {
        // In later ticks, `advance` has updated vision already.
        if self.report.ticks == 0 {
            self.step_to(tick);
            self.update_vision(tick);
        }
        let Some(vision) = &mut self.vision else { return self.task.sense(tick, inputs) };
        let seen = vision.target();
        self.task.sense_seen(tick, seen.map(|(target, _)| target), inputs);
        seen.is_some_and(|(_, new_target)| new_target)
    }

    fn command_deadline_ns(&self) -> Option<u64> {
        Some(self.command_within)
    }

    fn act(&mut self, tick: u64, applied: &mut [f32], flags: u32) -> u32 {
        self.write_ns = 0;
        let before = self.safety.state();
        let checked = self.arm_on_request(tick);
        let mut drive = self.safety.command(flags, self.sees());
        if drive == DriveCommand::Hold {
            self.hold_position.get_or_insert(self.raw);
        } else {
            self.hold_position = None;
        }
        if drive == DriveCommand::Start && !self.start(tick, checked) {
            drive = DriveCommand::Off;
        }
        let flags = match drive {
            DriveCommand::Off => self.stay_off(applied),
            DriveCommand::Hold => {
                applied.fill(0.0);
                self.write_goals(&[0.0; MAX_OUTPUTS]);
                flag::BLIND
            }
            DriveCommand::Start => self.follow(applied, true),
            DriveCommand::Follow => self.follow(applied, false),
        };
        if !self.beat(self.may_have_torque()) {
            self.safety.trip(TripCause::Unguarded);
        }
        self.report_transition(tick, before);
        flags
    }

    fn advance(&mut self, tick: u64, _applied: &[f32]) -> Outcome {
        self.step_to(tick + 1);
        let (before, theta_before) = (self.safety.state(), self.theta);
        self.check_presence(tick);
        // Before the read, because the age of a sample counts from the beginning of the tick.
        self.update_vision(tick + 1);
        self.read_leader(tick + 1);
        let (health, mut took) = self.measure();
        self.read_failed = health.is_none();
        self.safety.read_result(health);
        // Only while torque should be on: when another cause has turned it off in this tick, that is the cause.
        let driving = self.safety.state() == SafetyState::Driving;
        if driving && !self.read_failed && tick.is_multiple_of(TORQUE_CHECK_INTERVAL) {
            let began = self.bus.now();
            if !self.has_torque() {
                self.safety.read_result(Some(Err(TripCause::TorqueLost)));
            }
            took += self.bus.now() - began;
        }
        if before == SafetyState::Driving && self.safety.state() != SafetyState::Driving {
            self.turn_torque_off();
        }
        self.report_transition(tick, before);
        let mut rates = [0.0; MAX_OUTPUTS];
        for (rate, (now, then)) in rates.iter_mut().zip(self.theta.iter().zip(theta_before)) {
            *rate = wrap_f64(f64::from(now - then)) as f32 / self.period;
        }
        let mut outcome = self.outcome(tick, &rates);
        let first = self.measures;
        outcome.measures[first] = report::microseconds(took);
        outcome.measures[first + 1] = report::microseconds(self.write_ns);
        if let Some(vision) = &self.vision
            && first + 2 < MAX_MEASURES
        {
            outcome.measures[first + 2] = vision.latest_age.map_or(-1.0, |ns| ns as f32 / 1e6);
        }
        if let Some(leader) = &self.leader {
            outcome.measures[first + 2] = report::microseconds(leader.read_ns);
        }
        self.report.ticks += 1;
        self.report.blind += u64::from(self.read_failed);
        self.times[0].saturating_record(took);
        self.times[1].saturating_record(self.write_ns);
        if self.report.ticks.is_multiple_of(self.report_interval) {
            self.pass_report();
        }
        outcome
    }

    fn sensing_flags(&self) -> u32 {
        if self.read_failed || !self.sees() { flag::BLIND } else { 0 }
    }

    fn joints(&self) -> Option<JointState> {
        self.task.joints()
    }

    /// Turns torque off: what follows may take longer than the guard waits, and nobody sends commands any more.
    fn stop(&mut self) {
        if self.safety.state() != SafetyState::ReadOnly {
            self.bus.torque_off(&self.ids);
        }
        self.beat(false);
        let unknown = matches!(self.safety.state(), SafetyState::Tripped(cause) if cause.leaves_torque_unknown());
        if unknown || self.bus.is_gone() && self.safety.state() != SafetyState::ReadOnly {
            self.presence.leave_to_guard();
        }
        self.presence.ended = true;
    }
}

impl Drop for Bridge {
    /// Turns torque off, also after an error or a panic, and writes the report.
    fn drop(&mut self) {
        if !self.presence.ended {
            self.stop();
        }
        self.write_report();
    }
}

/// The state is only that of the task: the servos keep their positions.
impl Persist for Bridge {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.nested("task", &mut self.task);
    }
}
