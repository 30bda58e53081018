//! Channel faults on demand (`[faults]`): a receiver gets other samples than were sent, and the same ones in
//! every run.
//!
//! A [`FaultyChannel`] is placed where samples are received: by the controller for observations, by the plant
//! for commands, by the logger for learning records. In each tick one sample or none enters, and none, one or
//! more leave. The transport itself is not affected. So lockstep works, the log has the samples that were sent,
//! and a run in one process has the same faults as a run of three processes, and as its replay. The header of a
//! sample has its tick; receivers find out from it which samples are late.
//!
//! Whether a fault occurs in a tick depends on a hash of the run's seed, the fault's index in the scenario's
//! list and the tick, not on a generator. So an additional fault changes no other fault, and the only state of
//! a channel is its delayed samples.

use xxhash_rust::xxh3::xxh3_64_with_seed;

use crate::scenario::{ChannelFault, FaultChannel, FaultKind, FaultValue, Plan};
use crate::state::{Persist, StateVisitor};
use crate::wire::{Command, Learning, Observation, Sample};

/// Limit on delayed samples in a channel. With more, the sample that has been delayed for longest is lost. One
/// fault delays at most 16 samples, so only three or more faults with long delays can reach the limit.
const MAX_DELAYED: usize = 32;

/// A sample whose channel can have faults.
pub trait Faultable: Sample + Default {
    /// The channel of the samples.
    const CHANNEL: FaultChannel;

    /// The values that corruption overwrites: those of the scenario's signals.
    fn values(&mut self, signals: SignalCounts) -> &mut [f32];
}

/// The numbers of inputs and outputs of the scenario.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SignalCounts {
    inputs: usize,
    outputs: usize,
}

impl Faultable for Observation {
    const CHANNEL: FaultChannel = FaultChannel::Observation;

    fn values(&mut self, signals: SignalCounts) -> &mut [f32] {
        &mut self.inputs[..signals.inputs]
    }
}

impl Faultable for Command {
    const CHANNEL: FaultChannel = FaultChannel::Command;

    fn values(&mut self, signals: SignalCounts) -> &mut [f32] {
        &mut self.drawn[..signals.outputs]
    }
}

impl Faultable for Learning {
    const CHANNEL: FaultChannel = FaultChannel::Learning;

    fn values(&mut self, signals: SignalCounts) -> &mut [f32] {
        &mut self.noise[..signals.outputs]
    }
}

/// A fault with its index in the scenario's list.
#[derive(Debug, Clone, PartialEq)]
struct ActiveFault {
    index: u64,
    config: ChannelFault,
}

/// A delayed sample.
#[derive(Debug, Clone, Copy)]
struct DelayedSample<T> {
    sample: T,
    /// The tick in which the sample leaves the channel.
    due: u64,
    /// Whether it leaves after the sample of that tick, not before it.
    behind: bool,
}

/// The receiving end of a channel, with the scenario's faults.
#[derive(Debug, Clone)]
pub struct FaultyChannel<T> {
    faults: Vec<ActiveFault>,
    seed: u64,
    signals: SignalCounts,
    /// Delayed samples in the order in which they entered. The first `delayed_count` entries are in use.
    delayed: [DelayedSample<T>; MAX_DELAYED],
    delayed_count: usize,
    /// The sample that left last.
    last: Option<T>,
    /// The first tick in which the channel is no longer frozen.
    frozen_until: u64,
}

impl<T: Faultable> FaultyChannel<T> {
    /// The channel of `T` in a run of `plan`.
    pub fn of(plan: &Plan) -> Self {
        let list = (0..).zip(&plan.scenario.faults.channel);
        let of_channel = list.filter(|(_, config)| config.channel == T::CHANNEL);
        Self {
            faults: of_channel.map(|(index, config)| ActiveFault { index, config: config.clone() }).collect(),
            seed: xxh3_64_with_seed(b"faults", plan.scenario.seed),
            signals: SignalCounts { inputs: plan.inputs.len(), outputs: plan.outputs.len() },
            delayed: [DelayedSample { sample: T::default(), due: 0, behind: false }; MAX_DELAYED],
            delayed_count: 0,
            last: None,
            frozen_until: 0,
        }
    }

    /// Whether the channel has no faults.
    pub fn is_fault_free(&self) -> bool {
        self.faults.is_empty()
    }

    /// One tick: `sample` enters the channel, and `receive` is called with each sample that leaves it, in
    /// order. Ticks must increase from call to call.
    pub fn pass(&mut self, tick: u64, sample: Option<&T>, mut receive: impl FnMut(&T)) {
        if self.is_fault_free() {
            sample.map(receive);
            return;
        }
        let mut present = sample.copied();
        let (delay, behind) = self.apply_faults(tick, &mut present);
        if tick < self.frozen_until {
            // Samples that enter meanwhile are lost. Samples that were delayed before stay in the channel.
            self.last.iter().for_each(receive);
            return;
        }
        if let Some(sample) = present.take_if(|_| delay > 0 || behind) {
            self.delay(DelayedSample { sample, due: tick + delay.max(1), behind });
        }
        let mut deliver = |sample: &T| {
            self.last = Some(*sample);
            receive(sample);
        };
        let due = |entry: &DelayedSample<T>, behind: bool| entry.due <= tick && entry.behind == behind;
        let delayed = &self.delayed[..self.delayed_count];
        delayed.iter().filter(|entry| due(entry, false)).for_each(|entry| deliver(&entry.sample));
        present.iter().for_each(&mut deliver);
        delayed.iter().filter(|entry| due(entry, true)).for_each(|entry| deliver(&entry.sample));
        self.remove_delivered(tick);
    }

    /// Applies the faults that occur in `tick` to the sample that enters. Returns by how many ticks they delay
    /// it, and whether it then leaves after the sample of that tick.
    fn apply_faults(&mut self, tick: u64, present: &mut Option<T>) -> (u64, bool) {
        let (mut delay, mut behind) = (0, false);
        for i in 0..self.faults.len() {
            let ActiveFault { index, config } = &self.faults[i];
            if !occurs(self.seed, *index, config, tick) {
                continue;
            }
            let (kind, ticks) = (config.kind, config.ticks());
            match (kind, &mut *present) {
                (FaultKind::Freeze, _) => self.frozen_until = self.frozen_until.max(tick + ticks),
                (FaultKind::Drop, sample) => *sample = None,
                (FaultKind::Delay, Some(_)) => delay = delay.max(ticks),
                (FaultKind::Reorder, Some(_)) => behind = true,
                (FaultKind::Duplicate, Some(sample)) => {
                    let sample = *sample;
                    self.delay(DelayedSample { sample, due: tick + ticks, behind: false });
                }
                (FaultKind::Corrupt, Some(sample)) => {
                    let value = if config.value == Some(FaultValue::Huge) { HUGE } else { f32::NAN };
                    sample.values(self.signals).fill(value);
                }
                (_, None) => {}
            }
        }
        (delay, behind)
    }

    /// Adds a delayed sample.
    fn delay(&mut self, entry: DelayedSample<T>) {
        if self.delayed_count == MAX_DELAYED {
            self.delayed.rotate_left(1);
            self.delayed_count -= 1;
        }
        self.delayed[self.delayed_count] = entry;
        self.delayed_count += 1;
    }

    /// Removes the delayed samples that were due by `tick`.
    fn remove_delivered(&mut self, tick: u64) {
        let mut kept = 0;
        for i in 0..self.delayed_count {
            if self.delayed[i].due > tick {
                self.delayed[kept] = self.delayed[i];
                kept += 1;
            }
        }
        self.delayed_count = kept;
    }
}

/// The finite value of a corrupted sample.
const HUGE: f32 = 1e30;

/// Whether the fault with this index occurs in `tick`.
fn occurs(seed: u64, index: u64, config: &ChannelFault, tick: u64) -> bool {
    if tick < config.from.unwrap_or(0) || config.until.is_some_and(|until| tick >= until) {
        return false;
    }
    let Some(probability) = config.probability else { return true };
    let mut bytes = [0; 16];
    bytes[..8].copy_from_slice(&index.to_le_bytes());
    bytes[8..].copy_from_slice(&tick.to_le_bytes());
    // 53 bits of the hash are a number in [0, 1).
    ((xxh3_64_with_seed(&bytes, seed) >> 11) as f64) < probability * (1_u64 << 53) as f64
}

impl<T: Faultable> Persist for FaultyChannel<T> {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        if self.is_fault_free() {
            return;
        }
        let mut counts = [self.delayed_count as u64, u64::from(self.last.is_some()), self.frozen_until];
        visitor.numbers("line", &mut counts);
        [_, _, self.frozen_until] = counts;
        self.delayed_count = (counts[0] as usize).min(MAX_DELAYED);
        let mut last = self.last.unwrap_or_default();
        visitor.words("last", &mut last);
        self.last = (counts[1] != 0).then_some(last);
        // All entries, so that the state always has the same size.
        for (i, entry) in self.delayed.iter_mut().enumerate() {
            if i >= self.delayed_count {
                *entry = DelayedSample { sample: T::default(), due: 0, behind: false };
            }
            let mut due = [entry.due, u64::from(entry.behind)];
            visitor.numbers("due", &mut due);
            visitor.words("under_way", &mut entry.sample);
            (entry.due, entry.behind) = (due[0], due[1] != 0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::Scenario;
    use crate::state::{load, save, size};
    use crate::wire::MAX_OUTPUTS;
    use proptest::prelude::*;

    fn channel(faults: &str) -> FaultyChannel<Command> {
        let mut scenario = Scenario::find("paper").unwrap();
        scenario.faults = toml::from_str(faults).unwrap();
        FaultyChannel::of(&scenario.plan().unwrap())
    }

    fn fault(kind: &str, more: &str) -> String {
        format!("[[channel]]\nchannel = \"command\"\nkind = \"{kind}\"\n{more}\n")
    }

    fn command(tick: u64) -> Command {
        let mut command = Command { drawn: [tick as f32; MAX_OUTPUTS], ..Command::default() };
        command.header.tick = tick;
        command
    }

    /// For each tick, the ticks of the samples that leave the channel.
    fn ticks(channel: &mut FaultyChannel<Command>, ticks: std::ops::Range<u64>) -> Vec<Vec<u64>> {
        let one = |tick| {
            let mut out = Vec::new();
            channel.pass(tick, Some(&command(tick)), |c| out.push(c.header.tick));
            out
        };
        ticks.map(one).collect()
    }

    #[test]
    fn each_kind_of_fault_has_its_effect() {
        for (kind, more, expected) in [
            ("drop", "", vec![vec![0], vec![1], vec![], vec![], vec![4], vec![5], vec![6], vec![7]]),
            ("delay", "ticks = 3", vec![vec![0], vec![1], vec![], vec![], vec![4], vec![2, 5], vec![3, 6], vec![7]]),
            (
                "duplicate",
                "ticks = 2",
                vec![vec![0], vec![1], vec![2], vec![3], vec![2, 4], vec![3, 5], vec![6], vec![7]],
            ),
            ("reorder", "until = 3", vec![vec![0], vec![1], vec![], vec![3, 2], vec![4], vec![5], vec![6], vec![7]]),
            (
                "freeze",
                "until = 3\nticks = 4",
                vec![vec![0], vec![1], vec![1], vec![1], vec![1], vec![1], vec![6], vec![7]],
            ),
        ] {
            let until = if more.contains("until") { "" } else { "\nuntil = 4" };
            let mut channel = channel(&fault(kind, &format!("from = 2\n{more}{until}")));
            assert_eq!(ticks(&mut channel, 0..8), expected, "{kind}");
            assert_eq!(channel.delayed_count, 0);
        }
        // With a long delay many samples are in the channel at once, and all of them leave it in the end.
        let mut channel = channel(&fault("delay", "from = 0\nticks = 16\nuntil = 100"));
        let out: Vec<u64> = ticks(&mut channel, 0..130).concat();
        let mut sorted = out.clone();
        sorted.sort_unstable();
        assert_eq!(sorted, (0..130).collect::<Vec<_>>());
        assert_eq!(out[0], 0);
        assert_eq!(ticks(&mut FaultyChannel::<Command>::clone(&channel), 200..201), [[200]]);
    }

    #[test]
    fn corruption_overwrites_only_the_values_in_use() {
        for (value, is) in [("nan", f32::is_nan as fn(f32) -> bool), ("huge", |x| x == 1e30)] {
            let mut channel = channel(&fault("corrupt", &format!("probability = 1\nvalue = \"{value}\"")));
            let mut received = None;
            channel.pass(3, Some(&command(3)), |c| received = Some(*c));
            let received = received.unwrap();
            assert!(received.drawn[..4].iter().all(|&u| is(u)) && received.drawn[4..] == [3.0; MAX_OUTPUTS - 4]);
            assert_eq!((received.header, received.mean), (command(3).header, command(3).mean));
        }
    }

    /// A delayed sample leaves the channel in its tick even when no sample enters.
    #[test]
    fn delayed_samples_leave_when_no_sample_enters() {
        let mut channel = channel(&fault("delay", "from = 1\nuntil = 2\nticks = 3"));
        let mut out = Vec::new();
        for tick in 0..6 {
            channel.pass(tick, (tick == 1).then_some(&command(1)), |c| out.push((tick, c.header.tick)));
        }
        assert_eq!(out, [(4, 1)]);
    }

    #[test]
    fn occurrence_depends_on_seed_index_and_tick() {
        let drops = |faults: &str, seed: u64| {
            let mut scenario = Scenario::find("paper").unwrap();
            (scenario.faults, scenario.seed) = (toml::from_str(faults).unwrap(), seed);
            let mut channel = FaultyChannel::<Command>::of(&scenario.plan().unwrap());
            let out = ticks(&mut channel, 0..20_000);
            (0..20_000).filter(|&tick| !out[tick as usize].contains(&tick)).collect::<Vec<_>>()
        };
        let tenth = fault("drop", "probability = 0.1");
        let first = drops(&tenth, 1);
        assert!((1_800..2_200).contains(&first.len()), "{}", first.len());
        assert!(drops(&tenth, 1) == first);
        assert!(drops(&tenth, 2) != first);
        // A later fault in the list changes nothing. An earlier fault changes its index.
        let late = fault("duplicate", "probability = 0.5");
        assert!(drops(&(tenth.clone() + &late), 1) == first);
        assert!(drops(&(late + &tenth), 1) != first);
    }

    fn any_fault() -> impl Strategy<Value = String> {
        const KINDS: &[&str] = &["delay", "drop", "duplicate", "reorder", "freeze", "corrupt"];
        (prop::sample::select(KINDS), 0.01..=1.0_f64, 1..=16_u64).prop_map(|(kind, probability, ticks)| {
            let more = match kind {
                "corrupt" => "value = \"huge\"".to_owned(),
                "delay" | "duplicate" | "freeze" => format!("ticks = {ticks}"),
                _ => String::new(),
            };
            fault(kind, &format!("probability = {probability:?}\n{more}"))
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 100, failure_persistence: None, ..ProptestConfig::default() })]

        /// With any faults, no sample leaves before its tick, and a channel that is restored in mid-run
        /// continues identically.
        #[test]
        fn no_sample_is_early_and_a_restored_channel_continues(faults in prop::collection::vec(any_fault(), 1..6)) {
            let mut original = channel(&faults.concat());
            let out = ticks(&mut original, 0..100);
            for (tick, out) in out.iter().enumerate() {
                prop_assert!(out.iter().all(|&t| t <= tick as u64), "{tick}: {out:?}");
            }
            let mut bytes = vec![0; size(&mut original)];
            prop_assert_eq!(save(&mut original, &mut bytes), Some(bytes.len()));
            let mut restored = channel(&faults.concat());
            prop_assert!(load(&mut restored, &bytes));
            prop_assert_eq!(ticks(&mut original, 100..200), ticks(&mut restored, 100..200));
        }
    }
}
