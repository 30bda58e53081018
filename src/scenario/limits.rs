//! The bounds that a [`Plan`](super::Plan) keeps: what the rest of the program may rely on without checking again.
//!
//! Many are far beyond any use. They are there so that arithmetic further on (f32 kernels, nanoseconds in u64, buffers
//! sized from the plan) cannot overflow, whatever a file says.

use std::ops::RangeInclusive;

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
/// Most ticks wherever a table counts in ticks (`target_every`, `every`, `hash_every`, a block's `tick`).
pub const MAX_TICK: u64 = *TICKS.end();
/// Number of an arm's joints.
pub const JOINTS: RangeInclusive<usize> = 1..=8;
/// Length of a segment, m.
pub const LENGTH: RangeInclusive<f64> = 1e-3..=100.0;
/// Largest coordinate of base and arena in magnitude, m.
pub const COORDINATE: f64 = 1000.0;
/// Largest gain of the arm in magnitude, rad/s for a command of 1; never 0.
pub const GAIN: f64 = 1e6;
/// Factor and weights of the arm's reward.
pub const WEIGHT: RangeInclusive<f64> = 0.0..=1e6;
/// Most of an arm's changes of one kind, where each is checked for what can still be reached.
pub const MAX_CHANGES: usize = 64;
/// Most between the limits of a joint, rad: a little less than a full turn, since an angle over a full turn comes round.
pub const LIMITED_TURN: f64 = 6.25;
/// Least share of the arena that the arm can reach when targets are drawn: below it, drawing until one can be reached
/// would take too long.
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
/// Units of a map along one input when the file does not say.
pub const DEFAULT_UNITS: usize = 16;
/// Most units of an encoder, all maps together.
pub const MAX_FEATURES: usize = 65_536;
/// Radius of a kernel, in the unit of its inputs.
pub const RADIUS: RangeInclusive<f64> = 1e-9..=1e9;
/// Largest spacing of neighbouring units along an input, in radii. At
/// 10, an input half-way between two units still activates both with `exp(-12.5)`, and a 2-D map with `exp(-25)`, whose
/// square is a normal f32: the features of an input within the range never all vanish, and can be scaled to unit norm.
pub const SPACING_PER_RADIUS: f64 = 10.0;
/// Largest command in magnitude.
pub const COMMAND: RangeInclusive<f64> = 1e-9..=1e6;
/// Least standard deviation of the exploration noise; the greatest is the largest command.
pub const MIN_SIGMA: f64 = 1e-9;
/// The step `alpha / sigma^2`. Features of unit norm diverge above 2 for rewards of the order of 1; 1000 leaves room
/// for rewards that are small.
pub const STEP: RangeInclusive<f64> = 0.0..=1000.0;
/// Largest angle in the gate's limits of position in magnitude, rad; one that no joint reaches is no limit.
pub const POSITION: f64 = 1000.0;
/// Least distance between the two limits of a position, rad.
pub const LEAST_COURSE: f64 = 1e-3;
/// Most faults of channels, and of processes.
pub const MAX_FAULTS: usize = 16;
/// Most ticks by which a sample is delayed or doubled: what is under way has to be kept.
pub const MAX_DELAY: u64 = 16;
/// Most ticks of a frozen channel.
pub const MAX_FREEZE: u64 = 1_000_000;
/// Most ticks at which one thing happens to a process.
pub const MAX_STRIKES: usize = 1000;
/// How long a process is stopped, ms.
pub const STOPPED_MS: RangeInclusive<f64> = 1.0..=60_000.0;
/// Most ticks of hold, of decay or of the gate's ramp.
pub const MAX_HOLD: u32 = 1_000_000;
/// Time constants of a learner, ticks.
pub const LEARNER_TICKS: RangeInclusive<f64> = 1.0..=1e12;
/// Factor with which the last reward is a feature of the critic.
pub const REWARD_FEATURE: RangeInclusive<f64> = 0.0..=1000.0;
/// Step of what squared noise costs: the squares' own variance is 2, so that above 1/2 it could not settle.
pub const NOISE_STEP: RangeInclusive<f64> = 0.0..=0.1;
/// Largest temporal-difference error that counts, in means of its size; below 1 the usual error would not count in full.
pub const ERROR_BOUND: RangeInclusive<f64> = 1.0..=1e9;
/// Regularisation of the natural gradient: below 1e-6 the inverse would lose its digits.
pub const REGULARISATION: RangeInclusive<f64> = 1e-6..=1e6;
/// Standard deviations in the reward model.
pub const SPREADS: RangeInclusive<f64> = 1e-6..=1e6;
/// Imagined movements for a step, ticks of each, steps a tick.
pub const IMAGINED: RangeInclusive<usize> = 1..=1024;
/// Ticks of the past that the learned-reward rule remembers.
pub const MEMORY: RangeInclusive<usize> = 1..=1_000_000;
/// How many times the last tick of an imagined movement counts.
pub const LAST_COUNTS: RangeInclusive<f64> = 1.0..=1000.0;
/// Size of the learned-reward rule's step, in units of a weight.
pub const MODEL_STEP: RangeInclusive<f64> = 0.0..=1.0;
/// Most inputs of a learned reward: its covariance grows with their number to the fourth.
pub const MODEL_INPUTS: usize = 10;
/// Most units along an input for a learned reward, which decorrelates each line: the work grows with the cube.
pub const MODEL_UNITS: usize = 256;
/// Most features for a natural gradient, which inverts their second-moment matrix: the same.
pub const METRIC_FEATURES: usize = 1024;
/// Priorities under SCHED_FIFO.
pub const PRIORITY: RangeInclusive<u32> = 1..=99;
/// Largest number of a core: as many as the system's set of cores holds.
pub const MAX_CORE: u32 = 1023;
/// Most stack that is touched beforehand, KiB: half of the usual 8 MiB.
pub const MAX_STACK_KIB: u32 = 4096;
/// Limits of an emulated servo: rad/s and rad/s^2.
pub const SERVO_RATE: RangeInclusive<f64> = 0.001..=1e6;
/// Latency and jitter of an emulated servo's answers, us.
pub const SERVO_LATENCY_US: RangeInclusive<f64> = 0.0..=1e6;
/// Noise of an emulated servo's position, steps.
pub const SERVO_NOISE: RangeInclusive<f64> = 0.0..=1000.0;
/// Instants of an emulated servo's faults, s.
pub const SERVO_SECONDS: RangeInclusive<f64> = 0.0..=1e9;
/// Delay of an emulated servo's slow answers, ms.
pub const SERVO_DELAY_MS: RangeInclusive<f64> = 0.001..=60_000.0;
