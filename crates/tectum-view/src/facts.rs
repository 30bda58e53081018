//! What is known of a run before its first tick.

/// A run, as its manifest and scenario describe it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RunFacts {
    /// Name of the run's folder.
    pub name: String,
    /// Name of its scenario.
    pub scenario: String,
    /// Seed of all its randomness.
    pub seed: u64,
    /// Whether it runs on the real clock; otherwise it is in lockstep.
    pub realtime: bool,
    /// Period of the tick, ns.
    pub period_ns: u64,
    /// Planned length, ticks.
    pub ticks: u64,
    /// The inputs of an observation, in order.
    pub inputs: Vec<SignalRange>,
    /// The outputs of a command, in order.
    pub outputs: Vec<SignalRange>,
    /// Names of the measures, in order.
    pub measures: Vec<String>,
    /// Index of the measure that is the error.
    pub error: Option<usize>,
    /// Unit of the error; empty if it is not known.
    pub error_unit: String,
    /// Where the arm moves, if the plant is an arm whose postures can be drawn.
    pub arm: Option<ArmFrame>,
    /// Changes of the plant that the scenario announces: first tick, and what it is.
    pub changes: Vec<(u64, String)>,
    /// Flags of samples that are worth an event: bit, and what it says.
    pub flags: Vec<(u32, String)>,
}

/// A signal with its range.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SignalRange {
    /// Name.
    pub name: String,
    /// Unit; may be empty.
    pub unit: String,
    /// Least value, in that unit.
    pub min: f32,
    /// Greatest value, in that unit.
    pub max: f32,
}

/// The square in which an arm is drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArmFrame {
    /// Centre, m.
    pub centre: [f32; 2],
    /// Half of its side, m.
    pub half: f32,
}

impl RunFacts {
    /// Seconds from tick 0 to the begin of `tick`, on the run's own time.
    pub fn seconds(&self, tick: u64) -> f64 {
        tick as f64 * self.period_ns as f64 / 1e9
    }
}
