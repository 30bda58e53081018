//! Copies of the policy as it was during a run, so that it can be tested afterwards without exploration noise.
//!
//! The ticks of the copies follow from the scenario alone ([`SnapshotSchedule`]): one a second of the plant's
//! time at first and after each change of the arm, later ever fewer, at most [`MOST`] in all, and always one
//! just before each change. So a process that was restarted knows which copies are due, and in lockstep it
//! writes the same bytes again.
//!
//! The copies lie in one file of the run's folder, in records of equal size: the tick (`u64`), a checksum
//! over tick and weights (XXH3-64, seeded with the scenario's hash), and the weights as the policy holds
//! them. The writer of checkpoints brings them there after the command has gone out. A record that cannot be
//! written is missing, and has no other consequence: a reader of the file knows no policy of that tick.

use std::io::Read as _;
use std::path::{Path, PathBuf};

use xxhash_rust::xxh3::xxh3_64_with_seed;

use crate::checkpoint::CheckpointWriter;
use crate::policy::LinearPolicy;
use crate::scenario::{ArmConfig, Plan};
use crate::state;

/// Copies of a run, at most; the last policy of the run comes on top.
const MOST: usize = 128;
/// Bytes of all copies together, at most.
const MOST_BYTES: usize = 16 << 20;
/// Seconds of the plant's time after which the policy is looked at first; also a row of the summary.
pub const FIRST_LOOK_S: u64 = 10;
/// Bytes before the weights: tick and checksum.
const HEAD: usize = 16;

/// The policy after some ticks.
#[derive(Debug, Clone)]
pub struct PolicySnapshot {
    /// Ticks done.
    pub tick: u64,
    /// The policy as it answers the next one.
    pub policy: LinearPolicy,
}

/// When the policy is copied: numbers of ticks done.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SnapshotSchedule {
    due: Vec<u64>,
    ticks_a_second: u64,
}

impl SnapshotSchedule {
    /// The schedule of `plan`. `None` where no policy is copied: the controller is another program, its learner has no
    /// linear policy, the plant is not the simulator's arm, the arm has an open loop, or even the fewest copies would
    /// be too many.
    pub fn of(plan: &Plan) -> Option<Self> {
        if !plan.scenario.controller.is_shipped() || !plan.scenario.learner.rule.is_linear() {
            return None;
        }
        let arm = plan.simulated_arm().filter(|arm| !arm.open_loop)?;
        let ticks_a_second = ticks_in(plan, 1);
        let mut phases = vec![0];
        phases.extend(change_ticks(arm, plan.scenario.ticks));
        phases.push(plan.scenario.ticks);
        let most = MOST.min(MOST_BYTES / record_bytes(&mut empty_policy(plan)));
        let due = [64, 32, 16, 8, 4, 2, 1].into_iter().map(|dense| {
            let mut due: Vec<u64> =
                phases.windows(2).flat_map(|phase| ticks_of(phase[0], phase[1], dense, ticks_a_second)).collect();
            due.push(ticks_in(plan, FIRST_LOOK_S));
            due.retain(|&tick| tick <= plan.scenario.ticks);
            due.sort_unstable();
            due.dedup();
            due
        });
        due.into_iter().find(|due| due.len() <= most).map(|due| Self { due, ticks_a_second })
    }

    /// The ticks, in order.
    pub fn due(&self) -> &[u64] {
        &self.due
    }
}

/// Copies in the phase from tick `from` to tick `until`: one a second for `2 * dense` seconds, then `dense`
/// in each doubling of the time since `from`, and one at `until`.
fn ticks_of(from: u64, until: u64, dense: u64, ticks_a_second: u64) -> Vec<u64> {
    let mut ticks = Vec::new();
    let (mut at, mut step) = (from, ticks_a_second);
    while at.saturating_add(step) < until {
        at += step;
        ticks.push(at);
        if at - from >= 2 * dense * step {
            step *= 2;
        }
    }
    ticks.push(until);
    ticks
}

/// Ticks in so many seconds of the plant's time, at least 1.
pub fn ticks_in(plan: &Plan, seconds: u64) -> u64 {
    (seconds.saturating_mul(1_000_000_000) / plan.period_ns.max(1)).max(1)
}

/// The ticks from which on the arm is another than before, in a run of `ticks` ticks: in order, each once.
pub fn change_ticks(arm: &ArmConfig, ticks: u64) -> Vec<u64> {
    let blocks = arm.block.iter().map(|change| change.tick);
    let lengths = arm.shorten.iter().map(|change| change.tick);
    let mirrors = arm.mirror.iter().map(|change| change.tick);
    let loads = arm.payload.iter().map(|change| change.tick);
    let all = blocks.chain(lengths).chain(mirrors).chain(loads);
    let mut all: Vec<u64> = all.filter(|tick| (1..ticks).contains(tick)).collect();
    all.sort_unstable();
    all.dedup();
    all
}

fn empty_policy(plan: &Plan) -> LinearPolicy {
    let encoder = plan.encoder();
    LinearPolicy::new(encoder.len(), encoder.positions().collect(), plan.outputs.len())
}

fn record_bytes(policy: &mut LinearPolicy) -> usize {
    HEAD + state::size(policy)
}

/// The file of the copies in a run's folder.
pub fn snapshot_path(folder: &Path) -> PathBuf {
    folder.join("policy_snapshots.bin")
}

/// Writes the copies of a run that are due.
#[derive(Debug)]
pub(super) struct SnapshotRecorder {
    schedule: SnapshotSchedule,
    path: PathBuf,
    seed: u64,
    /// How many of the schedule are behind.
    passed: usize,
    /// Records that still have to be handed to the writer: offset and bytes.
    pending: Vec<(u64, Vec<u8>)>,
}

impl SnapshotRecorder {
    /// A recorder for the run in `folder`, if its policy is copied at all.
    pub fn new(folder: &Path, plan: &Plan) -> Option<Self> {
        let schedule = SnapshotSchedule::of(plan)?;
        Some(Self { schedule, path: snapshot_path(folder), seed: plan.hash, passed: 0, pending: Vec::new() })
    }

    /// Goes on behind everything that was due after `done` ticks or before.
    pub fn skip_to(&mut self, done: u64) {
        self.passed = self.schedule.due.partition_point(|&due| due <= done);
    }

    /// Copies the policy after `done` ticks, if that is due: one comparison where it is not. A copy that is
    /// late by more than a second, because ticks were passed over, is left out.
    pub fn observe(&mut self, done: u64, policy: &LinearPolicy) {
        if self.schedule.due.get(self.passed).is_some_and(|&due| done >= due) {
            self.skip_to(done);
            let slot = self.passed - 1;
            if done - self.schedule.due[slot] <= self.schedule.ticks_a_second {
                self.record(slot, done, policy);
            }
        }
    }

    /// Copies the policy of the run's end, after `done` ticks, into a place of its own.
    pub fn finish(&mut self, done: u64, policy: &LinearPolicy) {
        self.record(self.schedule.due.len(), done, policy);
    }

    fn record(&mut self, slot: usize, done: u64, policy: &LinearPolicy) {
        let mut policy = policy.clone();
        let mut bytes = vec![0; record_bytes(&mut policy)];
        let _ = state::save(&mut policy, &mut bytes[HEAD..]);
        bytes[..8].copy_from_slice(&done.to_le_bytes());
        let check = checksum(&bytes, self.seed);
        bytes[8..HEAD].copy_from_slice(&check.to_le_bytes());
        self.pending.push((slot as u64 * bytes.len() as u64, bytes));
    }

    /// Hands the pending records to the writer.
    pub fn flush(&mut self, writer: &CheckpointWriter) {
        for (offset, bytes) in self.pending.drain(..) {
            writer.write_record(&self.path, offset, bytes);
        }
    }
}

/// The checksum of a record, without the field that holds it.
fn checksum(record: &[u8], seed: u64) -> u64 {
    let tick = xxh3_64_with_seed(&record[..8], seed);
    xxh3_64_with_seed(&record[HEAD..], tick)
}

/// The copies that a run of `plan` left in `folder`, in the order of ticks; damaged or missing ones are left out.
pub fn read_snapshots(folder: &Path, plan: &Plan) -> Vec<PolicySnapshot> {
    let Some(schedule) = SnapshotSchedule::of(plan) else { return Vec::new() };
    let mut empty = empty_policy(plan);
    let size = record_bytes(&mut empty);
    let mut bytes = Vec::new();
    // One for each tick of the schedule, and the last policy.
    let limit = (size * (schedule.due.len() + 1)) as u64;
    let read = std::fs::File::open(snapshot_path(folder)).and_then(|file| file.take(limit).read_to_end(&mut bytes));
    if read.is_err() {
        return Vec::new();
    }
    let word = |record: &[u8], at: usize| u64::from_le_bytes(record[at..at + 8].try_into().unwrap_or_default());
    let mut snapshots: Vec<PolicySnapshot> = bytes
        .chunks_exact(size)
        .filter(|record| word(record, 8) == checksum(record, plan.hash))
        .filter_map(|record| {
            let mut policy = empty.clone();
            state::load(&mut policy, &record[HEAD..]).then(|| PolicySnapshot { tick: word(record, 0), policy })
        })
        .collect();
    snapshots.sort_by_key(|snapshot| snapshot.tick);
    snapshots.dedup_by_key(|snapshot| snapshot.tick);
    snapshots
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::{LearnerConfig, Rule, Scenario};
    use crate::wire::Role;

    fn plan(name: &str, ticks: u64) -> Plan {
        let mut scenario = Scenario::find(name).unwrap();
        scenario.ticks = ticks;
        if name == "arm" {
            scenario.learner = LearnerConfig::preset(Rule::LearnedReward);
        }
        scenario.plan().unwrap()
    }

    #[test]
    fn copies_are_dense_at_first_and_after_the_block() {
        let schedule = SnapshotSchedule::of(&plan("arm", 3600)).unwrap();
        let due = schedule.due();
        assert!(due.len() <= MOST && due.is_sorted(), "{}", due.len());
        for tick in (20..=640).step_by(20).chain((2400..=3040).step_by(20)).chain([3600]) {
            assert!(due.contains(&tick), "{tick}");
        }
        assert!(due.windows(2).all(|pair| pair[1] - pair[0] <= 80), "one in four seconds");
    }

    #[test]
    fn long_and_short_runs_have_few_copies() {
        for (name, ticks) in
            [("paper", 12_000_000), ("paper", 1_000_000_000_000), ("arm", 2), ("arm", 199), ("arm", 3600)]
        {
            let plan = plan(name, ticks);
            let schedule = SnapshotSchedule::of(&plan).unwrap();
            assert!((1..=MOST).contains(&schedule.due().len()), "{name} {ticks}: {}", schedule.due().len());
            assert_eq!(schedule.due().last(), Some(&ticks));
        }
        assert_eq!(SnapshotSchedule::of(&plan("eye", 1000)), None);
        assert_eq!(SnapshotSchedule::of(&plan("open-loop-3", 1000)), None);
        assert_eq!(SnapshotSchedule::of(&plan("servo-emulated", 1000)), None);
    }

    fn policy(plan: &Plan, value: f32) -> LinearPolicy {
        let mut policy = empty_policy(plan);
        *policy.weights_mut().get_mut(0, 0) = value;
        policy
    }

    #[test]
    fn what_was_written_is_read_back_and_damage_is_left_out() {
        let folder = tempfile::tempdir().unwrap();
        let plan = plan("arm", 3600);
        let mut recorder = SnapshotRecorder::new(folder.path(), &plan).unwrap();
        let writer = CheckpointWriter::new(folder.path(), Role::Controller, 0).unwrap();
        for done in [19, 20, 21, 41, 150, 165] {
            // 41: a tick late. 150: due was 140. 165: due was 160.
            recorder.observe(done, &policy(&plan, done as f32));
            recorder.flush(&writer);
        }
        recorder.finish(170, &policy(&plan, 170.0));
        recorder.flush(&writer);
        assert_eq!(writer.finish(), Ok(0), "copies are no checkpoints");
        let found = read_snapshots(folder.path(), &plan);
        let ticks: Vec<_> = found.iter().map(|snapshot| snapshot.tick).collect();
        assert_eq!(ticks, [20, 41, 150, 165, 170]);
        assert!(found.iter().all(|s| s.policy.hash() == policy(&plan, s.tick as f32).hash()));

        let path = snapshot_path(folder.path());
        let mut bytes = std::fs::read(&path).unwrap();
        bytes[HEAD + 3] ^= 1;
        std::fs::write(&path, bytes).unwrap();
        assert_eq!(read_snapshots(folder.path(), &plan)[0].tick, 41);
        let mut other = plan.clone();
        other.hash ^= 1;
        assert!(read_snapshots(folder.path(), &other).is_empty(), "another scenario's");
    }

    #[test]
    fn a_restarted_recorder_goes_on_where_it_was() {
        let plan = plan("arm", 3600);
        let mut recorder = SnapshotRecorder::new(Path::new("x"), &plan).unwrap();
        recorder.skip_to(1000);
        recorder.observe(1001, &policy(&plan, 1.0));
        assert!(recorder.pending.is_empty());
        recorder.observe(1040, &policy(&plan, 1.0));
        assert_eq!(recorder.pending.len(), 1);
    }
}
