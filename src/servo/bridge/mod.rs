//! The plant on servos: one synchronous read at a tick's beginning, one synchronous write when its command is there.
//!
//! *What is real and what is a model.* Angles are measured. The end-effector is where a model of the arm, `[plant.arm]`, has it with
//! the measured angles; error and reward are reckoned from that, and nobody has seen the end-effector. The model is used for the
//! reward and the measures alone; targets are drawn as in the simulator. The reward's speed is the
//! measured one, since a motor lags behind its goal: an ideal chain of servos earns what the simulator earns, to within its resolution.
//!
//! *What is seen.* With `sight = "vision"` target and end-effector, and so error and reward, are what trackers say; the model is left with what
//! none of them sees, segments that cross. A tracker that says nothing new enough leaves the arm [blind](flag::BLIND): it stands still with torque on
//! (which does not come on before something is seen), nothing is learned, and it goes on when it sees again.
//!
//! *Motors and outputs.* A motor turns a segment against the one before it. With `angles = "absolute"` the inputs are the segments'
//! directions, running sums of the motors' angles, and a motor's rate is the difference of two outputs. Limits are the motors': when
//! one of them is asked for more than its `max_speed`, all rates shrink by one factor; one that would leave its `range` goes to its end.
//! What is left of the command after that is what was applied, and is said so in the observation.
//!
//! *What a tick costs.* Each instruction is bounded by the bus's [`BusBudget`], whatever the bus does. A tick has one read and one write; more only
//! where a servo reports an error, where torque goes on, and every 20 ticks, when all are asked whether they have it. Both times are
//! measures: `bus_read_us`, `bus_write_us`.

mod chain;
mod checks;
mod motors;
mod report;
mod safety;
mod vision;

pub use checks::{BridgeError, joints_of};
pub use report::{BridgeReport, TripEvent};
pub use safety::{DriveCommand, RECOVERY, SafetyMachine, SafetyState, TripCause};
pub use vision::VisionReport;

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use hdrhistogram::Histogram;

use super::bus::{Bus, BusBudget};
use crate::plant::{Arm, JointState, Outcome, Plant};
use crate::policy::Outputs;
use crate::scenario::{Angles, JointConfig, Plan, ServosConfig};
use crate::state::{Persist, StateVisitor};
use crate::stats::{Percentiles, histogram};
use crate::wire::{MAX_MEASURES, MAX_OUTPUTS, Vision, flag};
use vision::VisionInput;

/// Ticks over which commands grow after torque came on, where the gate has no ramp of its own.
const RAMP: u32 = 20;

/// Every so many ticks all servos are asked whether they still have torque.
const TORQUE_EVERY: u64 = 20;

/// Where samples of trackers come from: the next one that was not taken yet.
pub type VisionSource = Box<dyn FnMut() -> Option<Vision>>;

/// Samples that are taken at a tick, at most: eight trackers' buffers, which is all that can wait.
const MOST_LOOKS: usize = 32;

/// The body.
pub struct Bridge {
    bus: Bus,
    table: ServosConfig,
    joints: Vec<JointConfig>,
    ids: Vec<u8>,
    arm: Arm,
    angles: Angles,
    collides: bool,
    /// rad/s for a command of 1.
    gain: f32,
    /// s.
    period: f32,
    within: u64,
    safety: SafetyMachine,
    /// The largest command of each output, and the ticks over which it is reached after torque came on; ticks since then.
    most: Outputs,
    ramp: u32,
    driven: u32,
    /// What the motors' angles are, rad, and the outputs' angles.
    motors: [f64; MAX_OUTPUTS],
    theta: Outputs,
    raw: [i32; MAX_OUTPUTS],
    blind: bool,
    /// What trackers see, where they are asked.
    sight: Option<VisionInput>,
    eye: Option<VisionSource>,
    /// What came of the last tick in which something was seen.
    seen: Outcome,
    /// Where the motors were when the arm began to stand still.
    rest: Option<[i32; MAX_OUTPUTS]>,
    write_ns: u64,
    /// Set by whoever arms it at the terminal.
    key: Arc<AtomicBool>,
    say: Box<dyn FnMut(&str)>,
    /// The account so far.
    pub report: BridgeReport,
    times: [Histogram<u64>; 2],
    /// Where the account goes at the end.
    account: Option<PathBuf>,
}

impl Bridge {
    /// The body of `plan` on `bus`. Reads, and writes one thing: torque off, which a bridge that was killed may have left on. Sentences for people go to `say`.
    ///
    /// # Errors
    /// When the plan has no servos or not those of the bus.
    pub fn new(
        plan: &Plan,
        mut bus: Bus,
        joints: Vec<JointConfig>,
        say: Box<dyn FnMut(&str)>,
    ) -> Result<Self, BridgeError> {
        let plant = &plan.scenario.plant;
        let (Some(table), Some(arm)) = (&plant.servos, &plant.arm) else { return Err(BridgeError::NoServos) };
        // First of all: whoever has this port keeps the guard of a bridge that was killed from it, and may find no whole chain.
        bus.torque_off(&joints.iter().map(|joint| joint.id).collect::<Vec<_>>());
        checks::identify(&mut bus, &joints)?;
        let period_s = plan.scenario.period_ms / 1000.0;
        let within = table.command_within_ms.unwrap_or(plan.scenario.period_ms / 2.0);
        let mut bridge = Self {
            ids: joints.iter().map(|joint| joint.id).collect(),
            arm: Arm::new(arm, period_s, plan.scenario.seed),
            angles: arm.angles,
            collides: arm.reward.collision > 0.0,
            gain: arm.gain as f32,
            period: period_s as f32,
            within: (within * 1e6) as u64,
            safety: SafetyMachine::new(table.lost_after),
            most: std::array::from_fn(|i| plan.scenario.gate.max_command.of(i) as f32),
            ramp: match plan.scenario.gate.ramp_ticks {
                0 => RAMP,
                ticks => ticks,
            },
            driven: 0,
            motors: [0.0; MAX_OUTPUTS],
            theta: [0.0; MAX_OUTPUTS],
            raw: [0; MAX_OUTPUTS],
            blind: false,
            sight: (!table.sight.is_model()).then(|| VisionInput::new(table, plan.period_ns)),
            eye: None,
            seen: Outcome::default(),
            rest: None,
            write_ns: 0,
            key: Arc::default(),
            say,
            report: BridgeReport::default(),
            times: [histogram(), histogram()],
            account: None,
            table: table.clone(),
            joints,
            bus,
        };
        if bridge.measure().0.is_err() {
            return Err(BridgeError::Silent("the servos do not answer".to_owned()));
        }
        bridge.arm.stands(&bridge.theta);
        Ok(bridge)
    }

    /// Hands it the eye with which it sees, where the scenario has `sight = "vision"`. Without one it never sees anything.
    pub fn look_with(&mut self, eye: VisionSource) {
        self.eye = Some(eye);
    }

    /// The budget of a tick of `plan`.
    pub fn budget(plan: &Plan) -> BusBudget {
        BusBudget::of(plan.period_ns)
    }

    /// What arms the bridge when it is set: it looks at it once a tick.
    pub fn key(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.key)
    }

    /// Makes the bridge write its report to `path` when it ends.
    pub fn write_report_to(&mut self, path: PathBuf) {
        self.account = Some(path);
    }

    /// Where its safety stands.
    pub fn state(&self) -> SafetyState {
        self.safety.state()
    }

    /// Checks all that torque needs, sets modes and limits in the servos, and arms. Torque goes on with the first command.
    ///
    /// # Errors
    /// When something speaks against it; then nothing is armed.
    pub fn arm(&mut self) -> Result<(), BridgeError> {
        if self.measure().0.is_err() {
            return Err(BridgeError::Silent("the servos do not answer".to_owned()));
        }
        checks::prepare(&mut self.bus, &self.joints, self.table.goal, &self.motors)?;
        self.safety.arm();
        Ok(())
    }

    /// Takes what came from trackers; `tick` begins. No more than a tick can need: who floods the channel does not hold the tick up.
    fn look(&mut self, tick: u64) {
        let Some(sight) = &mut self.sight else { return };
        let now = self.bus.now();
        for sample in std::iter::from_fn(|| self.eye.as_mut().and_then(|eye| eye())).take(MOST_LOOKS) {
            sight.take(&sample, now);
        }
        if sight.look(now) {
            let text = match (sight.sees, sight.aged) {
                (true, _) => "target and end-effector are seen".to_owned(),
                (false, age) => format!(
                    "nothing is seen any more: the newest sample of a tracker is {} ms old; the arm stands still",
                    age.unwrap_or_default() / 1_000_000
                ),
            };
            (self.say)(&format!("tick {tick}: {text}"));
        }
    }

    /// Whether the arm sees, where it needs to.
    fn sees(&self) -> bool {
        self.sight.as_ref().is_none_or(|sight| sight.sees)
    }

    /// What came of a tick, as trackers see it; when they do not, as of before.
    fn judged(&mut self, tick: u64, rates: &[f32]) -> Outcome {
        let Some(sight) = &self.sight else { return self.arm.measured(tick, &self.theta, rates, None) };
        if sight.sees {
            self.seen = self.arm.measured(tick, &self.theta, rates, Some(sight.end()));
        } else {
            self.arm.stands(&self.theta);
        }
        self.seen
    }

    fn tell(&mut self, tick: u64, before: SafetyState) {
        let state = self.safety.state();
        if state == before {
            return;
        }
        let text = match state {
            SafetyState::ReadOnly => "read-only".to_owned(),
            SafetyState::Ready => "armed; torque goes on with the next command".to_owned(),
            SafetyState::Driving => "torque is on".to_owned(),
            SafetyState::Tripped(cause) if cause.passes() => {
                format!("torque is off: {cause}; it goes on by itself when that is over")
            }
            SafetyState::Tripped(cause) => format!("torque is off: {cause}; arm it again to go on"),
        };
        (self.say)(&format!("tick {tick}: {text}"));
        match state {
            SafetyState::Driving => self.report.armed += 1,
            // A fault that comes and goes for hours is told at the terminal; the account has its beginning.
            SafetyState::Tripped(cause) if self.report.events.len() < 1000 => {
                self.report.events.push(TripEvent { tick, cause })
            }
            _ => {}
        }
    }

    /// Brings the first commands after torque came on within a part of the largest one that grows to the whole. The gate's own ramp
    /// counts from the first command, which may have come long before anybody armed the arm.
    fn ease(&self, applied: &mut [f32]) -> u32 {
        if self.driven >= self.ramp {
            return 0;
        }
        let share = (self.driven + 1) as f32 / (self.ramp + 1) as f32;
        let mut flags = 0;
        for (u, most) in applied.iter_mut().zip(self.most) {
            let eased = u.clamp(-most * share, most * share);
            if eased != *u {
                (*u, flags) = (eased, flag::CLAMPED | flag::RAMPED);
            }
        }
        flags
    }

    /// Limits `applied` to what the motors can do; their rates, rad/s, and the flags of what was limited.
    fn limit(&self, applied: &mut [f32]) -> ([f64; MAX_OUTPUTS], u32) {
        let n = self.ids.len();
        let (mut asked, mut rates) = ([0.0; MAX_OUTPUTS], [0.0; MAX_OUTPUTS]);
        for (rate, u) in asked.iter_mut().zip(applied.iter()) {
            *rate = f64::from(self.gain * u);
        }
        chain::motors(self.angles, &asked[..n], &mut rates);
        let (fast, far) = chain::limit(&self.joints, &self.motors[..n], f64::from(self.period), &mut rates);
        if fast || far {
            for (u, rate) in applied.iter_mut().zip(chain::along(self.angles, &rates)) {
                *u = rate as f32 / self.gain;
            }
        }
        let flags = if fast { flag::CLAMPED } else { 0 } | if far { flag::CLAMPED | flag::POSITION_LIMITED } else { 0 };
        (rates, flags)
    }
}

impl Plant for Bridge {
    fn sense(&mut self, tick: u64, inputs: &mut [f32]) -> bool {
        // Before the first tick is over nobody has looked.
        if self.report.ticks == 0 {
            self.look(tick);
        }
        let Some(sight) = &mut self.sight else { return self.arm.sense(tick, inputs) };
        let (target, fresh) = sight.target().unwrap_or((self.arm.target(), false));
        self.arm.sense_seen(tick, target, inputs);
        fresh
    }

    fn command_deadline_ns(&self) -> Option<u64> {
        Some(self.within)
    }

    fn act(&mut self, tick: u64, applied: &mut [f32], flags: u32) -> u32 {
        self.write_ns = 0;
        let before = self.safety.state();
        let mut prepared = false;
        if self.key.swap(false, Ordering::Relaxed) && before != SafetyState::Driving {
            match self.arm() {
                Ok(()) => prepared = true,
                Err(error) => (self.say)(&format!("tick {tick}: not armed: {error}")),
            }
        }
        let mut drive = self.safety.command(flags, self.sees());
        if drive == DriveCommand::Still {
            self.rest.get_or_insert(self.raw);
        } else {
            self.rest = None;
        }
        // After a loss of the bus or of power, or a while in which somebody may have moved the arm, nothing is taken for granted.
        if drive == DriveCommand::Rise {
            let checked = if prepared {
                Ok(())
            } else {
                checks::prepare(&mut self.bus, &self.joints, self.table.goal, &self.motors)
            };
            if let Err(error) = &checked {
                (self.say)(&format!("tick {tick}: {error}"));
            }
            let trouble = match checked {
                Ok(()) => (!self.rise()).then_some(TripCause::BusLost),
                // Who says nothing refuses nothing.
                Err(BridgeError::Silent(_)) => Some(TripCause::BusLost),
                Err(_) => Some(TripCause::Refused),
            };
            if let Some(cause) = trouble {
                self.safety.trip(cause);
                drive = DriveCommand::Off;
            }
        }
        let mut more = 0;
        match drive {
            DriveCommand::Off => {
                applied.fill(0.0);
                if self.safety.state() != SafetyState::ReadOnly {
                    self.off();
                }
                more |=
                    if matches!(self.safety.state(), SafetyState::Tripped(_)) { flag::TRIPPED } else { flag::UNARMED };
            }
            DriveCommand::Still => {
                applied.fill(0.0);
                self.drive(&[0.0; MAX_OUTPUTS]);
                more |= flag::BLIND;
            }
            DriveCommand::Rise | DriveCommand::Go => {
                self.driven = if drive == DriveCommand::Rise { 0 } else { self.driven.saturating_add(1) };
                more |= self.ease(applied);
                let (rates, limited) = self.limit(applied);
                more |= limited;
                if !self.drive(&rates) {
                    self.report.unwritten += 1;
                    self.safety.trip(TripCause::BusLost);
                    applied.fill(0.0);
                    more |= flag::TRIPPED;
                }
            }
        }
        self.tell(tick, before);
        more
    }

    fn advance(&mut self, tick: u64, _applied: &[f32]) -> Outcome {
        let (before, stood) = (self.safety.state(), self.theta);
        // How old a picture is counts from here, and not from when the bus has been read.
        self.look(tick + 1);
        let (heard, mut took) = self.measure();
        self.blind = heard.is_err();
        self.safety.hear(heard.ok());
        if before == SafetyState::Driving && !self.blind && tick.is_multiple_of(TORQUE_EVERY) {
            let began = self.bus.now();
            if !self.has_torque() {
                self.safety.hear(Some(Err(TripCause::TorqueLost)));
            }
            took += self.bus.now() - began;
        }
        if before == SafetyState::Driving && self.safety.state() != SafetyState::Driving {
            self.off();
        }
        self.tell(tick, before);
        let mut rates = [0.0; MAX_OUTPUTS];
        for (rate, (now, then)) in rates.iter_mut().zip(self.theta.iter().zip(stood)) {
            *rate = chain::wrap(f64::from(now - then)) as f32 / self.period;
        }
        let mut outcome = self.judged(tick, &rates);
        let first = if self.collides { 4 } else { 3 };
        outcome.measures[first] = report::microseconds(took);
        outcome.measures[first + 1] = report::microseconds(self.write_ns);
        if let Some(sight) = &self.sight
            && first + 2 < MAX_MEASURES
        {
            outcome.measures[first + 2] = sight.aged.map_or(-1.0, |ns| ns as f32 / 1e6);
        }
        self.report.ticks += 1;
        self.report.blind += u64::from(self.blind);
        self.times[0].saturating_record(took);
        self.times[1].saturating_record(self.write_ns);
        outcome
    }

    fn sensing_flags(&self) -> u32 {
        if self.blind || !self.sees() { flag::BLIND } else { 0 }
    }

    fn joints(&self) -> Option<JointState> {
        self.arm.joints()
    }
}

impl Drop for Bridge {
    /// However it ends, in order, by an error or in a panic: torque is off.
    fn drop(&mut self) {
        if self.safety.state() != SafetyState::ReadOnly {
            self.bus.torque_off(&self.ids);
        }
        if let Some(path) = &self.account {
            [self.report.bus_read, self.report.bus_write] =
                [Percentiles::of(&self.times[0]), Percentiles::of(&self.times[1])];
            self.report.vision = self.sight.as_ref().map(VisionInput::report);
            let text = serde_json::to_string_pretty(&self.report).unwrap_or_default();
            // The run's own account is not in danger without it.
            let _ = std::fs::write(path, text);
        }
    }
}

/// The servos themselves remember where they are.
impl Persist for Bridge {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.nested("task", &mut self.arm);
    }
}
