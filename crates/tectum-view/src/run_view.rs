//! The state of a watched run. Samples, boards and messages go in; faces read it.

use std::collections::VecDeque;

use crate::{
    Curve, EventLog, RunEventKind, RunFacts, SeenCommand, SeenLearning, SeenObservation, SeenProcess, Stage,
    StageTimes, TargetOutcome, TickRecord, WatchedState,
};

/// Records that are kept to look back: five minutes at twenty a second.
const RECORDS: usize = 6000;
/// Shortest time between two records, s, less than a period of 50 ms.
const RECORD_EVERY_S: f64 = 0.045;
/// Targets whose outcomes are kept.
const TARGETS: usize = 400;
/// Ticks of the mean of recent losses.
const LOSSES: usize = 100;
/// Ticks whose instants are kept until all samples of the tick have come.
const OPEN_TICKS: usize = 256;
/// Time over which the rate is measured, s.
const RATE_OVER_S: f64 = 1.5;
/// In real time, an event that is seen again within this time is counted on, s; in lockstep, within as many ticks of
/// the scenario's own time.
const EVENT_GAP_S: f64 = 5.0;

/// The state of a watched run.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RunView {
    /// The run.
    pub facts: RunFacts,
    /// The newest tick that was seen.
    pub tick: u64,
    /// Loss over the run.
    pub loss: Curve,
    /// Error over the run, if it is measured.
    pub error: Curve,
    /// Outcomes of the last targets that were seen whole, oldest first.
    pub targets: VecDeque<TargetOutcome>,
    /// What happened.
    pub events: EventLog,
    /// The times of each [`Stage`] of the tick; empty in lockstep.
    pub stages: [StageTimes; 4],
    /// In real time: from a tick's scheduled instant to its sensing.
    pub wake_up: StageTimes,
    /// Plant, controller and logger.
    pub processes: [SeenProcess; 3],
    /// Samples of the plant that went by between two looks of the watcher, or were overwritten before it came.
    pub passed_over: u64,
    /// Observations that were taken.
    pub taken: u64,
    /// Euclidean norm of the weights.
    pub weights_norm: f32,
    /// Ticks a second.
    pub rate: f64,
    /// How the run ended; `None` while it lives.
    pub ended: Option<String>,
    records: VecDeque<TickRecord>,
    next_record: u64,
    /// The newest observation, until it is kept as a record.
    newest: Option<TickRecord>,
    /// By tick: scheduled, observation sent, command sent, ns.
    open: Vec<[u64; 4]>,
    target: Option<OpenTarget>,
    /// Instants, s, and ticks done, for the rate.
    progress: VecDeque<(f64, u64)>,
    /// Losses of the last ticks.
    losses: VecDeque<f64>,
    next_change: usize,
}

/// The target in progress.
#[derive(Debug, Clone, Copy, PartialEq)]
struct OpenTarget {
    from: u64,
    next: u64,
    ticks: u64,
    loss: f64,
}

impl RunView {
    /// A run of which nothing has been seen yet.
    pub fn new(facts: RunFacts) -> Self {
        Self { facts, open: vec![[u64::MAX; 4]; OPEN_TICKS], ..Self::default() }
    }

    /// Ticks within which the same event is counted on.
    fn event_gap(&self) -> u64 {
        (EVENT_GAP_S * 1e9 / self.facts.period_ns.max(1) as f64).max(1.0) as u64
    }

    /// Takes an observation.
    pub fn observe(&mut self, sample: &SeenObservation<'_>) {
        let tick = sample.tick;
        self.tick = self.tick.max(tick);
        self.taken += 1;
        self.announce_changes();
        self.take_flags(tick, sample.flags);
        let error = self.facts.error.and_then(|i| sample.measures.get(i).copied()).filter(|e| e.is_finite());
        let loss = -f64::from(sample.reward);
        if !sample.first
            && let Some(before) = tick.checked_sub(1)
        {
            self.loss.add(before, loss);
            self.losses.push_back(loss);
            self.losses.drain(..self.losses.len().saturating_sub(LOSSES));
            if let Some(error) = error {
                self.error.add(before, f64::from(error));
            }
            self.follow_target(sample, loss, error);
        }
        if sample.new_target {
            self.target = Some(OpenTarget { from: tick, next: tick + 1, ticks: 0, loss: 0.0 });
        }
        let record = TickRecord {
            number: 0,
            tick,
            flags: sample.flags,
            inputs: sample.inputs.to_vec(),
            applied: sample.applied.to_vec(),
            loss: if sample.first { f32::NAN } else { -sample.reward },
            error: error.filter(|_| !sample.first),
            posture: sample.posture.to_vec(),
            target: sample.target,
        };
        self.newest = Some(record);
        if self.facts.realtime {
            self.wake_up.add(us(sample.sensed_ns.saturating_sub(sample.scheduled_ns)));
            self.open[tick as usize % OPEN_TICKS] = [tick, sample.scheduled_ns, sample.published_ns, 0];
            let spaced = |last: &TickRecord| self.facts.seconds(tick.saturating_sub(last.tick)) >= RECORD_EVERY_S;
            if self.records.back().is_none_or(spaced) {
                self.keep_newest();
            }
        }
    }

    /// Takes a command.
    pub fn command(&mut self, sample: &SeenCommand) {
        self.take_flags(sample.tick, sample.flags);
        let [tick, scheduled, sensed, answered] = &mut self.open[sample.tick as usize % OPEN_TICKS];
        if *tick == sample.tick && *answered == 0 {
            *answered = sample.published_ns;
            self.stages[Stage::Sensing as usize].add(us(sensed.saturating_sub(*scheduled)));
            self.stages[Stage::Answer as usize].add(us(answered.saturating_sub(*sensed)));
        }
    }

    /// Takes a learning record.
    pub fn learn(&mut self, sample: &SeenLearning) {
        self.weights_norm = sample.weights_norm;
        let open = &mut self.open[sample.tick as usize % OPEN_TICKS];
        let [tick, scheduled, _, answered] = *open;
        if tick == sample.tick && answered != 0 {
            // A second record of the same tick counts no more.
            open[0] = u64::MAX;
            let next = scheduled + self.facts.period_ns;
            self.stages[Stage::Learning as usize].add(us(sample.published_ns.saturating_sub(answered)));
            self.stages[Stage::Slack as usize].add(us(next.saturating_sub(sample.published_ns)));
        }
    }

    /// Counts samples of the plant that the watcher did not take. What they held of a target is not known.
    pub fn pass_over(&mut self, samples: u64) {
        self.passed_over += samples;
    }

    /// Takes the boards, at `now`, in seconds of the watcher's own time.
    pub fn boards(&mut self, processes: [SeenProcess; 3], now: f64) {
        for ((role, before), after) in ROLES.into_iter().zip(self.processes).zip(processes) {
            let tick = self.tick;
            let mut add = |text: String| self.events.add(tick, RunEventKind::Restart, &text, 0);
            let ended = after.state.is_bad() && !(before.state.is_bad() && before.restarts == after.restarts);
            if ended {
                add(format!("the {role} {}", if after.state == WatchedState::Died { "died" } else { "failed" }));
            }
            if after.restarts > before.restarts {
                add(format!("the {role} is started again, start {}", after.restarts + 1));
            }
            if after.gone && !before.gone {
                add(format!("the {role} will not return"));
            }
        }
        self.processes = processes;
        self.progress.push_back((now, processes[0].ticks));
        while self.progress.len() > 2 && now - self.progress[0].0 > RATE_OVER_S {
            self.progress.pop_front();
        }
        let (first, last) = (self.progress[0], (now, processes[0].ticks));
        if last.0 - first.0 > 0.2 {
            self.rate = last.1.saturating_sub(first.1) as f64 / (last.0 - first.0);
        }
        // In lockstep a record is what a look finds; in real time this is the tick that the last look left.
        if !self.facts.realtime {
            self.keep_newest();
        }
    }

    /// Adds what a process, or the launcher, said.
    pub fn say(&mut self, text: &str) {
        let text = text.strip_prefix("tectum: ").unwrap_or(text);
        self.events.add(self.tick, RunEventKind::Message, text, 0);
    }

    /// The run is over.
    pub fn end(&mut self, how: &str) {
        if self.ended.is_none() {
            self.keep_newest();
            self.rate = 0.0;
            self.events.add(self.tick, RunEventKind::Run, how, 0);
            self.ended = Some(how.to_owned());
        }
    }

    /// The newest tick that can be drawn.
    pub fn newest(&self) -> Option<&TickRecord> {
        self.newest.as_ref().or(self.records.back())
    }

    /// Records of the last minutes, oldest first.
    pub fn records(&self) -> impl DoubleEndedIterator<Item = &TickRecord> + ExactSizeIterator {
        self.records.iter()
    }

    /// The number that the next record gets.
    pub fn next_record(&self) -> u64 {
        self.next_record
    }

    /// Ticks that the plant has done, as far as board and samples tell.
    pub fn ticks_done(&self) -> u64 {
        self.tick.max(self.processes[0].ticks)
    }

    /// Mean loss of the last 100 ticks that were seen; `None` before the first.
    pub fn recent_loss(&self) -> Option<f64> {
        let ticks = self.losses.len();
        (ticks > 0).then(|| self.losses.iter().sum::<f64>() / ticks as f64)
    }

    /// Seconds until the last tick at the present rate; `None` if there is none yet.
    pub fn seconds_left(&self) -> Option<f64> {
        let left = self.facts.ticks.saturating_sub(self.ticks_done());
        (self.rate > 0.0 && self.ended.is_none()).then(|| left as f64 / self.rate)
    }

    fn keep_newest(&mut self) {
        let Some(mut record) = self.newest.take() else { return };
        record.number = self.next_record;
        self.next_record += 1;
        if self.records.len() == RECORDS {
            self.records.pop_front();
        }
        self.records.push_back(record);
    }

    fn take_flags(&mut self, tick: u64, flags: u32) {
        let gap = self.event_gap();
        for (bit, text) in &self.facts.flags {
            if flags & bit != 0 {
                self.events.add(tick, RunEventKind::Flag, text, gap);
            }
        }
    }

    fn announce_changes(&mut self) {
        while let Some((tick, text)) = self.facts.changes.get(self.next_change).filter(|change| change.0 <= self.tick) {
            self.events.add(*tick, RunEventKind::Change, text, 0);
            self.next_change += 1;
        }
    }

    /// Counts the tick before `sample` as one of the target in progress, if none was missed since its begin.
    fn follow_target(&mut self, sample: &SeenObservation<'_>, loss: f64, error: Option<f32>) {
        if let Some(target) = &mut self.target {
            if target.next == sample.tick {
                (target.next, target.ticks, target.loss) = (sample.tick + 1, target.ticks + 1, target.loss + loss);
                if sample.new_target && target.ticks > 1 {
                    let &mut OpenTarget { from, ticks, loss, .. } = target;
                    let loss = loss / ticks as f64;
                    self.targets.push_back(TargetOutcome { from, ticks, loss, end_error: error.map(f64::from) });
                    self.targets.drain(..self.targets.len().saturating_sub(TARGETS));
                }
            } else if !sample.new_target {
                self.target = None;
            }
        }
    }
}

/// Names of the processes, in the order of [`RunView::processes`].
pub(crate) const ROLES: [&str; 3] = ["plant", "controller", "logger"];

fn us(ns: u64) -> f64 {
    ns as f64 / 1e3
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) const MS: u64 = 1_000_000;

    /// Takes tick `tick` of a run in real time, with a loss of 1 and an error that falls.
    pub(crate) fn take_tick(view: &mut RunView, tick: u64) {
        let scheduled_ns = 1000 * MS + tick * view.facts.period_ns;
        let angle = tick as f32 * 0.02;
        let posture = [[0.0, -1.0], [angle.sin(), -1.0 + angle.cos()], [angle.sin() + 0.3, -0.4 + angle.cos()]];
        view.observe(&SeenObservation {
            tick,
            sequence: tick,
            flags: 0,
            first: tick == 0,
            new_target: tick.is_multiple_of(40),
            scheduled_ns,
            sensed_ns: scheduled_ns + 60_000,
            published_ns: scheduled_ns + 80_000,
            inputs: &[0.3, 0.1, angle, -angle],
            applied: &[0.01, -0.02],
            reward: -1.0 / (1.0 + tick as f32 / 50.0),
            measures: &[2.0 / (1.0 + tick as f32 / 50.0)],
            posture: &posture,
            target: Some([0.3, 0.1]),
        });
        view.command(&SeenCommand { tick, flags: 0, published_ns: scheduled_ns + 130_000 });
        let published_ns = scheduled_ns + 2_130_000;
        view.learn(&SeenLearning { tick, flags: 0, published_ns, weights_norm: 1.5 });
    }

    pub(crate) fn facts() -> RunFacts {
        let signal = |name: &str, unit: &str, end: f32| crate::SignalRange {
            name: name.to_owned(),
            unit: unit.to_owned(),
            min: -end,
            max: end,
        };
        RunFacts {
            name: "arm-1".to_owned(),
            scenario: "arm".to_owned(),
            seed: 1,
            realtime: true,
            period_ns: 50 * MS,
            ticks: 3600,
            inputs: vec![
                signal("target_x", "m", 1.0),
                signal("target_y", "m", 1.0),
                signal("theta_1", "rad", 3.0),
                signal("theta_2", "rad", 3.0),
            ],
            outputs: vec![signal("rate_1", "", 0.05), signal("rate_2", "", 0.05)],
            measures: vec!["error".to_owned()],
            error: Some(0),
            error_unit: "m".to_owned(),
            arm: Some(crate::ArmFrame { centre: [0.0, -0.2], half: 1.4 }),
            changes: vec![(100, "joint 2 blocked".to_owned())],
            flags: vec![(2, "a command was missed".to_owned())],
        }
    }

    #[test]
    fn a_run_is_followed_through_ticks_targets_and_a_restart() {
        let mut view = RunView::new(facts());
        (0..121).for_each(|tick| take_tick(&mut view, tick));
        let running = SeenProcess { state: WatchedState::Running, ticks: 100, ..SeenProcess::default() };
        view.boards([running; 3], 0.0);
        view.boards([SeenProcess { ticks: 120, ..running }; 3], 1.0);
        assert_eq!((view.tick, view.records().len(), view.rate), (120, 121, 20.0));
        assert_eq!(view.seconds_left(), Some(174.0));
        let outcomes: Vec<_> = view.targets.iter().map(|t| (t.from, t.ticks)).collect();
        assert_eq!(outcomes, [(0, 40), (40, 40), (80, 40)]);
        let p50: Vec<_> = view.stages.iter().map(|times| times.quantiles([0.5]).unwrap()[0].round()).collect();
        assert_eq!(p50, [80.0, 50.0, 2000.0, 47870.0]);
        let died = SeenProcess { state: WatchedState::Died, ..running };
        view.boards([running, died, running], 1.1);
        view.boards([running, SeenProcess { restarts: 1, ..running }, running], 1.2);
        view.end("the run is over");
        let texts: Vec<_> = view.events.iter().map(|event| event.line()).collect();
        let expected =
            ["joint 2 blocked", "the controller died", "the controller is started again, start 2", "the run is over"];
        assert_eq!(texts, expected);
    }

    #[test]
    fn a_gap_ends_a_target_without_an_outcome_and_lockstep_keeps_what_a_look_finds() {
        let mut view = RunView::new(RunFacts { realtime: false, ..facts() });
        (0..30).chain(35..41).for_each(|tick| take_tick(&mut view, tick));
        view.pass_over(5);
        view.boards(Default::default(), 0.0);
        assert_eq!((view.targets.len(), view.records().len(), view.passed_over), (0, 1, 5));
        assert_eq!(view.stages[0].quantiles([0.5]), None);
        (41..81).for_each(|tick| take_tick(&mut view, tick));
        assert_eq!(view.targets.len(), 1);
    }

    #[test]
    fn memory_is_bounded() {
        let mut view = RunView::new(facts());
        (0..20_000).for_each(|tick| take_tick(&mut view, tick));
        assert_eq!((view.records().len(), view.next_record(), view.targets.len()), (RECORDS, 20_000, TARGETS));
    }
}
