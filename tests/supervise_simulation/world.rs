//! The simulated world around the launcher's loop: time that steps, three processes and their boards, and an
//! operating system that refuses at times. It writes down what the loop does, and knows what it must not do.

use std::cell::RefCell;
use std::fmt::Write as _;
use std::rc::Rc;

use rand::RngExt as _;
use tectum::channel::BoardsCopy;
use tectum::scenario::{FaultsConfig, RestartConfig, RestartPolicy};
use tectum::seed::{Rng, stream};
use tectum::supervise::{
    DeathKind, LaunchError, ProcessAction, ProcessDeath, ProcessFailure, RunEnd, RunOutcome, SupervisedWorld,
    SupervisorRules,
};
use tectum::wire::{Control, Phase, ProcessState, Role, Status};

use super::process::{MS, Peers, Process};

/// No run may take longer than this, ns: set-up, ticks, restarts and closing have limits, which add up to less.
const LONGEST_NS: u64 = 3_000_000 * MS;
/// The step of time while processes change, ns.
const STEP_NS: u64 = 5 * MS;

/// What happened in a world, for the checks after the run.
pub struct World {
    rng: Rng,
    now: u64,
    rules: SupervisorRules,
    /// How much longer each wait takes than was asked: a busy machine.
    slowness: u64,
    /// The chance that a start of a process is faulty.
    faulty: f64,
    ticks: u64,
    control: Control,
    boards: [Status; 3],
    processes: [Option<Process>; 3],
    signal_at: Option<u64>,
    checkpoint_at: Option<u64>,
    /// How many starts the operating system refuses.
    refused_starts: u32,
    watched: bool,
    no_memory: bool,
    no_reclaim: bool,
    folder_removal_ns: Option<u64>,
    folder_removed_at: Option<u64>,
    /// Whether each process was sound in all of its starts.
    sound: [bool; 3],
    /// Whether all starts of all processes were sound, or died.
    all_live_or_die: bool,
    /// Starts of each process in a row, none of which lived as long as counts as healthy, and the instant of the last.
    in_a_row: [(u32, u64); 3],
    starts: [u32; 3],
    killed_as_hung: u64,
    broken: Vec<String>,
    history: Vec<(u64, String)>,
    outcome: RefCell<Option<RunOutcome>>,
}

/// The world as the launcher's loop has it.
pub struct SimulatedWorld(Rc<RefCell<World>>);

/// What is left of the world after the run.
pub struct View(Rc<RefCell<World>>);

impl View {
    /// The world, once the launcher's loop has gone.
    pub fn take(self) -> World {
        // The loop may still hold its end when set-up has failed; its world is not used any more.
        self.0.replace(World::new(0))
    }
}

impl World {
    fn new(seed: u64) -> Self {
        let mut rng = stream(seed, "world");
        let policies = [RestartPolicy::Never, RestartPolicy::OnFailure, RestartPolicy::Always];
        let mut policy = || policies[rng.random_range(0..3)];
        // With a long limit the launcher looks seldom while all is well.
        let hang_s = if seed % 4 < 2 { 1.0 } else { 6.0 };
        let restart = RestartConfig { plant: policy(), controller: policy(), logger: policy(), hang_s, ..limits() };
        let realtime = rng.random_bool(0.5);
        let rules = SupervisorRules { realtime, waits: false, restart, faults: FaultsConfig::default() };
        let faulty = [0.0, 0.1, 0.3, 0.8][rng.random_range(0..4)];
        let mut sometimes = |chance: f64, span: u64| rng.random_bool(chance).then(|| rng.random_range(0..span));
        let (signal_at, checkpoint_at) = (sometimes(0.2, 6000 * MS), sometimes(0.2, 3000 * MS));
        let folder_removal_ns = sometimes(0.1, 3000 * MS);
        let mut world = Self {
            now: 1000 * MS,
            slowness: [1, 1, 2, 5][rng.random_range(0..4)],
            faulty,
            ticks: rng.random_range(1..1000),
            control: Control::default(),
            boards: Default::default(),
            processes: Default::default(),
            signal_at: signal_at.map(|at| 1000 * MS + at),
            checkpoint_at: checkpoint_at.map(|at| 1000 * MS + at),
            refused_starts: if rng.random_bool(0.1) { rng.random_range(1..20) } else { 0 },
            // From the seed, so that the others are drawn as ever.
            watched: seed.is_multiple_of(2),
            no_memory: rng.random_bool(0.03),
            no_reclaim: rng.random_bool(0.05),
            folder_removal_ns: folder_removal_ns.map(|at| 1000 * MS + at),
            folder_removed_at: None,
            sound: [true; 3],
            all_live_or_die: true,
            in_a_row: [(0, 0); 3],
            starts: [0; 3],
            killed_as_hung: 0,
            broken: Vec::new(),
            history: Vec::new(),
            outcome: RefCell::default(),
            rules,
            rng,
        };
        Role::ALL.into_iter().for_each(|role| world.start(role));
        world
    }

    fn start(&mut self, role: Role) {
        let process = Process::start(role, self.now, &mut self.rng, self.faulty, !self.rules.realtime);
        self.sound[role as usize] &= process.is_sound();
        self.all_live_or_die &= process.lives_or_dies();
        self.note(format!("{} starts: {:?}", role.name(), process.fate));
        self.boards[role as usize] = Status { ticks: self.boards[role as usize].ticks, ..Status::default() };
        self.processes[role as usize] = Some(process);
        self.starts[role as usize] += 1;
        let (count, last) = &mut self.in_a_row[role as usize];
        *count += 1;
        *last = self.now;
    }

    fn note(&mut self, what: String) {
        self.history.push((self.now, what));
    }

    /// Writes down that a rule does not hold.
    fn broken(&mut self, what: String) {
        self.note(what.clone());
        self.broken.push(what);
    }

    fn step(&mut self, ns: u64) {
        self.now += ns;
        let done =
            |role: Role| self.boards[role as usize].state() == ProcessState::Finished || self.control.is_gone(role);
        let ticks = |process: &Option<Process>| process.as_ref().is_some_and(|process| process.ticks(self.now));
        let peers = Peers {
            control: self.control,
            done: [done(Role::Plant), done(Role::Controller)],
            all_tick: self.rules.realtime || self.processes.iter().all(ticks),
            ticks: self.ticks,
        };
        for (process, board) in self.processes.iter_mut().zip(&mut self.boards) {
            if let Some(process) = process {
                process.step(self.now, board, &peers);
            }
        }
    }

    /// Lets `ns` pass, or less when a process ends or a signal comes. A run that takes too long is ended from outside.
    fn pass(&mut self, ns: u64) {
        let (began, until) = (self.now, self.now + ns * self.slowness);
        while self.now < until {
            self.step(STEP_NS.min(until - self.now));
            let comes = |at: Option<u64>| at.is_some_and(|at| began < at && at <= self.now);
            if comes(self.signal_at)
                || comes(self.checkpoint_at)
                || self.processes.iter().flatten().any(|process| process.ended.is_some())
            {
                break;
            }
        }
        assert!(self.now < LONGEST_NS, "the run does not come to its end\n{}", self.account());
    }

    /// Whether something was in the way of set-up.
    pub fn may_fail_to_set_up(&self) -> bool {
        self.no_memory || self.sound.contains(&false)
    }

    /// What the run must have come to.
    ///
    /// # Errors
    /// The rule that does not hold.
    pub fn check(&self, end: &RunEnd) -> Result<(), String> {
        *self.outcome.borrow_mut() = Some(end.ended);
        if let Some(broken) = self.broken.first() {
            return Err(broken.clone());
        }
        let finished = self.boards.map(|board| board.state() == ProcessState::Finished);
        let signalled = self.signal_at.is_some_and(|at| at <= self.now);
        match end.ended {
            RunOutcome::Complete if finished != [true; 3] => {
                Err(format!("it ended as complete, though not all have finished: {finished:?}"))
            }
            RunOutcome::Complete if end.failure.is_some() => Err(format!("{:?} ended as complete", end.failure)),
            RunOutcome::Signal(_) if !signalled => Err("it ended by a signal that never came".to_owned()),
            RunOutcome::Failed if !signalled && self.sound == [true; 3] && !self.no_memory => {
                Err(format!("all was well, and it failed: {:?}", end.failure))
            }
            _ => self.check_losses(end, finished),
        }
    }

    /// The results of those that did not fail are there, and the restarts are those that the policy allows.
    fn check_losses(&self, end: &RunEnd, finished: [bool; 3]) -> Result<(), String> {
        for role in Role::ALL {
            // Whoever waits for nobody in vain closes in good order, unless the machine is too slow for the limits.
            let ran = self.history.iter().any(|(_, what)| what == "phase Run");
            let in_time = ran && self.slowness == 1 && self.all_live_or_die;
            if in_time && self.sound[role as usize] && !finished[role as usize] {
                return Err(format!("the {} was sound, and did not finish", role.name()));
            }
            let restarts = self.starts[role as usize] - 1;
            let said = end.incidents.iter().filter(|incident| incident.process == role.name()).count();
            if (said as u32) < restarts {
                return Err(format!("the {} was started again {restarts} times, and {said} were stated", role.name()));
            }
            if self.rules.restart.of(role) == RestartPolicy::Never && restarts > 0 {
                return Err(format!("the {} was started again, which its policy forbids", role.name()));
            }
        }
        match (self.folder_removed_at, end.folder_removed_at) {
            (Some(_), None) => Err("the folder was removed, and nobody is told".to_owned()),
            _ => Ok(()),
        }
    }

    /// How the run ended; `None` if it never ran.
    pub fn outcome(&self) -> Option<RunOutcome> {
        *self.outcome.borrow()
    }

    /// Restarts of all processes.
    pub fn restarts(&self) -> u64 {
        self.starts.iter().map(|&starts| u64::from(starts) - 1).sum()
    }

    /// Processes that the launcher killed because they hung.
    pub fn killed_as_hung(&self) -> u64 {
        self.killed_as_hung
    }

    /// The last board of a process.
    pub fn board(&self, role: Role) -> Status {
        self.boards[role as usize]
    }

    /// What happened, with instants in ns.
    pub fn history(&self) -> &[(u64, String)] {
        &self.history
    }

    /// What happened, as text.
    pub fn account(&self) -> String {
        let mut text = format!("{:?}, {} ticks, waits are {} times as long\n", self.rules, self.ticks, self.slowness);
        for (at, what) in &self.history {
            let _ = writeln!(text, "{:10.3} s  {what}", *at as f64 / 1e9);
        }
        text
    }
}

/// Limits short enough for thousands of runs.
fn limits() -> RestartConfig {
    RestartConfig { hang_s: 1.0, healthy_s: 2.0, give_up_after: 4, set_up_s: 3.0, ..RestartConfig::default() }
}

impl SimulatedWorld {
    /// The world of a seed. Its processes have just been started.
    pub fn new(seed: u64) -> Self {
        Self(Rc::new(RefCell::new(World::new(seed))))
    }

    /// The rules by which its run is supervised.
    pub fn rules(&self) -> SupervisorRules {
        self.0.borrow().rules.clone()
    }

    /// A view of it, for the time after the run.
    pub fn view(&self) -> View {
        View(Rc::clone(&self.0))
    }
}

impl SupervisedWorld for SimulatedWorld {
    fn now_ns(&self) -> u64 {
        self.0.borrow().now
    }

    fn pause(&mut self, ns: u64) {
        self.0.borrow_mut().pass(ns);
    }

    fn await_event(&mut self, ns: u64) {
        self.0.borrow_mut().pass(ns);
    }

    fn signal(&self) -> u32 {
        let world = self.0.borrow();
        if world.signal_at.is_some_and(|at| at <= world.now) { 15 } else { 0 }
    }

    fn checkpoint_asked(&mut self) -> bool {
        let mut world = self.0.borrow_mut();
        let now = world.now;
        world.checkpoint_at.take_if(|at| *at <= now).is_some()
    }

    fn status(&self, role: Role) -> Status {
        self.0.borrow().boards[role as usize]
    }

    fn put_control(&mut self, control: Control) {
        let mut world = self.0.borrow_mut();
        if control.phase() != world.control.phase() {
            world.note(format!("phase {:?}", control.phase()));
        }
        if control.phase() < world.control.phase() {
            let phases = (world.control.phase(), control.phase());
            world.broken(format!("after {:?} came {:?}", phases.0, phases.1));
        }
        if control.gone & world.control.gone != world.control.gone {
            world.broken("a process that was lost for good is no longer".to_owned());
        }
        world.control = control;
    }

    fn publish(&mut self, boards: BoardsCopy) {
        let mut world = self.0.borrow_mut();
        if boards.control != world.control {
            world.broken("watchers see another board than the processes".to_owned());
        }
    }

    fn is_watched(&self) -> bool {
        self.0.borrow().watched
    }

    fn fill_memory(&mut self) -> Result<(), LaunchError> {
        match self.0.borrow().no_memory {
            true => Err(LaunchError::Signals(std::io::Error::from(std::io::ErrorKind::StorageFull))),
            false => Ok(()),
        }
    }

    fn reap(&mut self) -> Vec<ProcessDeath> {
        let mut world = self.0.borrow_mut();
        let world = &mut *world;
        let mut deaths = Vec::new();
        for role in Role::ALL {
            let Some(ended) = world.processes[role as usize].as_ref().and_then(|process| process.ended) else {
                continue;
            };
            world.processes[role as usize] = None;
            let (count, started) = &mut world.in_a_row[role as usize];
            if world.now - *started > (world.rules.restart.healthy_s * 1e9) as u64 {
                *count = 0;
            }
            world.note(format!("the {} has ended: {ended:?}", role.name()));
            let failure = ProcessFailure::new(role, format!("the {} ended", role.name()));
            deaths.extend(ended.map(|kind| ProcessDeath { failure, kind }));
        }
        deaths
    }

    fn is_empty(&self, role: Role) -> bool {
        self.0.borrow().processes[role as usize].is_none()
    }

    fn has_child(&self, role: Role) -> bool {
        !self.is_empty(role)
    }

    fn all_ended(&self) -> bool {
        self.0.borrow().processes.iter().all(Option::is_none)
    }

    fn act(&mut self, role: Role, action: ProcessAction) {
        let mut world = self.0.borrow_mut();
        let world = &mut *world;
        let (now, board) = (world.now, world.boards[role as usize]);
        let Some(process) = &mut world.processes[role as usize] else { return };
        match action {
            ProcessAction::Kill => process.end(DeathKind::Failure, &board),
            ProcessAction::KillGroup => {
                let (hang_ns, set_up_ns) = ((world.rules.restart.hang_s * 1e9) as u64, 3000 * MS);
                // Two looks until it counts as silent, and one until it is killed.
                let late = process.silent_since.is_some_and(|since| now - since > hang_ns + 1250 * MS);
                // The launcher's first look at a process may count as silence what was before its first sign of life.
                let allowed = process.may_be_killed(now, &board, hang_ns - 210 * MS, set_up_ns);
                process.end(DeathKind::Failure, &board);
                world.killed_as_hung += 1;
                world.note(format!("the {} is killed as hung", role.name()));
                if late && world.slowness == 1 && board.state() == ProcessState::Running {
                    world.broken(format!("the {} hung, and was killed too late", role.name()));
                }
                if !allowed {
                    world.broken(format!("the {} lived, and was killed as hung", role.name()));
                }
            }
            ProcessAction::Stop => process.stopped = true,
            ProcessAction::Continue => process.stopped = false,
            ProcessAction::Terminate => process.end(DeathKind::EarlyExit, &board),
        }
    }

    fn kill_all(&mut self) {
        let mut world = self.0.borrow_mut();
        world.note("all are killed".to_owned());
        world.processes = Default::default();
    }

    fn reclaim(&mut self) -> bool {
        !self.0.borrow().no_reclaim
    }

    fn set_incarnation(&mut self, role: Role, incarnation: u32) -> Result<(), String> {
        let mut world = self.0.borrow_mut();
        if incarnation == 0 || world.processes[role as usize].is_some() {
            world.broken(format!("the {} of incarnation {incarnation} has a predecessor that lives", role.name()));
        }
        Ok(())
    }

    fn start_again(&mut self, role: Role) -> Result<(), String> {
        let mut world = self.0.borrow_mut();
        let sets_up = |role: Role| {
            world.processes[role as usize].is_some() && world.boards[role as usize].state() < ProcessState::Running
        };
        let two = Role::ALL.into_iter().any(sets_up);
        if two || world.control.phase() != Phase::Run {
            let phase = world.control.phase();
            world.broken(format!("the {} is started in phase {phase:?}, beside another: {two}", role.name()));
        }
        if world.refused_starts > 0 {
            world.refused_starts -= 1;
            world.sound[role as usize] = false;
            world.note(format!("the {} cannot be started", role.name()));
            return Err("no room for a process".to_owned());
        }
        world.start(role);
        if world.in_a_row[role as usize].0 > world.rules.restart.give_up_after + 1 {
            world.broken(format!("the {} dies at once, and is started again and again", role.name()));
        }
        Ok(())
    }

    fn await_last_words(&mut self) {}

    fn folder_removed(&mut self, _now: bool, tick: u64) -> bool {
        let mut world = self.0.borrow_mut();
        let removed = world.folder_removal_ns.is_some_and(|at| at <= world.now) && world.folder_removed_at.is_none();
        if removed {
            world.folder_removed_at = Some(tick);
        }
        removed
    }

    fn folder_removed_at(&self) -> Option<u64> {
        self.0.borrow().folder_removed_at
    }

    fn say(&mut self, message: &str) {
        self.0.borrow_mut().note(format!("says: {message}"));
    }

    fn say_to_watchers(&mut self, _message: &str) {}

    fn show_progress(&mut self) {}

    fn clear_progress(&mut self) {}
}
