//! `[faults]`: faults that a run injects on purpose, and their checks. A seed always gives the same faults.
//!
//! Channel faults act where a sample is received (`FaultyChannel` of `runtime`). The launcher injects process
//! faults.

use serde::{Deserialize, Serialize};

use super::check::{number, show, ticks};
use super::error::Violation;
use super::limits;
use crate::Role;

/// `[faults]`: injected faults.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FaultsConfig {
    /// Faults of channels. Whether a fault acts in a tick depends only on its index in this list, the seed and
    /// the tick.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub channel: Vec<ChannelFault>,
    /// Faults of processes.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub process: Vec<ProcessFault>,
}

/// `[[faults.channel]]`: a fault of one channel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ChannelFault {
    /// The channel. The fault acts at its receiver: observations at the controller, commands at the plant,
    /// learning records at the logger.
    pub channel: FaultChannel,
    /// The effect on a sample.
    pub kind: FaultKind,
    /// Probability in each tick, above 0 and up to 1. Left out: every tick from `from` to `until`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub probability: Option<f64>,
    /// The first tick in which the fault may act. Default: 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from: Option<u64>,
    /// The first tick in which the fault no longer acts. Default: it acts until the end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until: Option<u64>,
    /// Ticks of a delay, from a sample to its duplicate, or of a freeze. Default: 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ticks: Option<u64>,
    /// The value that `corrupt` writes over the sample's values.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub value: Option<FaultValue>,
}

/// A channel into which faults can be injected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FaultChannel {
    /// Plant to controller. The log has the observations as they were sent.
    Observation,
    /// Controller to plant. The log has the commands as they were sent.
    Command,
    /// Controller to logger. A record that does not arrive in its tick is missing from the log, and the log
    /// states it.
    Learning,
}

/// The effect of a channel fault on a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FaultKind {
    /// The sample arrives `ticks` later.
    Delay,
    /// The sample never arrives.
    Drop,
    /// The sample arrives, and arrives again `ticks` later.
    Duplicate,
    /// The sample arrives after the next one.
    Reorder,
    /// For `ticks` ticks from this one on, the channel repeats the sample that was received last and delivers
    /// no other.
    Freeze,
    /// The sample arrives with `value` in place of an observation's inputs or a command's outputs.
    Corrupt,
}

/// The value in a corrupted sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FaultValue {
    /// Not a number.
    Nan,
    /// 1e30.
    Huge,
}

/// `[[faults.process]]`: a fault of a process at given ticks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProcessFault {
    /// The process.
    pub process: FaultProcess,
    /// The kind of fault.
    #[serde(rename = "do")]
    pub act: ProcessFaultKind,
    /// The ticks, in rising order, as the plant's status board shows them.
    pub at: Vec<u64>,
    /// Duration of a stop, ms.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub for_ms: Option<f64>,
}

/// A process of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FaultProcess {
    /// The plant.
    Plant,
    /// The controller.
    Controller,
    /// The logger.
    Logger,
}

/// The kind of a process fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ProcessFaultKind {
    /// SIGKILL.
    Kill,
    /// SIGSTOP, and SIGCONT after `for_ms`.
    Stop,
    /// SIGTERM, after which the launcher starts the process again.
    Restart,
}

impl FaultsConfig {
    /// Whether there are no faults.
    pub fn is_nothing(&self) -> bool {
        self.channel.is_empty() && self.process.is_empty()
    }

    /// One line of text per fault. The summary prints them, so that the run is not mistaken for one without
    /// faults.
    pub fn in_words(&self) -> Vec<String> {
        let channels = self.channel.iter().map(ChannelFault::in_words);
        channels.chain(self.process.iter().map(ProcessFault::in_words)).collect()
    }
}

impl ChannelFault {
    /// Ticks of a delay, to a duplicate, or of a freeze.
    pub fn ticks(&self) -> u64 {
        self.ticks.unwrap_or(1)
    }

    fn in_words(&self) -> String {
        let mut text = format!("{} {}", keyword(&self.channel), keyword(&self.kind));
        if let Some(value) = self.value {
            text += if value == FaultValue::Nan { " (not a number)" } else { " (huge)" };
        }
        if self.kind.takes_ticks() {
            text += &format!(" by {}", self.ticks());
        }
        if let Some(probability) = self.probability {
            text += &format!(", {} a tick", show(probability));
        }
        match (self.from, self.until) {
            (None, None) => {}
            (Some(from), None) => text += &format!(", from tick {from}"),
            (from, Some(until)) => text += &format!(", ticks {} to {}", from.unwrap_or(0), until.saturating_sub(1)),
        }
        text
    }
}

impl FaultKind {
    /// Whether the key `ticks` applies to this kind.
    pub fn takes_ticks(self) -> bool {
        matches!(self, Self::Delay | Self::Duplicate | Self::Freeze)
    }
}

impl ProcessFault {
    fn in_words(&self) -> String {
        let count = self.at.len();
        let times = if count == 1 { format!("at tick {}", self.at[0]) } else { format!("{count} times") };
        format!("{} {} {times}", keyword(&self.process), keyword(&self.act))
    }
}

impl FaultProcess {
    /// Its role in the run.
    pub fn role(self) -> Role {
        match self {
            Self::Plant => Role::Plant,
            Self::Controller => Role::Controller,
            Self::Logger => Role::Logger,
        }
    }
}

/// The name of an enum's variant in the file.
fn keyword<T: Serialize>(value: &T) -> String {
    serde_json::to_value(value).ok().and_then(|word| word.as_str().map(str::to_owned)).unwrap_or_default()
}

/// Checks ranges, and that each kind of fault has exactly the keys that apply to it.
pub(super) fn check(faults: &FaultsConfig) -> Result<(), Violation> {
    for (key, n) in [("faults.channel", faults.channel.len()), ("faults.process", faults.process.len())] {
        if n > limits::MAX_FAULTS {
            return Err(Violation::new(key, format_args!("has {n} entries; give at most 16")));
        }
    }
    for (i, fault) in faults.channel.iter().enumerate() {
        channel(&format!("faults.channel[{i}]"), fault)?;
    }
    for (i, fault) in faults.process.iter().enumerate() {
        process(&format!("faults.process[{i}]"), fault)?;
    }
    Ok(())
}

fn channel(key: &str, fault: &ChannelFault) -> Result<(), Violation> {
    let kind = keyword(&fault.kind);
    if fault.probability.is_none() && fault.from.is_none() && fault.until.is_none() {
        let text = "says neither how likely it is nor when; give probability, or from and until, or all of them";
        return Err(Violation::new(key, text));
    }
    if let Some(probability) = fault.probability
        && !(probability > 0.0 && probability <= 1.0)
    {
        let remedy = "give more than 0, up to 1";
        return Err(Violation::value(format_args!("{key}.probability"), show(probability), remedy));
    }
    for (name, tick) in [("from", fault.from), ("until", fault.until)] {
        ticks(format_args!("{key}.{name}"), tick.unwrap_or(0), 0)?;
    }
    let from = fault.from.unwrap_or(0);
    if let Some(until) = fault.until
        && until <= from
    {
        let remedy = format!("give more than from, which is {from}: it is the first tick without the fault");
        return Err(Violation::value(format_args!("{key}.until"), until, remedy));
    }
    if (fault.channel, fault.kind) == (FaultChannel::Learning, FaultKind::Corrupt) {
        let text = "is corrupt, on the channel learning; the log would contain false records, \
                    so give another kind or another channel";
        return Err(Violation::new(format_args!("{key}.kind"), text));
    }
    match (fault.ticks, fault.kind) {
        (Some(_), other) if !other.takes_ticks() => {
            let text = format!("is given, and {kind} takes none; it belongs to delay, duplicate and freeze");
            return Err(Violation::new(format_args!("{key}.ticks"), text));
        }
        (Some(n), FaultKind::Freeze) if !(1..=limits::MAX_FREEZE).contains(&n) => {
            return Err(Violation::value(format_args!("{key}.ticks"), n, "give 1 to 1000000 ticks"));
        }
        (Some(n), FaultKind::Delay | FaultKind::Duplicate) if !(1..=limits::MAX_DELAY).contains(&n) => {
            return Err(Violation::value(format_args!("{key}.ticks"), n, "give 1 to 16 ticks"));
        }
        _ => {}
    }
    match (fault.value, fault.kind) {
        (None, FaultKind::Corrupt) => Err(Violation::new(
            key,
            "does not say what corrupt puts in place of a value; give value = \"nan\" or \"huge\"",
        )),
        (Some(_), other) if other != FaultKind::Corrupt => Err(Violation::new(
            format_args!("{key}.value"),
            format!("is given, and {kind} takes none; it belongs to corrupt"),
        )),
        _ => Ok(()),
    }
}

fn process(key: &str, fault: &ProcessFault) -> Result<(), Violation> {
    if fault.at.is_empty() || fault.at.len() > limits::MAX_FAULT_TICKS {
        let text = format!("has {} entries; give 1 to 1000 ticks", fault.at.len());
        return Err(Violation::new(format_args!("{key}.at"), text));
    }
    for (i, &tick) in fault.at.iter().enumerate() {
        ticks(format_args!("{key}.at[{i}]"), tick, 0)?;
        if i > 0 && tick <= fault.at[i - 1] {
            let remedy = format!("give ticks in rising order; the one before is {}", fault.at[i - 1]);
            return Err(Violation::value(format_args!("{key}.at[{i}]"), tick, remedy));
        }
    }
    match (fault.act, fault.for_ms) {
        (ProcessFaultKind::Stop, None) => {
            Err(Violation::new(key, "does not say for how long the process is stopped; give for_ms, 1 to 60000"))
        }
        (ProcessFaultKind::Stop, Some(ms)) => {
            number(format_args!("{key}.for_ms"), ms, limits::STOPPED_MS, "give 1 to 60000 ms")
        }
        (act, Some(_)) => {
            let text = format!("is given, and {} takes no time; it belongs to stop", keyword(&act));
            Err(Violation::new(format_args!("{key}.for_ms"), text))
        }
        (_, None) => Ok(()),
    }
}
