//! Watches one run: reads its log rings, the copy of its boards and its messages, and hands what it finds to the view.
//!
//! Every look takes what has come since the one before. In real time that is all of it, unless the watcher was stopped
//! for longer than a ring lasts. In lockstep a run may do thousands of ticks between two looks, of which the newest are
//! taken. What was not taken is counted. Nothing is ever written.

use tectum_view::{RunView, SeenCommand, SeenLearning, SeenObservation, SeenProcess, WatchedState};

use super::WatchError;
use super::facts::facts;
use super::living::LivingRun;
use crate::channel::{BoardsCopy, BoardsFile, DomainName, LogTail, MessageTail};
use crate::clock::{ProcessHandle, monotonic_ns, wall_ns};
use crate::log::{LogRecord, ViewFacts};
use crate::plant::posture;
use crate::runtime::{Mode, RunManifest};
use crate::scenario::{ArmConfig, Plan, Scenario};
use crate::wire::{ChannelNames, Command, Learning, Observation, Phase, ProcessState, Role, Status, flag};

/// Samples of each channel that a look takes in real time: nearly all that a ring holds.
const REALTIME_SAMPLES: u64 = 1536;
/// The same in lockstep.
const LOCKSTEP_SAMPLES: u64 = 128;

/// A run that is watched.
pub(super) struct RunWatcher {
    /// What is known of it.
    pub view: RunView,
    plan: Plan,
    launcher: ProcessHandle,
    domain: DomainName,
    run: u64,
    observations: LogTail<Observation>,
    commands: LogTail<Command>,
    learning: LogTail<Learning>,
    boards: BoardsFile,
    messages: MessageTail,
    newest: BoardsCopy,
    /// The processes of which the boards tell, by role.
    processes: [Option<(u32, Option<ProcessHandle>)>; 3],
    /// Sequence number of the next observation.
    expected: Option<u64>,
    samples: u64,
    /// Offset from the run's clock to wall time, ns.
    shift_ns: i128,
}

impl RunWatcher {
    /// Begins to watch a run.
    pub fn new(run: LivingRun) -> Result<Self, WatchError> {
        let LivingRun { folder, manifest, launcher, .. } = run;
        let unwatchable = |error: crate::channel::ChannelError| WatchError::Unwatchable {
            path: folder.clone(),
            cause: error.to_string(),
        };
        let plan = Scenario::load(&RunManifest::scenario_path(&folder))?.plan()?;
        let domain = manifest.domain.clone();
        Ok(Self {
            view: RunView::new(facts(&folder, &manifest, &plan)),
            run: manifest.run_id(),
            launcher,
            observations: LogTail::watch(&domain, "observation").map_err(unwatchable)?,
            commands: LogTail::watch(&domain, "command").map_err(unwatchable)?,
            learning: LogTail::watch(&domain, "learning").map_err(unwatchable)?,
            boards: BoardsFile::open(&domain).map_err(unwatchable)?,
            messages: MessageTail::open(&domain).map_err(unwatchable)?,
            newest: BoardsCopy::default(),
            processes: [const { None }; 3],
            expected: None,
            shift_ns: wall_offset(&manifest, plan.period_ns),
            samples: if manifest.mode == Mode::Realtime { REALTIME_SAMPLES } else { LOCKSTEP_SAMPLES },
            domain,
            plan,
        })
    }

    /// The run's id.
    pub fn id(&self) -> u64 {
        self.run
    }

    /// What views of its samples are made of, and the names of its channels.
    pub fn view_facts(&self) -> (ViewFacts, ChannelNames) {
        let facts = ViewFacts::of_plan(&self.plan, self.view.facts.realtime, self.shift_ns);
        (facts, self.plan.scenario.channels.clone())
    }

    /// Takes what has come since the last look, and adds the samples to `kept`. `now` is the watcher's own time, s.
    /// False if the run is over; then there is nothing more to look at.
    pub fn look(&mut self, now: f64, mut kept: Option<&mut Vec<LogRecord>>) -> bool {
        // Before anything is read, so that what was left at the very end is still read.
        let over = self.launcher.ended() || !self.domain.root().exists();
        self.take_observations(kept.as_deref_mut());
        self.commands.skip_to_newest(self.samples);
        for _ in 0..self.samples {
            let Some(sample) = self.commands.receive() else { break };
            kept.iter_mut().for_each(|kept| kept.push(LogRecord::Command(sample)));
            let header = &sample.header;
            let (tick, flags) = (header.tick, header.flags);
            self.view.command(&SeenCommand { tick, flags, published_ns: header.published_ns });
        }
        self.learning.skip_to_newest(self.samples);
        for _ in 0..self.samples {
            let Some(sample) = self.learning.receive() else { break };
            kept.iter_mut().for_each(|kept| kept.push(LogRecord::Learning(sample)));
            let header = &sample.header;
            let (tick, flags) = (header.tick, header.flags);
            let weights_norm = sample.weights_norm;
            self.view.learn(&SeenLearning { tick, flags, published_ns: header.published_ns, weights_norm });
        }
        if let Some(boards) = self.boards.read() {
            self.newest = boards;
            let seen = Role::ALL.map(|role| self.seen_process(&boards, role));
            self.view.boards(seen, now);
        }
        for line in self.messages.read() {
            self.view.say(&line);
        }
        if over {
            self.view.end(&self.how_it_ended());
        }
        !over
    }

    fn take_observations(&mut self, mut kept: Option<&mut Vec<LogRecord>>) {
        self.observations.skip_to_newest(self.samples);
        let arm = self.plan.drawable_arm().cloned();
        let mut next = self.observations.receive();
        for number in 1..=self.samples {
            let Some(sample) = next else { break };
            next = if number < self.samples { self.observations.receive() } else { None };
            let sequence = sample.header.sequence;
            match self.expected {
                // Sent twice, by a plant that came back.
                Some(expected) if sequence < expected => continue,
                Some(expected) => self.view.pass_over(sequence - expected),
                None => {}
            }
            self.expected = Some(sequence + 1);
            kept.iter_mut().for_each(|kept| kept.push(LogRecord::Observation(sample)));
            // In lockstep only the newest is drawn.
            let drawn = self.view.facts.realtime || next.is_none();
            self.take_observation(&sample, arm.as_ref().filter(|_| drawn));
        }
    }

    fn take_observation(&mut self, sample: &Observation, arm: Option<&ArmConfig>) {
        let header = &sample.header;
        let inputs = &sample.inputs[..self.plan.inputs.len()];
        let (mut points, mut target) = (Vec::new(), None);
        if let Some(arm) = arm.filter(|_| inputs.iter().all(|x| x.is_finite())) {
            points = posture(&arm.at(header.tick), &inputs[2..]).iter().map(|p| p.map(|x| x as f32)).collect();
            // Where it is, not where it is said to be.
            target = Some(arm.reported_target(header.tick, [inputs[0], inputs[1]]));
        }
        self.view.observe(&SeenObservation {
            tick: header.tick,
            sequence: header.sequence,
            flags: header.flags,
            first: header.flags & flag::FIRST != 0,
            new_target: header.flags & flag::NEW_TARGET != 0,
            scheduled_ns: header.scheduled_ns,
            sensed_ns: header.sensed_ns,
            published_ns: header.published_ns,
            inputs,
            applied: &sample.applied[..self.plan.outputs.len()],
            reward: sample.reward,
            measures: &sample.measures[..self.plan.measures.len()],
            posture: &points,
            target,
        });
    }

    fn seen_process(&mut self, boards: &BoardsCopy, role: Role) -> SeenProcess {
        let i = role as usize;
        let status: &Status = &boards.status[i];
        if self.processes[i].as_ref().is_none_or(|(pid, _)| *pid != status.pid) {
            self.processes[i] = Some((status.pid, ProcessHandle::of(status.pid)));
        }
        let dead = match &self.processes[i] {
            Some((1.., handle)) => handle.as_ref().is_none_or(ProcessHandle::ended),
            _ => false,
        };
        let state = match status.state() {
            ProcessState::Finished => WatchedState::Finished,
            ProcessState::Failed => WatchedState::Failed,
            _ if dead => WatchedState::Died,
            ProcessState::Absent => WatchedState::Waiting,
            ProcessState::Ready | ProcessState::Connected => WatchedState::SettingUp,
            ProcessState::Running => WatchedState::Running,
            ProcessState::Closing => WatchedState::Closing,
        };
        SeenProcess {
            state,
            restarts: boards.control.incarnations[i],
            gone: boards.control.is_gone(role),
            pid: status.pid,
            ticks: status.ticks,
            missed: status.missed,
            late: status.late,
            lost: status.lost,
        }
    }

    fn how_it_ended(&self) -> String {
        let finished = |role: Role| self.newest.status[role as usize].state() == ProcessState::Finished;
        if self.domain.root().exists() && self.newest.control.phase() < Phase::Stop {
            "the launcher died".to_owned()
        } else if Role::ALL.into_iter().all(finished) && self.view.ticks_done() >= self.plan.scenario.ticks {
            "the run is over".to_owned()
        } else {
            "the run ended early".to_owned()
        }
    }
}

/// Offset from the clock of a run's samples to wall time, ns. In lockstep, tick 0 was when the run was launched; of a
/// part that goes on with another run, its own first tick.
fn wall_offset(manifest: &RunManifest, period_ns: u64) -> i128 {
    if manifest.mode == Mode::Realtime {
        return i128::from(wall_ns()) - i128::from(monotonic_ns());
    }
    let first_ns = manifest.resumed.as_ref().map_or(0, |resumed| resumed.tick * period_ns);
    i128::from(manifest.launched_wall_ns.saturating_sub(first_ns))
}
