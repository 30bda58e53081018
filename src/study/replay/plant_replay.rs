//! Replays the plant's half of the ticks along a log.
//!
//! The applied command and the flags in an observation follow from the command that arrived in the tick
//! before, and from the gate. With a simulated plant, everything else in the observation follows as well. The
//! flags tell whether a command arrived in time, with two exceptions: the plant skipped ticks right
//! afterwards, or the scenario's faults may have removed the command. In these cases both possibilities are
//! tried.
//!
//! Commands ahead are not in the log. One that was applied is taken from the observation, and has to be within the
//! gate's limits; every age that it can have had is tried.
//!
//! For a plant that cannot be run again, the gate's position limits depend on joint positions that are not in
//! the log. A command that was applied under them is accepted if it lies between zero and the command that
//! the gate would have applied without them.

use super::sample_diff::{Difference, compare};
use super::stamps::StampChecker;
use crate::plant::{EpisodeEnd, JointState, Outcome, Plant, SimulatedPlant};
use crate::runtime::PlantSide;
use crate::scenario::Plan;
use crate::state::{Persist, StateVisitor};
use crate::wire::{Command, MAX_INPUTS, Observation, OutputValues, flag};

/// Largest number of candidates that are kept. A further one needs another skip of ticks for which it makes
/// no difference whether the command arrived.
const MOST_CANDIDATES: usize = 8;

/// Where the plant's inputs, rewards and measures come from.
#[derive(Debug, Clone)]
enum ReplayedPlant {
    /// A simulated plant, which is run again.
    Simulated(SimulatedPlant),
    /// The log, for a plant that cannot be run again.
    Logged { inputs: [f32; MAX_INPUTS], fresh: bool, ended: u32, outcome: Outcome, own: Option<PlantOwnLimits> },
}

/// What the log tells of a plant that applies a command within its tick. Such a plant has limits of its own
/// behind the gate.
#[derive(Debug, Clone, Copy, Default)]
struct PlantOwnLimits {
    /// The command that it applied.
    applied: OutputValues,
    /// The flags of the observation.
    flags: u32,
    /// Whether both belong to the current tick, and not to a later one.
    current: bool,
}

impl PlantOwnLimits {
    /// Flags by which a plant reports that it did not apply the command as the gate passed it.
    const DEVIATION: u32 = flag::CLAMPED | flag::UNARMED | flag::TRIPPED | flag::BLIND;
    /// All flags that the plant may add to those of the gate.
    const ALL: u32 = Self::DEVIATION | flag::POSITION_LIMITED | flag::RAMPED;
}

impl Persist for ReplayedPlant {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        if let Self::Simulated(body) = self {
            body.visit_state(visitor);
        }
    }
}

impl Plant for ReplayedPlant {
    fn sense(&mut self, tick: u64, inputs: &mut [f32]) -> bool {
        match self {
            Self::Simulated(body) => body.sense(tick, inputs),
            Self::Logged { inputs: logged, fresh, .. } => {
                inputs.copy_from_slice(&logged[..inputs.len()]);
                *fresh
            }
        }
    }

    fn advance(&mut self, tick: u64, applied: &[f32]) -> Outcome {
        match self {
            Self::Simulated(body) => body.advance(tick, applied),
            Self::Logged { outcome, .. } => *outcome,
        }
    }

    fn command_deadline_ns(&self) -> Option<u64> {
        match self {
            Self::Logged { own: Some(_), .. } => Some(0),
            _ => None,
        }
    }

    fn act(&mut self, _tick: u64, applied: &mut [f32], _flags: u32) -> u32 {
        match self {
            Self::Logged { own: Some(own), .. } if own.current && own.flags & PlantOwnLimits::DEVIATION != 0 => {
                applied.copy_from_slice(&own.applied[..applied.len()]);
                own.flags & PlantOwnLimits::ALL
            }
            _ => 0,
        }
    }

    fn sensing_flags(&self) -> u32 {
        match self {
            Self::Simulated(body) => body.sensing_flags(),
            Self::Logged { own, ended, .. } => *ended | own.map_or(0, |own| own.flags & flag::BLIND),
        }
    }

    fn episode_end(&self) -> Option<EpisodeEnd> {
        match self {
            Self::Simulated(body) => body.episode_end(),
            // In the flags of sensing, as the log has them.
            Self::Logged { .. } => None,
        }
    }

    fn joints(&self) -> Option<JointState> {
        match self {
            Self::Simulated(body) => body.joints(),
            // They are not in a log.
            Self::Logged { .. } => None,
        }
    }
}

/// Gate and plant of a run, replayed along its log.
#[derive(Debug)]
pub(super) struct PlantReplay {
    /// The states that agree with the log so far; mostly one.
    candidates: Vec<PlantSide<ReplayedPlant>>,
    simulated: bool,
    /// Whether the scenario has faults of the channels, so that a command that was sent may have been missed.
    faulty: bool,
    /// Largest age of a command ahead.
    most_ahead: u32,
    ticks: u64,
    /// Number of observations so far.
    seen: u64,
    /// Tick of the last observation.
    last: Option<u64>,
    incarnation: u32,
}

impl PlantReplay {
    /// The beginning of a run of `plan`.
    pub fn new(plan: &Plan) -> Self {
        let body = plan.simulated_plant();
        let simulated = body.is_some();
        let own = plan.scenario.plant.servos.as_ref().map(|_| PlantOwnLimits::default());
        let logged = ReplayedPlant::Logged {
            inputs: [0.0; MAX_INPUTS],
            fresh: false,
            ended: 0,
            outcome: Outcome::default(),
            own,
        };
        let side = PlantSide::new(body.map_or(logged, ReplayedPlant::Simulated), plan);
        let faulty = !side.is_fault_free();
        Self {
            candidates: vec![side],
            simulated,
            faulty,
            most_ahead: plan.scenario.link.ahead,
            ticks: plan.scenario.ticks,
            seen: 0,
            last: None,
            incarnation: 0,
        }
    }

    /// Whether the plant is run again, so that every bit of an observation is checked.
    pub fn simulated(&self) -> bool {
        self.simulated
    }

    /// Number of observations so far.
    pub fn seen(&self) -> u64 {
        self.seen
    }

    /// The tick of the last observation.
    pub fn last(&self) -> Option<u64> {
        self.last
    }

    /// Compares `logged` with the replayed observation. `command` is the answer to the observation before, if
    /// the log has one.
    pub fn check(
        &mut self,
        logged: &Observation,
        command: Option<&Command>,
        stamps: &StampChecker,
    ) -> Result<(), Box<Difference>> {
        let due = self.last.map_or(0, |last| last + 1);
        let mut replayed = self.check_header(logged, due, stamps)?;
        let arrived = self.possibilities(logged, replayed.skipped, command, stamps);
        let tick = logged.header.tick;
        // Whether a command came after its tick depends on times that are not in the log.
        let late = if stamps.lockstep { 0 } else { logged.header.flags & flag::LATE };
        // Inputs that the scenario does not use are 0.
        replayed.inputs = [0.0; MAX_INPUTS];
        let mut fitting = Vec::with_capacity(1);
        let mut first = Ok(());
        for side in self.candidates.drain(..) {
            // A candidate is large. The last command takes it, so that it is copied only where there are several.
            let mut left = Some(side);
            for (i, &(command, age)) in arrived.iter().enumerate() {
                let side = if i + 1 == arrived.len() { left.take() } else { left.clone() };
                let Some(mut side) = side else { break };
                if age > 0 {
                    side.know_ahead(logged, age);
                }
                follow(&mut side, due, tick, command, logged);
                side.observe(tick, late, replayed.skipped, &mut replayed);
                match compare("observation", tick, logged, &replayed) {
                    Ok(()) if fitting.len() < MOST_CANDIDATES => fitting.push(side),
                    Ok(()) => {}
                    Err(difference) => first = first.and(Err(difference)),
                }
            }
        }
        if fitting.is_empty() {
            return first;
        }
        self.candidates = distinct(fitting);
        self.seen += 1;
        self.last = Some(tick);
        self.incarnation = logged.header.incarnation;
        Ok(())
    }

    /// Checks the tick of `logged`, the number of skipped ticks, and the header; `due` is the tick after the
    /// last one. Gives the observation with the replayed header.
    fn check_header(
        &self,
        logged: &Observation,
        due: u64,
        stamps: &StampChecker,
    ) -> Result<Observation, Box<Difference>> {
        let tick = logged.header.tick;
        let mut replayed = *logged;
        replayed.header.run = stamps.run;
        replayed.header.sequence = self.seen;
        // An incarnation never falls.
        replayed.header.incarnation = logged.header.incarnation.max(self.incarnation);
        if stamps.lockstep || tick < due || tick >= self.ticks {
            replayed.header.tick = due;
        }
        let skipped = replayed.header.tick - due;
        replayed.skipped = u32::try_from(skipped).unwrap_or(u32::MAX);
        stamps.stamp_observation(&mut replayed.header);
        compare("observation", due + skipped, logged, &replayed)?;
        stamps.check_order(&logged.header, "observation")?;
        Ok(replayed)
    }

    /// The commands that may have arrived in the tick before `logged`, `None` for no command, each with the age of the
    /// command ahead that may have been applied instead, 0 for none.
    fn possibilities<'a>(
        &self,
        logged: &Observation,
        skipped: u32,
        command: Option<&'a Command>,
        stamps: &StampChecker,
    ) -> Vec<(Option<&'a Command>, u32)> {
        let arrived = self.possible_commands(logged, skipped, command, stamps);
        let ahead = logged.header.flags & flag::AHEAD != 0;
        let ages = match skipped {
            0 if ahead => 1..=self.most_ahead,
            0 => 0..=0,
            // The flags are those of the last tick that was skipped.
            _ => 0..=self.most_ahead,
        };
        arrived.iter().flat_map(|command| ages.clone().map(|age| (*command, age))).collect()
    }

    /// The commands that may have arrived in the tick before `logged`; `None` for no command. In lockstep a
    /// command always arrives.
    fn possible_commands<'a>(
        &self,
        logged: &Observation,
        skipped: u32,
        command: Option<&'a Command>,
        stamps: &StampChecker,
    ) -> Vec<Option<&'a Command>> {
        let missed = logged.header.flags & (flag::MISSED | flag::NON_FINITE) == flag::MISSED;
        match (skipped, command) {
            (_, None) => vec![None],
            (0, Some(command)) if stamps.lockstep => vec![Some(command)],
            (0, Some(_)) if missed && !self.faulty => vec![None],
            (0, Some(command)) if !missed => vec![Some(command)],
            (_, Some(command)) => vec![Some(command), None],
        }
    }
}

/// The candidates without those whose state equals that of an earlier one.
fn distinct(mut candidates: Vec<PlantSide<ReplayedPlant>>) -> Vec<PlantSide<ReplayedPlant>> {
    if candidates.len() > 1 {
        let mut known: Vec<Vec<u8>> = Vec::with_capacity(candidates.len());
        candidates.retain_mut(|side| {
            let state = side.state_bytes();
            let new = !known.contains(&state);
            known.push(state);
            new
        });
    }
    candidates
}

/// Advances `side` from tick `due` - 1, in which `command` arrived in time, to the beginning of `tick`.
fn follow(side: &mut PlantSide<ReplayedPlant>, due: u64, tick: u64, command: Option<&Command>, logged: &Observation) {
    if let ReplayedPlant::Logged { inputs, fresh, ended, outcome, own } = side.body_mut() {
        *inputs = logged.inputs;
        *fresh = logged.header.flags & flag::NEW_TARGET != 0;
        *ended = logged.header.flags & flag::EPISODE_END;
        *outcome = Outcome { reward: logged.reward, measures: logged.measures };
        if let Some(own) = own {
            *own = PlantOwnLimits { applied: logged.applied, flags: logged.header.flags, current: tick == due };
        }
    }
    let assumed_limits = matches!(side.body_mut(), ReplayedPlant::Logged { .. }) && side.limits_positions();
    if assumed_limits {
        let limited = logged.header.flags & flag::POSITION_LIMITED != 0;
        side.set_command_ranges(
            logged.applied.map(|u| if limited { [u.min(0.0), u.max(0.0)] } else { [f32::MIN, f32::MAX] }),
        );
    }
    if due > 0 {
        side.step(due - 1, command);
    }
    if let ReplayedPlant::Logged { own: Some(own), .. } = side.body_mut() {
        own.current = true;
    }
    side.skip(due, tick);
    // Of the skipped ticks, the log has only the last one.
    if assumed_limits && tick > due {
        side.adopt_applied(logged);
    }
}
