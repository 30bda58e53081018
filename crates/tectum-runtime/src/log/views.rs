//! Views: what a packed log holds beside its samples, for programs that draw curves by name, and the arm in space.
//!
//! A sample is an array of numbers, and replay needs it as it was. A person looks for `theta_1` and its unit. So a
//! packed log repeats the numbers on topics whose messages have the scenario's names as fields:
//!
//! | topic | type | content, at the time of the sample |
//! |---|---|---|
//! | `/inputs` | `tectum/msg/Inputs` | the inputs of an observation |
//! | `/applied` | `tectum/msg/Applied` | the applied command of the tick before |
//! | `/measures` | `tectum/msg/Measures` | reward and measures of the tick before |
//! | `/outputs` | `tectum/msg/Outputs` | mean and drawn command |
//! | `/joint_states` | `sensor_msgs/msg/JointState` | the inputs in rad, as ROS programs expect them |
//! | `/loss` | `tectum/msg/Loss` | the loss of the tick before: the reward with its sign turned |
//! | `/error` | `tectum/msg/Error` | the error of the tick before, if the plant measures one |
//! | `/budget` | `tectum/msg/Budget` | real time: how the tick was spent, us; at the time of the learning record |
//! | `/transforms` | `tf2_msgs/msg/TFMessage` | the simulator's arm: a frame for each link and one for its end |
//! | `/scene/links`, `-/target`, `-/path` | `visualization_msgs/msg/MarkerArray` | arm, target, path of its end |
//!
//! All are CDR with definitions in ROS 2's language, as the samples are: some readers refuse a file with another
//! encoding. Readers of samples pass over them. The same messages go to viewers while a run goes on.

mod cdr;
mod scene;
mod schemas;

use super::{LogReader, LogRecord};
use crate::scenario::{ArmConfig, Plan, Scenario, SignalConfig};
use crate::wire::{Header, flag};
use cdr::CdrMessage;
use scene::ArmScene;
use schemas::definition;

/// Ticks whose instants are kept until their learning record has come.
const KEPT_TICKS: usize = 64;

/// What views are made of.
#[derive(Debug, Clone, Default)]
pub struct ViewFacts {
    /// The inputs of an observation, in order.
    pub inputs: Vec<SignalConfig>,
    /// The outputs of a command, in order.
    pub outputs: Vec<SignalConfig>,
    /// Names of the measures, in order.
    pub measures: Vec<String>,
    /// Index of the measure that is the error.
    pub error: Option<usize>,
    /// Unit of the error; empty if it is not known.
    pub error_unit: String,
    /// The simulator's arm, if the inputs tell its posture.
    pub arm: Option<ArmConfig>,
    /// Period of the tick, ns, in real time; in lockstep no time is spent.
    pub period_ns: Option<u64>,
    /// Offset from the run's clock to wall time, ns.
    pub shift_ns: i128,
}

/// A topic of a view.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ViewChannel {
    /// The topic.
    pub topic: &'static str,
    /// The type of its messages, which are encoded in CDR.
    pub schema_name: &'static str,
    /// The type's definition in ROS 2's language (`ros2msg`).
    pub schema: String,
}

/// A message of a view.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ViewMessage<'a> {
    /// Index of its channel in [`SampleViews::channels`].
    pub channel: usize,
    /// Sequence number of the sample from which it was made.
    pub sequence: u64,
    /// Wall time of that sample, ns since 1970; in lockstep counted from the wall time of tick 0.
    pub ns: u64,
    /// The encoded message.
    pub data: &'a [u8],
}

impl ViewFacts {
    /// The facts that a log states of its run. Of a scenario that this build cannot read, arm and error are not known.
    pub fn of_log(log: &LogReader) -> Self {
        let list = |key: &str| log.run(key).unwrap_or_default().to_owned();
        let signals = |key: &str| serde_json::from_str(&list(key)).unwrap_or_default();
        let instant = |key: &str| log.run(key).and_then(|ns| ns.parse::<i128>().ok()).unwrap_or(0);
        let plan = Scenario::parse(log.scenario(), "scenario.toml").and_then(Scenario::plan).ok();
        let realtime = log.run("clock") == Some(super::LogClock::Monotonic.name());
        let facts = plan.map(|plan| Self::of_plan(&plan, realtime, 0)).unwrap_or_default();
        Self {
            inputs: signals("inputs"),
            outputs: signals("outputs"),
            measures: serde_json::from_str(&list("measures")).unwrap_or_default(),
            shift_ns: instant("wall_at_t0_ns") - instant("t0_ns"),
            ..facts
        }
    }

    /// The facts of a plan's run, whose clock is `shift_ns` before wall time.
    pub fn of_plan(plan: &Plan, realtime: bool, shift_ns: i128) -> Self {
        Self {
            inputs: plan.inputs.clone(),
            outputs: plan.outputs.clone(),
            measures: plan.measures.clone(),
            error: plan.error,
            error_unit: plan.error_unit().to_owned(),
            arm: plan.drawable_arm().cloned(),
            period_ns: realtime.then_some(plan.period_ns),
            shift_ns,
        }
    }
}

/// Indices of the channels that not every run has.
#[derive(Debug, Clone, Copy, Default)]
struct OptionalChannels {
    error: Option<usize>,
    budget: Option<usize>,
    /// The first of four: transforms, links, target and path.
    scene: Option<usize>,
}

/// The instants of a tick, ns: of its schedule, its observation and its command.
#[derive(Debug, Clone, Copy, Default)]
struct TickStamps {
    tick: u64,
    scheduled: u64,
    observed: u64,
    commanded: u64,
}

/// The views of a run's samples.
#[derive(Debug)]
pub struct SampleViews {
    facts: ViewFacts,
    channels: Vec<ViewChannel>,
    optional: OptionalChannels,
    /// Names and indices of the inputs in rad.
    joints: Vec<(String, usize)>,
    scene: Option<ArmScene>,
    stamps: [TickStamps; KEPT_TICKS],
    cdr: CdrMessage,
}

/// Indices of the channels that every run has.
const INPUTS: usize = 0;
const APPLIED: usize = 1;
const MEASURES: usize = 2;
const OUTPUTS: usize = 3;
const JOINT_STATES: usize = 4;
const LOSS: usize = 5;

impl SampleViews {
    /// The views that these facts allow.
    pub fn new(facts: ViewFacts) -> Self {
        let named = |signals: &[SignalConfig], after: &str| -> Vec<(String, String)> {
            signals.iter().map(|s| (format!("{}{after}", s.name), s.unit.clone())).collect()
        };
        let bare = |name: &str| (name.to_owned(), String::new());
        let measures = std::iter::once(bare("reward")).chain(facts.measures.iter().map(|name| bare(name))).collect();
        let outputs = [named(&facts.outputs, "_mean"), named(&facts.outputs, "_drawn")].concat();
        let mut channels = vec![
            numbers("/inputs", "tectum/msg/Inputs", named(&facts.inputs, "")),
            numbers("/applied", "tectum/msg/Applied", named(&facts.outputs, "")),
            numbers("/measures", "tectum/msg/Measures", measures),
            numbers("/outputs", "tectum/msg/Outputs", outputs),
            schemas::joint_state_channel(),
            numbers("/loss", "tectum/msg/Loss", vec![("loss".to_owned(), "a tick".to_owned())]),
        ];
        let mut add = |channel: ViewChannel| {
            channels.push(channel);
            channels.len() - 1
        };
        let error = facts.error.map(|_| {
            let field = ("error".to_owned(), facts.error_unit.clone());
            add(numbers("/error", "tectum/msg/Error", vec![field]))
        });
        let budget = facts.period_ns.map(|_| {
            let stages = ["sensing", "answer", "learning", "slack"];
            let fields = stages.map(|stage| (format!("{stage}_us"), "us".to_owned()));
            add(numbers("/budget", "tectum/msg/Budget", fields.to_vec()))
        });
        let scene = facts.arm.as_ref().map(|_| schemas::scene_channels().map(&mut add)[0]);
        let joints = facts.inputs.iter().enumerate().filter(|(_, input)| input.unit == "rad");
        Self {
            joints: joints.map(|(i, input)| (input.name.clone(), i)).collect(),
            scene: facts.arm.clone().map(ArmScene::new),
            channels,
            optional: OptionalChannels { error, budget, scene },
            stamps: [TickStamps::default(); KEPT_TICKS],
            cdr: CdrMessage::default(),
            facts,
        }
    }

    /// The topics, in the order of their indices.
    pub fn channels(&self) -> &[ViewChannel] {
        &self.channels
    }

    /// Makes the views of a sample, and hands each to `emit`. Samples come in the order of their ticks.
    ///
    /// # Errors
    /// The first error of `emit`.
    pub fn take<E>(
        &mut self,
        record: &LogRecord,
        mut emit: impl FnMut(ViewMessage<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        let (inputs, outputs, measures) =
            (self.facts.inputs.len(), self.facts.outputs.len(), self.facts.measures.len());
        let Some(header) = record.header() else { return Ok(()) };
        let (sequence, ns) = (header.sequence, self.wall_ns(header.published_ns));
        let mut send = |channel: usize, data: &[u8]| emit(ViewMessage { channel, sequence, ns, data });
        let stamps = &mut self.stamps[header.tick as usize % KEPT_TICKS];
        match record {
            LogRecord::Observation(s) => {
                let (scheduled, observed) = (header.scheduled_ns, header.published_ns);
                *stamps = TickStamps { tick: header.tick, scheduled, observed, commanded: 0 };
                send(INPUTS, self.cdr.numbers(&[&s.inputs[..inputs]]))?;
                send(APPLIED, self.cdr.numbers(&[&s.applied[..outputs]]))?;
                send(MEASURES, self.cdr.numbers(&[&[s.reward], &s.measures[..measures]]))?;
                if !self.joints.is_empty() {
                    send(JOINT_STATES, self.cdr.joint_state(ns, &self.joints, &s.inputs))?;
                }
                if header.flags & flag::FIRST == 0 {
                    send(LOSS, self.cdr.numbers(&[&[-s.reward]]))?;
                    if let (Some(channel), Some(index)) = (self.optional.error, self.facts.error) {
                        send(channel, self.cdr.numbers(&[&[s.measures[index]]]))?;
                    }
                }
                match (&mut self.scene, self.optional.scene) {
                    (Some(scene), Some(first)) => scene.take(s, ns, |i, data| send(first + i, data)),
                    _ => Ok(()),
                }
            }
            LogRecord::Command(s) => {
                if stamps.tick == header.tick {
                    stamps.commanded = header.published_ns;
                }
                send(OUTPUTS, self.cdr.numbers(&[&s.mean[..outputs], &s.drawn[..outputs]]))
            }
            LogRecord::Learning(_) => match (self.optional.budget, self.facts.period_ns) {
                (Some(channel), Some(period)) => match budget(stamps, header, period) {
                    Some(stages) => send(channel, self.cdr.numbers(&[&stages])),
                    None => Ok(()),
                },
                _ => Ok(()),
            },
            LogRecord::Gap(_) => Ok(()),
        }
    }

    fn wall_ns(&self, ns: u64) -> u64 {
        (i128::from(ns) + self.facts.shift_ns).clamp(0, i128::from(u64::MAX)) as u64
    }
}

/// How the tick of a learning record was spent, us: sensing, answer, learning, slack. `None` if observation or command
/// of the tick are not known.
fn budget(stamps: &TickStamps, learned: &Header, period_ns: u64) -> Option<[f32; 4]> {
    if stamps.tick != learned.tick || stamps.commanded == 0 {
        return None;
    }
    let ends = [stamps.observed, stamps.commanded, learned.published_ns, stamps.scheduled + period_ns];
    let mut begin = stamps.scheduled;
    Some(ends.map(|end| {
        let us = end.saturating_sub(begin) as f32 / 1e3;
        begin = end;
        us
    }))
}

/// A channel whose messages are 32-bit floating-point numbers with these names and units.
fn numbers(topic: &'static str, schema_name: &'static str, fields: Vec<(String, String)>) -> ViewChannel {
    ViewChannel { topic, schema_name, schema: definition(fields) }
}
