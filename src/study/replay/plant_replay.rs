//! The plant's half of the ticks, followed through a log.
//!
//! What an observation says of the tick before (the applied command, the flags) follows from the command that arrived and
//! the gate; with the simulator's bodies, so does everything else in it. Whether a command arrived in time is told by the
//! flags, except where the plant passed ticks over right after, or where the scenario's faults may have taken it: then both
//! are tried.
//!
//! The limits of position of a plant that nobody can run again depend on what the log does not tell. What was applied under
//! them is taken as it stands, if it lies between zero and what the gate would have let through without them.

use super::compare::{Difference, compare};
use super::stamps::StampChecker;
use crate::plant::{JointState, Outcome, Plant, SimulatedPlant};
use crate::policy::Outputs;
use crate::programs::is_simulator;
use crate::runtime::PlantSide;
use crate::scenario::Plan;
use crate::state::{Persist, StateVisitor};
use crate::wire::{Command, MAX_INPUTS, Observation, flag};

/// More ways to have come here than this are not kept apart: each needs ticks passed over whose command may have arrived or
/// not, with the same outcome.
const MOST: usize = 8;

/// Whose words are taken for what the plant sensed.
#[derive(Debug, Clone)]
enum SensedBy {
    /// A body of the simulator, which lives through the run again.
    Simulated(SimulatedPlant),
    /// The log's own, for a plant that nobody can run again.
    Told { inputs: [f32; MAX_INPUTS], fresh: bool, outcome: Outcome, own: Option<PlantOwnLimits> },
}

/// What a body that acts at once has said of a tick: such a one has limits of its own, behind the gate's.
#[derive(Debug, Clone, Copy, Default)]
struct PlantOwnLimits {
    /// What it applied.
    applied: Outputs,
    /// What the observation says of it.
    flags: u32,
    /// Whether both are of the tick that is lived through now, and not of a later one.
    current: bool,
}

impl PlantOwnLimits {
    /// Flags by which a body says that it did something else than it was asked to.
    const ELSE: u32 = flag::CLAMPED | flag::UNARMED | flag::TRIPPED | flag::BLIND;
    /// All flags that it may add to the gate's.
    const ALL: u32 = Self::ELSE | flag::POSITION_LIMITED | flag::RAMPED;
}

impl Persist for SensedBy {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        if let Self::Simulated(body) = self {
            body.visit_state(visitor);
        }
    }
}

impl Plant for SensedBy {
    fn sense(&mut self, tick: u64, inputs: &mut [f32]) -> bool {
        match self {
            Self::Simulated(body) => body.sense(tick, inputs),
            Self::Told { inputs: told, fresh, .. } => {
                inputs.copy_from_slice(told);
                *fresh
            }
        }
    }

    fn advance(&mut self, tick: u64, applied: &[f32]) -> Outcome {
        match self {
            Self::Simulated(body) => body.advance(tick, applied),
            Self::Told { outcome, .. } => *outcome,
        }
    }

    fn acts_within(&self) -> Option<u64> {
        match self {
            Self::Told { own: Some(_), .. } => Some(0),
            _ => None,
        }
    }

    fn act(&mut self, _tick: u64, applied: &mut [f32], _flags: u32) -> u32 {
        match self {
            Self::Told { own: Some(own), .. } if own.current && own.flags & PlantOwnLimits::ELSE != 0 => {
                applied.copy_from_slice(&own.applied[..applied.len()]);
                own.flags & PlantOwnLimits::ALL
            }
            _ => 0,
        }
    }

    fn remarks(&self) -> u32 {
        match self {
            Self::Told { own: Some(own), .. } => own.flags & flag::BLIND,
            _ => 0,
        }
    }

    fn joints(&self) -> Option<JointState> {
        match self {
            Self::Simulated(body) => body.joints(),
            // A log does not tell them.
            Self::Told { .. } => None,
        }
    }
}

/// Gate and body of a run, followed through its log.
#[derive(Debug)]
pub struct PlantReplay {
    /// The ways to have come here; one, as a rule.
    sides: Vec<PlantSide<SensedBy>>,
    simulated: bool,
    /// A command that arrived may be missed all the same, by a fault of the channel.
    faulty: bool,
    ticks: u64,
    /// Observations so far, and the tick of the last.
    seen: u64,
    last: Option<u64>,
    incarnation: u32,
}

impl PlantReplay {
    /// The beginning of a run of `plan`.
    pub fn new(plan: &Plan) -> Self {
        // Another program may be given the simulator's tables, and be something else all the same.
        let body = plan.simulated_plant().filter(|_| is_simulator(&plan.scenario.plant.program));
        let simulated = body.is_some();
        let own = plan.scenario.plant.servos.as_ref().map(|_| PlantOwnLimits::default());
        let told = SensedBy::Told { inputs: [0.0; MAX_INPUTS], fresh: false, outcome: Outcome::default(), own };
        let side = PlantSide::new(body.map_or(told, SensedBy::Simulated), plan);
        let faulty = !side.is_fault_free();
        Self { sides: vec![side], simulated, faulty, ticks: plan.scenario.ticks, seen: 0, last: None, incarnation: 0 }
    }

    /// Whether the body is run again, so that every bit of an observation is checked.
    pub fn simulated(&self) -> bool {
        self.simulated
    }

    /// Observations so far.
    pub fn seen(&self) -> u64 {
        self.seen
    }

    /// The tick of the last observation.
    pub fn last(&self) -> Option<u64> {
        self.last
    }

    /// Holds `logged` against what should be told; `command` is the answer to the observation before, if there is one in
    /// the log.
    pub fn check(
        &mut self,
        logged: &Observation,
        command: Option<&Command>,
        clock: &StampChecker,
    ) -> Result<(), Box<Difference>> {
        let due = self.last.map_or(0, |last| last + 1);
        let tick = logged.header.tick;
        let mut replayed = *logged;
        // First what the rest is counted from: the tick, and how far it is from the one before.
        replayed.header.run = clock.run;
        replayed.header.sequence = self.seen;
        // Whoever was started anew does not go back.
        replayed.header.incarnation = logged.header.incarnation.max(self.incarnation);
        if clock.lockstep || tick < due || tick >= self.ticks {
            replayed.header.tick = due;
        }
        let skipped = replayed.header.tick - due;
        replayed.skipped = u32::try_from(skipped).unwrap_or(u32::MAX);
        clock.stamp_observation(&mut replayed.header);
        compare("observation", due + skipped, logged, &replayed)?;
        clock.check_order(&logged.header, "observation")?;

        // Then what came of the tick before. In lockstep a command always arrives.
        let missed = logged.header.flags & (flag::MISSED | flag::NON_FINITE) == flag::MISSED;
        let arrived: &[Option<&Command>] = match (skipped, command) {
            (_, None) => &[None],
            (0, Some(command)) if clock.lockstep => &[Some(command)],
            (0, Some(_)) if missed && !self.faulty => &[None],
            (0, Some(command)) if !missed => &[Some(command)],
            (_, Some(command)) => &[Some(command), None],
        };
        // Entries that no input uses are 0.
        replayed.inputs = [0.0; MAX_INPUTS];
        let mut fitting = Vec::with_capacity(1);
        let mut first = Ok(());
        for side in self.sides.drain(..) {
            for command in arrived {
                let mut side = side.clone();
                side.follow(due, tick, *command, logged);
                // A command that came after its tick is a matter of instants, which nobody else saw.
                let late = if clock.lockstep { 0 } else { logged.header.flags & flag::LATE };
                side.observe(tick, late, replayed.skipped, &mut replayed);
                match compare("observation", tick, logged, &replayed) {
                    Ok(()) if fitting.len() < MOST => fitting.push(side),
                    Ok(()) => {}
                    Err(difference) => first = first.and(Err(difference)),
                }
            }
        }
        if fitting.len() > 1 {
            // Ways that have come to the same are one.
            let mut known: Vec<Vec<u8>> = Vec::with_capacity(fitting.len());
            fitting.retain_mut(|side| {
                let standing = side.state_bytes();
                let new = !known.contains(&standing);
                known.push(standing);
                new
            });
        }
        if fitting.is_empty() {
            return first;
        }
        self.sides = fitting;
        self.seen += 1;
        self.last = Some(tick);
        self.incarnation = logged.header.incarnation;
        Ok(())
    }
}

impl PlantSide<SensedBy> {
    /// Lives from tick `due` - 1, of which `command` came in time, to the beginning of `tick`.
    fn follow(&mut self, due: u64, tick: u64, command: Option<&Command>, logged: &Observation) {
        if let SensedBy::Told { inputs, fresh, outcome, own } = self.body_mut() {
            *inputs = logged.inputs;
            *fresh = logged.header.flags & flag::NEW_TARGET != 0;
            *outcome = Outcome { reward: logged.reward, measures: logged.measures };
            if let Some(own) = own {
                *own = PlantOwnLimits { applied: logged.applied, flags: logged.header.flags, current: tick == due };
            }
        }
        let guessed = matches!(self.body_mut(), SensedBy::Told { .. }) && self.limits_positions();
        if guessed {
            let limited = logged.header.flags & flag::POSITION_LIMITED != 0;
            self.set_command_ranges(
                logged.applied.map(|u| if limited { [u.min(0.0), u.max(0.0)] } else { [f32::MIN, f32::MAX] }),
            );
        }
        if due > 0 {
            self.step(due - 1, command);
        }
        if let SensedBy::Told { own: Some(own), .. } = self.body_mut() {
            own.current = true;
        }
        self.skip(due, tick);
        // Of the ticks passed over, the log tells the last one only.
        if guessed && tick > due {
            self.adopt_applied(logged);
        }
    }
}
