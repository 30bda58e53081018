//! `[faults]`: what is made to go wrong in a run, on purpose and the same every time, and the checks of it.
//!
//! Faults of channels are injected where a sample is read ([`FaultyChannel`](crate::runtime::Line)); those of processes are carried
//! out by the run's launcher.

use serde::{Deserialize, Serialize};

use super::check::{number, show, ticks};
use super::error::Violation;
use super::limits;
use crate::wire::Role;

/// `[faults]`: what goes wrong.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FaultsConfig {
    /// Faults of channels. Each is decided for every tick by itself, by its place in the list, the seed and the tick.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub channel: Vec<ChannelFault>,
    /// What happens to processes.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub process: Vec<ProcessFault>,
}

/// `[[faults.channel]]`: a fault of one channel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ChannelFault {
    /// The channel, where it is read: the controller reads observations, the plant commands, the
    /// logger learning records.
    pub channel: FaultChannel,
    /// What happens to a sample.
    pub kind: FaultKind,
    /// How likely it is in each tick, above 0 and up to 1; left out, it happens in every tick from `from` to `until`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub probability: Option<f64>,
    /// The first tick in which it may happen; left out, 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from: Option<u64>,
    /// The first tick in which it no longer happens; left out, never.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until: Option<u64>,
    /// Ticks by which a sample is delayed, after which its duplicate comes, or for which the channel is frozen; left out, 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ticks: Option<u64>,
    /// What `corrupt` writes over the sample's values.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub value: Option<FaultValue>,
}

/// The channels that faults can be injected into.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FaultChannel {
    /// Plant to controller; the log has the observations as they were sent.
    Observation,
    /// Controller to plant; the log has the commands as they were sent.
    Command,
    /// Controller to logger: what does not come in its tick is missing from the log, which says so.
    Learning,
}

/// What can happen to a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FaultKind {
    /// It comes `ticks` later.
    Delay,
    /// It never comes.
    Drop,
    /// It comes, and `ticks` later once more.
    Duplicate,
    /// It comes behind the next one.
    Reorder,
    /// From this tick on the sample that was read last comes again and again, for `ticks` ticks, and nothing else does.
    Freeze,
    /// It comes with `value` in place of its own: an observation's inputs, a command's outputs.
    Corrupt,
}

/// What a corrupted sample holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FaultValue {
    /// Not a number.
    Nan,
    /// 1e30.
    Huge,
}

/// `[[faults.process]]`: something that happens to a process at given ticks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProcessFault {
    /// The process.
    pub process: FaultProcess,
    /// What happens to it.
    #[serde(rename = "do")]
    pub act: ProcessFaultKind,
    /// The ticks, in rising order, as the plant's board shows them.
    pub at: Vec<u64>,
    /// How long it is stopped, ms.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub for_ms: Option<f64>,
}

/// The processes of a run.
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

/// What can happen to a process.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ProcessFaultKind {
    /// SIGKILL.
    Kill,
    /// SIGSTOP, and SIGCONT after `for_ms`.
    Stop,
    /// SIGTERM, and a new start.
    Restart,
}

impl FaultsConfig {
    /// Whether nothing is made to go wrong.
    pub fn is_nothing(&self) -> bool {
        self.channel.is_empty() && self.process.is_empty()
    }

    /// The faults in words, for whoever might take the run for a clean one.
    pub fn in_words(&self) -> Vec<String> {
        let channels = self.channel.iter().map(ChannelFault::in_words);
        channels.chain(self.process.iter().map(ProcessFault::in_words)).collect()
    }
}

impl ChannelFault {
    /// Ticks of delay, of a duplicate or of a freeze.
    pub fn ticks(&self) -> u64 {
        self.ticks.unwrap_or(1)
    }

    fn in_words(&self) -> String {
        let mut text = format!("{} {}", word(&self.channel), word(&self.kind));
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
    /// Whether the key `ticks` says something of it.
    pub fn takes_ticks(self) -> bool {
        matches!(self, Self::Delay | Self::Duplicate | Self::Freeze)
    }
}

impl ProcessFault {
    fn in_words(&self) -> String {
        let times = self.at.len();
        let often = if times == 1 { format!("at tick {}", self.at[0]) } else { format!("{times} times") };
        format!("{} {} {often}", word(&self.process), word(&self.act))
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

/// A word of the file.
fn word<T: Serialize>(value: &T) -> String {
    serde_json::to_value(value).ok().and_then(|word| word.as_str().map(str::to_owned)).unwrap_or_default()
}

/// Checks what the types cannot say.
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
    let kind = word(&fault.kind);
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
        let text =
            "is corrupt, on the channel learning; only the log hears that, and must hold what was learned or nothing";
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
    if fault.at.is_empty() || fault.at.len() > limits::MAX_STRIKES {
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
            let text = format!("is given, and {} takes no time; it belongs to stop", word(&act));
            Err(Violation::new(format_args!("{key}.for_ms"), text))
        }
        (_, None) => Ok(()),
    }
}
