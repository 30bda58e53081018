//! Faults of channels, on demand: what is sent is not what is read, the same every time.
//!
//! A [`FaultyChannel`] stands where samples are read: the controller's for observations, the plant's for commands. In each tick one
//! sample goes in, or none, and what comes out are none, one or more. The transport beneath stays whole, so that lockstep is
//! kept, the log has what was sent, and a run in one process has the same faults as one of three, and as its replay. What
//! each sample's tick is stands in its header; who reads must find out from there what is late.
//!
//! Whether a fault happens in a tick is drawn from a hash of the run's seed, the fault's place in the scenario's list and
//! the tick, not from a generator: one more fault changes no other, and a line's only memory is what is under way in it.

use xxhash_rust::xxh3::xxh3_64_with_seed;

use crate::scenario::{ChannelFault, FaultChannel, FaultKind, FaultValue, Plan};
use crate::state::{Persist, StateVisitor};
use crate::wire::{Command, Header, Learning, Observation, Sample};

/// Most samples under way in a line; with more, the one that has been under way for longest is lost. One fault keeps at
/// most 16 samples, so that only three or more of long delay can come to it.
const UNDER_WAY: usize = 32;

/// What a line carries.
pub trait Faultable: Sample + Default {
    /// The channel.
    const CHANNEL: FaultChannel;

    /// Its header.
    fn header(&self) -> &Header;

    /// The values that corruption writes over, those of the scenario's signals.
    fn values(&mut self, plan: SignalCounts) -> &mut [f32];
}

/// How many inputs and outputs the scenario has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SignalCounts {
    inputs: usize,
    outputs: usize,
}

impl Faultable for Observation {
    const CHANNEL: FaultChannel = FaultChannel::Observation;

    fn header(&self) -> &Header {
        &self.header
    }

    fn values(&mut self, signals: SignalCounts) -> &mut [f32] {
        &mut self.inputs[..signals.inputs]
    }
}

impl Faultable for Command {
    const CHANNEL: FaultChannel = FaultChannel::Command;

    fn header(&self) -> &Header {
        &self.header
    }

    fn values(&mut self, signals: SignalCounts) -> &mut [f32] {
        &mut self.drawn[..signals.outputs]
    }
}

impl Faultable for Learning {
    const CHANNEL: FaultChannel = FaultChannel::Learning;

    fn header(&self) -> &Header {
        &self.header
    }

    fn values(&mut self, signals: SignalCounts) -> &mut [f32] {
        &mut self.noise[..signals.outputs]
    }
}

/// A fault with its place in the scenario's list.
#[derive(Debug, Clone, PartialEq)]
struct ActiveFault {
    place: u64,
    table: ChannelFault,
}

/// A sample under way.
#[derive(Debug, Clone, Copy)]
struct DelayedSample<T> {
    sample: T,
    /// The tick in which it comes out.
    due: u64,
    /// It comes behind the sample of that tick, not before it.
    behind: bool,
}

/// A channel's end with the scenario's faults.
#[derive(Debug, Clone)]
pub struct FaultyChannel<T> {
    faults: Vec<ActiveFault>,
    seed: u64,
    signals: SignalCounts,
    /// In the order in which they went in; the first `waiting` are in use.
    under_way: [DelayedSample<T>; UNDER_WAY],
    waiting: usize,
    /// What came out last, if anything did.
    last: Option<T>,
    /// The first tick in which the channel is no longer frozen.
    frozen_until: u64,
}

impl<T: Faultable> FaultyChannel<T> {
    /// The line of the run of `plan`.
    pub fn of(plan: &Plan) -> Self {
        let list = (0..).zip(&plan.scenario.faults.channel);
        let ours = list.filter(|(_, table)| table.channel == T::CHANNEL);
        Self {
            faults: ours.map(|(place, table)| ActiveFault { place, table: table.clone() }).collect(),
            seed: xxh3_64_with_seed(b"faults", plan.scenario.seed),
            signals: SignalCounts { inputs: plan.inputs.len(), outputs: plan.outputs.len() },
            under_way: [DelayedSample { sample: T::default(), due: 0, behind: false }; UNDER_WAY],
            waiting: 0,
            last: None,
            frozen_until: 0,
        }
    }

    /// Whether nothing can go wrong on it.
    pub fn is_clean(&self) -> bool {
        self.faults.is_empty()
    }

    /// One tick: `sample` goes in, and what comes out is given to `read`, in order. Ticks only grow.
    pub fn pass(&mut self, tick: u64, sample: Option<&T>, mut read: impl FnMut(&T)) {
        if self.is_clean() {
            sample.map(read);
            return;
        }
        let mut present = sample.copied();
        let (mut delay, mut behind) = (0, false);
        for i in 0..self.faults.len() {
            let ActiveFault { place, table } = &self.faults[i];
            if !happens(self.seed, *place, table, tick) {
                continue;
            }
            let (kind, ticks) = (table.kind, table.ticks());
            match (kind, &mut present) {
                (FaultKind::Freeze, _) => self.frozen_until = self.frozen_until.max(tick + ticks),
                (FaultKind::Drop, sample) => *sample = None,
                (FaultKind::Delay, Some(_)) => delay = delay.max(ticks),
                (FaultKind::Reorder, Some(_)) => behind = true,
                (FaultKind::Duplicate, Some(sample)) => {
                    let sample = *sample;
                    self.keep(DelayedSample { sample, due: tick + ticks, behind: false });
                }
                (FaultKind::Corrupt, Some(sample)) => {
                    let value = if table.value == Some(FaultValue::Huge) { HUGE } else { f32::NAN };
                    sample.values(self.signals).fill(value);
                }
                (_, None) => {}
            }
        }
        if tick < self.frozen_until {
            // What goes in meanwhile is lost; what was under way before stays there.
            self.last.iter().for_each(read);
            return;
        }
        if let Some(sample) = present.take_if(|_| delay > 0 || behind) {
            self.keep(DelayedSample { sample, due: tick + delay.max(1), behind });
        }
        let mut give = |sample: &T| {
            self.last = Some(*sample);
            read(sample);
        };
        let due = |w: &DelayedSample<T>, behind: bool| w.due <= tick && w.behind == behind;
        let under_way = &self.under_way[..self.waiting];
        under_way.iter().filter(|w| due(w, false)).for_each(|w| give(&w.sample));
        present.iter().for_each(&mut give);
        under_way.iter().filter(|w| due(w, true)).for_each(|w| give(&w.sample));
        let mut left = 0;
        for i in 0..self.waiting {
            if self.under_way[i].due > tick {
                self.under_way[left] = self.under_way[i];
                left += 1;
            }
        }
        self.waiting = left;
    }

    fn keep(&mut self, waiting: DelayedSample<T>) {
        if self.waiting == UNDER_WAY {
            self.under_way.rotate_left(1);
            self.waiting -= 1;
        }
        self.under_way[self.waiting] = waiting;
        self.waiting += 1;
    }
}

/// The value of a corrupted sample that is a number.
const HUGE: f32 = 1e30;

/// Whether the fault at `place` happens in `tick`.
fn happens(seed: u64, place: u64, table: &ChannelFault, tick: u64) -> bool {
    if tick < table.from.unwrap_or(0) || table.until.is_some_and(|until| tick >= until) {
        return false;
    }
    let Some(probability) = table.probability else { return true };
    let mut bytes = [0; 16];
    bytes[..8].copy_from_slice(&place.to_le_bytes());
    bytes[8..].copy_from_slice(&tick.to_le_bytes());
    // 53 bits are a number in [0, 1).
    ((xxh3_64_with_seed(&bytes, seed) >> 11) as f64) < probability * (1_u64 << 53) as f64
}

impl<T: Faultable> Persist for FaultyChannel<T> {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        if self.is_clean() {
            return;
        }
        let waiting = self.waiting;
        let mut counts = [waiting as u64, u64::from(self.last.is_some()), self.frozen_until];
        visitor.numbers("line", &mut counts);
        [_, _, self.frozen_until] = counts;
        self.waiting = (counts[0] as usize).min(UNDER_WAY);
        let mut last = self.last.unwrap_or_default();
        visitor.words("last", &mut last);
        self.last = (counts[1] != 0).then_some(last);
        // All of them, so that what is to be remembered always has the same size.
        for (i, w) in self.under_way.iter_mut().enumerate() {
            if i >= self.waiting {
                *w = DelayedSample { sample: T::default(), due: 0, behind: false };
            }
            let mut when = [w.due, u64::from(w.behind)];
            visitor.numbers("due", &mut when);
            visitor.words("under_way", &mut w.sample);
            (w.due, w.behind) = (when[0], when[1] != 0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::Scenario;
    use crate::state::{load, save, size};
    use proptest::prelude::*;

    fn line(faults: &str) -> FaultyChannel<Command> {
        let mut scenario = Scenario::find("paper").unwrap();
        scenario.faults = toml::from_str(faults).unwrap();
        FaultyChannel::of(&scenario.plan().unwrap())
    }

    fn fault(kind: &str, more: &str) -> String {
        format!("[[channel]]\nchannel = \"command\"\nkind = \"{kind}\"\n{more}\n")
    }

    fn command(tick: u64) -> Command {
        let mut command = Command { drawn: [tick as f32; 8], ..Command::default() };
        command.header.tick = tick;
        command
    }

    /// The ticks of what comes out in each of the ticks.
    fn ticks(line: &mut FaultyChannel<Command>, ticks: std::ops::Range<u64>) -> Vec<Vec<u64>> {
        let one = |tick| {
            let mut out = Vec::new();
            line.pass(tick, Some(&command(tick)), |c| out.push(c.header.tick));
            out
        };
        ticks.map(one).collect()
    }

    #[test]
    fn each_kind_does_what_it_says() {
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
            let mut line = line(&fault(kind, &format!("from = 2\n{more}{until}")));
            assert_eq!(ticks(&mut line, 0..8), expected, "{kind}");
            assert_eq!(line.waiting, 0);
        }
        // All of what is delayed lies in between, and in the end it comes.
        let mut line = line(&fault("delay", "from = 0\nticks = 16\nuntil = 100"));
        let out: Vec<u64> = ticks(&mut line, 0..130).concat();
        let mut sorted = out.clone();
        sorted.sort_unstable();
        assert_eq!(sorted, (0..130).collect::<Vec<_>>());
        assert_eq!(out[0], 0);
        assert_eq!(ticks(&mut FaultyChannel::<Command>::clone(&line), 200..201), [[200]]);
    }

    #[test]
    fn corruption_writes_over_what_is_in_use_and_nothing_else() {
        for (value, is) in [("nan", f32::is_nan as fn(f32) -> bool), ("huge", |x| x == 1e30)] {
            let mut line = line(&fault("corrupt", &format!("probability = 1\nvalue = \"{value}\"")));
            let mut seen = None;
            line.pass(3, Some(&command(3)), |c| seen = Some(*c));
            let seen = seen.unwrap();
            assert!(seen.drawn[..4].iter().all(|&u| is(u)) && seen.drawn[4..] == [3.0; 4]);
            assert_eq!((seen.header, seen.mean), (command(3).header, command(3).mean));
        }
    }

    /// A channel that carries nothing may still be frozen, and what is under way comes out.
    #[test]
    fn time_goes_on_without_samples() {
        let mut line = line(&fault("delay", "from = 1\nuntil = 2\nticks = 3"));
        let mut out = Vec::new();
        for tick in 0..6 {
            line.pass(tick, (tick == 1).then_some(&command(1)), |c| out.push((tick, c.header.tick)));
        }
        assert_eq!(out, [(4, 1)]);
    }

    #[test]
    fn chance_is_a_matter_of_seed_place_and_tick() {
        let drops = |faults: &str, seed: u64| {
            let mut scenario = Scenario::find("paper").unwrap();
            (scenario.faults, scenario.seed) = (toml::from_str(faults).unwrap(), seed);
            let mut line = FaultyChannel::<Command>::of(&scenario.plan().unwrap());
            let out = ticks(&mut line, 0..20_000);
            (0..20_000).filter(|&tick| !out[tick as usize].contains(&tick)).collect::<Vec<_>>()
        };
        let tenth = fault("drop", "probability = 0.1");
        let first = drops(&tenth, 1);
        assert!((1_800..2_200).contains(&first.len()), "{}", first.len());
        assert!(drops(&tenth, 1) == first);
        assert!(drops(&tenth, 2) != first);
        // Another fault behind it changes nothing of it; before it, its place is another.
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

        /// Whatever goes wrong: nothing comes out before its tick, nothing that never went in, and a line that is restored in
        /// the middle goes on as if nothing had been.
        #[test]
        fn lines_invent_nothing_and_can_be_restored(faults in prop::collection::vec(any_fault(), 1..6)) {
            let mut whole = line(&faults.concat());
            let out = ticks(&mut whole, 0..100);
            for (tick, out) in out.iter().enumerate() {
                prop_assert!(out.iter().all(|&t| t <= tick as u64), "{tick}: {out:?}");
            }
            let mut bytes = vec![0; size(&mut whole)];
            prop_assert_eq!(save(&mut whole, &mut bytes), Some(bytes.len()));
            let mut back = line(&faults.concat());
            prop_assert!(load(&mut back, &bytes));
            prop_assert_eq!(ticks(&mut whole, 100..200), ticks(&mut back, 100..200));
        }
    }
}
