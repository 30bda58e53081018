//! The header of a log: everything that a reader needs to interpret the log without this program.

use super::{CHANNELS, LogError};
use crate::scenario::{Plan, SignalConfig};
use crate::wire::flag::FLAGS;
use crate::wire::{ChannelNames, Command, Gap, Learning, Observation, Sample, schema_hash};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// The clock whose instants the samples carry.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LogClock {
    /// Lockstep: tick k happens at `k * period`, starting from 0.
    Virtual,
    /// Real time: the system's monotonic clock.
    Monotonic,
}

impl LogClock {
    /// The name in the log.
    pub const fn name(self) -> &'static str {
        match self {
            LogClock::Virtual => "virtual",
            LogClock::Monotonic => "CLOCK_MONOTONIC",
        }
    }
}

/// A run's description. Every field is written to the metadata record `tectum.run` under its own name: hashes
/// and the run's id in hexadecimal, lists as JSON, the machine's facts with the prefix `machine.`. The
/// scenario's text becomes an attachment. The record also names the version of each sample type (`wire.*`) and
/// the bits of a header's flags (`flags`).
#[derive(Debug, Clone, PartialEq)]
pub struct LogHeader {
    /// The scenario as TOML, every default filled in.
    pub scenario: String,
    /// Id of the run.
    pub run: u64,
    /// The scenario's name.
    pub name: String,
    /// Seed of every random stream.
    pub seed: u64,
    /// Planned number of ticks.
    pub ticks: u64,
    /// The mode of the run, for example `lockstep` or `real-time`.
    pub mode: String,
    /// Period of the tick, ns.
    pub period_ns: u64,
    /// Every `every`-th tick is written.
    pub every: u64,
    /// Hash over the layout of all samples.
    pub schema_hash: u64,
    /// Hash of the resolved scenario.
    pub scenario_hash: u64,
    /// Identity of the build that writes the log.
    pub build: String,
    /// Inputs of an observation, in order, with units and ranges.
    pub inputs: Vec<SignalConfig>,
    /// Outputs of a command, in order, with units and ranges.
    pub outputs: Vec<SignalConfig>,
    /// Names of an observation's measures, in order.
    pub measures: Vec<String>,
    /// Names of the agent's own columns in the learning record, in order.
    pub columns: Vec<String>,
    /// Names of the channels; a topic is `/` and the name.
    pub channels: ChannelNames,
    /// Facts about the machine: kernel, processor, cores, host and others.
    pub machine: BTreeMap<String, String>,
    /// Real time: the real-time settings that each process requested, those in effect and those refused, as
    /// JSON by the process's name, with the prefix `realtime.`. Of a restarted process, the first report.
    pub realtime: BTreeMap<String, String>,
    /// The clock of all instants.
    pub clock: LogClock,
    /// Start of tick 0 on that clock, ns; 0 on the virtual clock.
    pub t0_ns: u64,
    /// Wall time at that instant, ns since 1970. On the virtual clock: when the run was launched.
    pub wall_at_t0_ns: u64,
    /// What the run began with, if not with a fresh learner, and whether the learner is frozen: the record then has the
    /// keys `started_from` (the other run, as the user named it), `started_from.tick`, `started_from.check` (checksum
    /// of the checkpoint) and `frozen`.
    pub beginning: BTreeMap<String, String>,
    /// Which segment of the run's log the file is, and what the earlier segments hold.
    pub segment: LogSegment,
}

/// A segment of a run's log: a restarted logger does not change the existing files, and writes another.
///
/// In the metadata record `tectum.run` its number is under `segment`, and for each channel (`observation` and
/// so on) `begins.<channel>` and `before.<channel>.written`, `.lost`, `.thinned` and `.duplicates`;
/// `before.gap.written` too. A log without these keys is the first of its run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct LogSegment {
    /// The logger's start number within the run; 0 for the first file.
    pub number: u32,
    /// Sequence number of the first sample that no earlier segment accounts for as written, lost, or thinned.
    /// In the first segment 0, unless the run continues another one.
    pub begins: [u64; 3],
    /// Messages in earlier segments: observations, commands, learning records, gaps.
    pub written: [u64; 4],
    /// Samples that earlier segments state to be missing.
    pub lost: [u64; 3],
    /// Samples that earlier segments left out on purpose.
    pub thinned: [u64; 3],
    /// Samples received twice so far, of which one was dropped.
    pub duplicates: [u64; 3],
}

impl LogSegment {
    /// Sequence number of the run's first sample on channel `i`: not 0 if the run continues another one.
    pub fn first(&self, i: usize) -> u64 {
        self.begins[i].saturating_sub(self.written[i]).saturating_sub(self.lost[i]).saturating_sub(self.thinned[i])
    }

    fn add_to_map(&self, map: &mut BTreeMap<String, String>) {
        let mut put = |key: String, value: u64| map.insert(key, value.to_string());
        put("segment".into(), self.number.into());
        put("before.gap.written".into(), self.written[3]);
        for (i, name) in CHANNELS.iter().enumerate() {
            put(format!("begins.{name}"), self.begins[i]);
            put(format!("before.{name}.written"), self.written[i]);
            put(format!("before.{name}.lost"), self.lost[i]);
            put(format!("before.{name}.thinned"), self.thinned[i]);
            put(format!("before.{name}.duplicates"), self.duplicates[i]);
        }
    }

    /// The segment that `tectum.run` describes; a missing or invalid key counts as 0.
    pub(super) fn from_map(map: &BTreeMap<String, String>) -> LogSegment {
        let number = |key: &str| map.get(key).and_then(|value| value.parse::<u64>().ok()).unwrap_or(0);
        let each = |key: &str| CHANNELS.map(|name| number(&format!("before.{name}.{key}")));
        let [observation, command, learning] = each("written");
        LogSegment {
            number: u32::try_from(number("segment")).unwrap_or(0),
            begins: CHANNELS.map(|name| number(&format!("begins.{name}"))),
            written: [observation, command, learning, number("before.gap.written")],
            lost: each("lost"),
            thinned: each("thinned"),
            duplicates: each("duplicates"),
        }
    }
}

impl LogHeader {
    /// The run, as the log describes it.
    pub(crate) fn run_text(&self) -> String {
        format!("{:016x}", self.run)
    }

    /// The description of a run of `plan` on the virtual clock; for real time set [`clock`](Self::clock) and
    /// its two instants.
    pub fn new(plan: &Plan, run: u64, mode: &str, machine: BTreeMap<String, String>) -> LogHeader {
        // A scenario was read from TOML, so it can be written as TOML. If not, `to_map` refuses the empty text.
        let scenario = plan.scenario.text().unwrap_or_default();
        LogHeader {
            scenario,
            run,
            name: plan.scenario.name.clone(),
            seed: plan.scenario.seed,
            ticks: plan.scenario.ticks,
            mode: mode.to_owned(),
            period_ns: plan.period_ns,
            every: plan.scenario.log.every,
            schema_hash: schema_hash(),
            scenario_hash: plan.hash,
            build: crate::BUILD.to_owned(),
            inputs: plan.inputs.clone(),
            outputs: plan.outputs.clone(),
            measures: plan.measures.clone(),
            columns: Vec::new(),
            channels: plan.scenario.channels.clone(),
            machine,
            realtime: BTreeMap::new(),
            clock: LogClock::Virtual,
            t0_ns: 0,
            wall_at_t0_ns: 0,
            beginning: BTreeMap::new(),
            segment: LogSegment::default(),
        }
    }

    /// Topics of observation, command and learning.
    pub(super) fn topics(&self) -> [String; 3] {
        [&self.channels.observation, &self.channels.command, &self.channels.learning].map(|name| format!("/{name}"))
    }

    /// The content of `tectum.run`.
    pub(super) fn to_map(&self, path: &Path) -> Result<BTreeMap<String, String>, LogError> {
        let invalid = |why: String| LogError::Header { path: path.to_owned(), why };
        if self.scenario.is_empty() {
            return Err(invalid("its scenario has no text, or none that TOML can hold".into()));
        }
        let json = |key: &str, value: serde_json::Result<String>| value.map_err(|e| invalid(format!("{key}: {e}")));
        let mut map: BTreeMap<String, String> =
            self.machine.iter().map(|(k, v)| (format!("machine.{k}"), v.clone())).collect();
        map.extend(self.realtime.iter().map(|(k, v)| (format!("realtime.{k}"), v.clone())));
        let mut put = |key: &str, value: String| map.insert(key.to_owned(), value);
        put("run", self.run_text());
        put("name", self.name.clone());
        put("seed", self.seed.to_string());
        put("ticks", self.ticks.to_string());
        put("mode", self.mode.clone());
        put("period_ns", self.period_ns.to_string());
        put("every", self.every.to_string());
        put("schema_hash", format!("{:016x}", self.schema_hash));
        put("scenario_hash", format!("{:016x}", self.scenario_hash));
        put("build", self.build.clone());
        put("inputs", json("inputs", serde_json::to_string(&self.inputs))?);
        put("outputs", json("outputs", serde_json::to_string(&self.outputs))?);
        put("measures", json("measures", serde_json::to_string(&self.measures))?);
        put("columns", json("columns", serde_json::to_string(&self.columns))?);
        let flags: BTreeMap<&str, u32> = FLAGS.iter().map(|flag| (flag.name, flag.bit)).collect();
        put("flags", json("flags", serde_json::to_string(&flags))?);
        put("clock", self.clock.name().to_owned());
        put("t0_ns", self.t0_ns.to_string());
        put("wall_at_t0_ns", self.wall_at_t0_ns.to_string());
        for (name, topic) in CHANNELS.iter().zip(self.topics()) {
            put(&format!("topic.{name}"), topic);
        }
        put("wire.observation", Observation::NAME.to_owned());
        put("wire.command", Command::NAME.to_owned());
        put("wire.learning", Learning::NAME.to_owned());
        put("wire.gap", Gap::NAME.to_owned());
        map.extend(self.beginning.clone());
        self.segment.add_to_map(&mut map);
        Ok(map)
    }
}

/// The names of the flags that are set, separated by `|`; bits without a name as one hexadecimal number.
pub fn flag_words(flags: u32) -> String {
    let known = FLAGS.iter().filter(|flag| flags & flag.bit != 0).map(|flag| flag.name.to_owned());
    let other = flags & !FLAGS.iter().fold(0, |all, flag| all | flag.bit);
    let other = (other != 0).then(|| format!("{other:#x}"));
    known.chain(other).collect::<Vec<_>>().join("|")
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::wire::flag;

    /// A header for tests, on the virtual clock.
    pub fn sample_header() -> LogHeader {
        let signal = |name: &str, unit: &str| SignalConfig {
            name: name.into(),
            unit: unit.into(),
            min: -1.0,
            max: 1.0,
            wraps: None,
        };
        LogHeader {
            scenario: "name = \"test\"\nticks = 9\n".into(),
            run: 0xabc,
            name: "test".into(),
            seed: 7,
            ticks: 9,
            mode: "lockstep".into(),
            period_ns: 50_000_000,
            every: 1,
            schema_hash: schema_hash(),
            scenario_hash: 0xdef,
            build: "test".into(),
            inputs: vec![signal("target_x", "m")],
            outputs: vec![signal("rate_1", "rad/s")],
            measures: vec!["error".into()],
            columns: vec!["gain".into()],
            channels: ChannelNames::default(),
            machine: BTreeMap::from([("kernel".into(), "Linux".into())]),
            realtime: BTreeMap::new(),
            clock: LogClock::Virtual,
            t0_ns: 0,
            wall_at_t0_ns: 0,
            beginning: BTreeMap::new(),
            segment: LogSegment::default(),
        }
    }

    #[test]
    fn the_map_describes_signals_topics_and_flags() {
        let realtime = BTreeMap::from([("plant".into(), "{}".into())]);
        let map = LogHeader { realtime, ..sample_header() }.to_map(Path::new("x")).unwrap();
        assert_eq!(map["run"], "0000000000000abc");
        assert_eq!(map["inputs"], r#"[{"name":"target_x","unit":"m","min":-1.0,"max":1.0}]"#);
        assert_eq!(map["wire.observation"], "tectum.Observation.v2");
        assert_eq!(map["topic.command"], "/command");
        assert_eq!(map["machine.kernel"], "Linux");
        assert_eq!(map["realtime.plant"], "{}");
        assert!(map["flags"].contains("\"LEARNED\":65536"));
    }

    #[test]
    fn a_segment_is_equal_after_a_round_trip_through_its_map() {
        let segment = LogSegment {
            number: 3,
            begins: [10, 11, 12],
            written: [7, 8, 9, 2],
            lost: [1, 2, 3],
            thinned: [2, 1, 0],
            duplicates: [4, 5, 6],
        };
        let map = LogHeader { segment, ..sample_header() }.to_map(Path::new("x")).unwrap();
        assert_eq!((map["segment"].as_str(), map["begins.command"].as_str()), ("3", "11"));
        assert_eq!(LogSegment::from_map(&map), segment);
        // A log written before segments were introduced.
        assert_eq!(LogSegment::from_map(&BTreeMap::new()), LogSegment::default());
    }

    #[test]
    fn flags_have_names() {
        assert_eq!(flag_words(0), "");
        assert_eq!(flag_words(flag::MISSED | flag::HELD | flag::DIVERGED), "MISSED|HELD|DIVERGED");
        assert_eq!(flag_words(flag::UNARMED | flag::TRIPPED | flag::BLIND), "UNARMED|TRIPPED|BLIND");
        assert_eq!(flag_words(flag::LEARNED | 1 << 30), "LEARNED|0x40000000");
    }

    #[test]
    fn a_plans_scenario_can_be_read_from_its_header() {
        let text = "name = \"reach\"\nticks = 9\n[plant.arm]\n[encoder]\nmaps = [{ inputs = [\"x\"], radius = 0.5 }]\n";
        let mut plan = Plan {
            scenario: toml::from_str(text).unwrap(),
            period_ns: 50_000_000,
            inputs: Vec::new(),
            outputs: Vec::new(),
            measures: Vec::new(),
            error: None,
            scalars: Vec::new(),
            maps: Vec::new(),
            hash: 5,
            warnings: Vec::new(),
        };
        let header = LogHeader::new(&plan, 3, "lockstep", BTreeMap::new());
        assert_eq!(toml::from_str::<crate::scenario::Scenario>(&header.scenario).unwrap(), plan.scenario);
        assert_eq!((header.run, header.seed, header.every, header.scenario_hash), (3, 1, 1, 5));
        assert_eq!((header.clock, header.t0_ns, header.wall_at_t0_ns), (LogClock::Virtual, 0, 0));
        // A seed may be larger than the largest integer that TOML guarantees.
        plan.scenario.seed = u64::MAX;
        let header = LogHeader::new(&plan, 3, "lockstep", BTreeMap::new());
        assert_eq!(toml::from_str::<crate::scenario::Scenario>(&header.scenario).unwrap().seed, u64::MAX);
    }

    #[test]
    fn a_run_without_a_scenario_is_refused() {
        let header = LogHeader { scenario: String::new(), ..sample_header() };
        let error = header.to_map(Path::new("/x/log.mcap")).unwrap_err().to_string();
        assert!(error.contains("/x/log.mcap") && error.contains("scenario"), "{error}");
    }
}
