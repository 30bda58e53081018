//! The bounds that a [`Plan`](crate::Plan) keeps. The rest of the program relies on them without checking
//! again.
//!
//! Many are far beyond any use. They exist so that no file can make later arithmetic overflow: f32 kernels,
//! nanoseconds in u64, buffers sized from the plan.

use std::ops::RangeInclusive;

pub use tectum_core::MAX_MEASURES;

/// Most inputs of an observation.
pub const MAX_INPUTS: usize = 32;
/// Most commands ahead of a command.
pub const MAX_AHEAD: usize = 8;
/// Most outputs of a command.
pub const MAX_OUTPUTS: usize = tectum_core::plant::MAX_JOINTS;

/// Most characters of a scenario's name, a signal's name or a unit.
pub const NAME_CHARS: usize = 32;
/// Most characters of a channel's name.
pub const CHANNEL_CHARS: usize = 64;
/// Most characters of a program's name or of one of its arguments.
pub const PROGRAM_CHARS: usize = 4096;
/// Largest seed: TOML's largest integer.
pub const MAX_SEED: u64 = i64::MAX as u64;
/// Period of the tick, ms; always a whole number of ns.
pub const PERIOD_MS: RangeInclusive<f64> = 1.0..=1000.0;
/// Ticks of a run.
pub const TICKS: RangeInclusive<u64> = 2..=1_000_000_000_000;
/// A run of so many ticks is endless, `ticks = "endless"`: 30 years at 1 kHz. A number, so that no arithmetic with it
/// can overflow.
pub const ENDLESS: u64 = *TICKS.end();
/// Largest number of ticks in any other key (`target_every`, `every`, `hash_every`, a block's `tick`).
pub const MAX_TICK: u64 = *TICKS.end();
/// Number of an arm's joints.
pub const JOINTS: RangeInclusive<usize> = 1..=8;
/// Length of a segment, m.
pub const LENGTH: RangeInclusive<f64> = 1e-3..=100.0;
/// Largest coordinate of base and arena in magnitude, m.
pub const COORDINATE: f64 = 1000.0;
/// Largest gain of the arm in magnitude, rad/s for a command of 1. A gain of 0 is refused.
pub const GAIN: f64 = 1e6;
/// Factor and weights of the arm's reward.
pub const WEIGHT: RangeInclusive<f64> = 0.0..=1e6;
/// Most changes of one kind (`shorten`, `mirror`) in an arm. Limited because each is checked for the share of
/// the arena that the arm can still reach.
pub const MAX_CHANGES: usize = 64;
/// Largest range of a limited joint, rad: a little less than a full turn, because angles wrap around after a
/// full turn.
pub const LIMITED_TURN: f64 = 6.25;
/// Least share of the arena that the arm must reach when targets are drawn. With a smaller share, drawing until
/// a target is within reach would take too long.
pub const REACHABLE_SHARE: f64 = 0.01;
/// The log-polar distortion B.
pub const DISTORTION: RangeInclusive<f64> = 1e-3..=1e6;
/// Standard deviation of the eye's position and velocity, in retina coordinates.
pub const SPREAD: RangeInclusive<f64> = 1e-6..=10.0;
/// Largest constant in the eye's reward in magnitude.
pub const BONUS: f64 = 1000.0;
/// Largest end of a signal's or a map's range in magnitude, in the signal's unit.
pub const RANGE: f64 = 1e9;
/// Most maps of an encoder.
pub const MAX_MAPS: usize = 64;
/// Units of a map along one input.
pub const UNITS: RangeInclusive<usize> = 2..=4096;
/// Default units of a map along one input.
pub const DEFAULT_UNITS: usize = 16;
/// Most units of an encoder, all maps together.
pub const MAX_FEATURES: usize = 65_536;
/// Radius of a kernel, in the unit of its inputs.
pub const RADIUS: RangeInclusive<f64> = 1e-9..=1e9;
/// Largest spacing of neighbouring units along an input, in radii. At 10, an input half-way between two units
/// still activates both with `exp(-12.5)`, and units of a 2-D map with `exp(-25)`, whose square is a normal
/// f32. So at least one feature of an input within the range is not 0, and the features can be scaled to unit
/// norm.
pub const SPACING_PER_RADIUS: f64 = 10.0;
/// Largest command in magnitude.
pub const COMMAND: RangeInclusive<f64> = 1e-9..=1e6;
/// Least standard deviation of the exploration noise. Its upper bound is the scenario's largest command.
pub const MIN_SIGMA: f64 = 1e-9;
/// The step `alpha / sigma^2`. With features of unit norm and rewards of the order of 1, learning diverges
/// above 2. The limit of 1000 leaves room for smaller rewards.
pub const STEP: RangeInclusive<f64> = 0.0..=1000.0;
/// Largest angle in the gate's position limits in magnitude, rad. An angle that no joint reaches has no effect.
pub const POSITION: f64 = 1000.0;
/// Least distance between the two limits of a position, rad.
pub const MIN_POSITION_RANGE: f64 = 1e-3;
/// Most faults of channels, most faults of processes, and most faults of an emulated chain of servos.
pub const MAX_FAULTS: usize = 16;
/// Most ticks by which a sample is delayed or duplicated. Limited because all samples under way are kept in
/// memory.
pub const MAX_DELAY: u64 = 16;
/// Most ticks for which a channel is frozen.
pub const MAX_FREEZE: u64 = 1_000_000;
/// Most ticks in the list of one process fault.
pub const MAX_FAULT_TICKS: usize = 1000;
/// Duration for which a fault stops a process, ms.
pub const STOPPED_MS: RangeInclusive<f64> = 1.0..=60_000.0;
/// Most ticks of hold, of decay or of the gate's ramp.
pub const MAX_HOLD: u32 = 1_000_000;
/// Time constants of a learner, ticks.
pub const LEARNER_TICKS: RangeInclusive<f64> = 1.0..=1e12;
/// Factor of the last reward, which is a feature of the critic.
pub const REWARD_FEATURE: RangeInclusive<f64> = 0.0..=1000.0;
/// Step of the estimate of what squared noise costs. The variance of a squared standard normal is 2, so the
/// estimate could not converge above 1/2.
pub const NOISE_STEP: RangeInclusive<f64> = 0.0..=0.1;
/// Bound on the temporal-difference error, in multiples of its mean magnitude. Below 1 it would clip errors of
/// usual size.
pub const ERROR_BOUND: RangeInclusive<f64> = 1.0..=1e9;
/// Regularisation of the natural gradient. Below 1e-6 the inverse would lose its precision.
pub const REGULARISATION: RangeInclusive<f64> = 1e-6..=1e6;
/// Standard deviations in the learned reward model.
pub const SPREADS: RangeInclusive<f64> = 1e-6..=1e6;
/// Imagined movements for a step, ticks of each movement, and steps per tick.
pub const IMAGINED: RangeInclusive<usize> = 1..=1024;
/// Past ticks that the learned-reward rule keeps.
pub const MEMORY: RangeInclusive<usize> = 1..=1_000_000;
/// Weight of the last tick of an imagined movement.
pub const LAST_COUNTS: RangeInclusive<f64> = 1.0..=1000.0;
/// Size of the learned-reward rule's step, in units of a weight.
pub const MODEL_STEP: RangeInclusive<f64> = 0.0..=1.0;
/// Updates of a learner in a tick.
pub const UPDATES: RangeInclusive<u32> = 1..=1000;
/// Most inputs of a learned reward. The size of its covariance grows with the fourth power of their number.
pub const MODEL_INPUTS: usize = 10;
/// Most units along an input for a learned reward. The rule decorrelates the units along each input, and the
/// work grows with the cube of their number.
pub const MODEL_UNITS: usize = 256;
/// Time of a tick's work after the command, ms.
pub const BUDGET_MS: RangeInclusive<f64> = 0.1..=1000.0;
/// Length of a plan, ticks.
pub const PLAN_HORIZON: RangeInclusive<usize> = 2..=200;
/// Iterations of a plan, and steps of a refit.
pub const PLAN_ITERATIONS: RangeInclusive<usize> = 0..=1000;
/// Ticks that the model-predictive learner remembers.
pub const PLAN_MEMORY: RangeInclusive<usize> = 100..=100_000;
/// Points of the evidence. The work grows with the cube of their number.
pub const PLAN_POINTS: RangeInclusive<usize> = 16..=1000;
/// Features of a learned model. Its covariance has half of their square.
pub const PLAN_FEATURES: RangeInclusive<usize> = 10..=4000;
/// Products among them.
pub const PLAN_PRODUCTS: RangeInclusive<usize> = 0..=4000;
/// Factor of the first ticks' noise.
pub const FIRST_NOISE: RangeInclusive<f64> = 0.0..=1000.0;
/// Operations of a tick, in millions.
pub const OPERATIONS: RangeInclusive<f64> = 0.01..=1e6;
/// Least noise of a model, as a part of its prior's scale.
pub const NOISE_FLOOR: RangeInclusive<f64> = 1e-12..=0.1;
/// Most features for a natural gradient. The rule inverts their second-moment matrix, and the work grows with
/// the cube of their number.
pub const METRIC_FEATURES: usize = 1024;
/// Priorities under SCHED_FIFO.
pub const PRIORITY: RangeInclusive<u32> = 1..=99;
/// Largest number of a core. The operating system's set of cores (`cpu_set_t`) has 1024 entries.
pub const MAX_CORE: u32 = 1023;
/// Most stack that is touched before the first tick, KiB: half of the usual 8 MiB.
pub const MAX_STACK_KIB: u32 = 4096;
/// Limits of an emulated servo's speed, rad/s, and acceleration, rad/s^2.
pub const SERVO_RATE: RangeInclusive<f64> = 0.001..=1e6;
/// Latency and jitter of an emulated servo's responses, us.
pub const SERVO_LATENCY_US: RangeInclusive<f64> = 0.0..=1e6;
/// Noise of an emulated servo's position, steps.
pub const SERVO_NOISE: RangeInclusive<f64> = 0.0..=1000.0;
/// Instants of an emulated servo's faults, s.
pub const SERVO_SECONDS: RangeInclusive<f64> = 0.0..=1e9;
/// Delay of an emulated servo's slow responses, ms.
pub const SERVO_DELAY_MS: RangeInclusive<f64> = 0.001..=60_000.0;
