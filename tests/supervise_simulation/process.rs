//! A simulated process of a run: it gets ready, ticks, closes its files and ends, as the real ones do by the
//! boards, and at instants that its seed sets it fails.

use rand::RngExt as _;
use tectum::seed::Rng;
use tectum::supervise::DeathKind;
use tectum::wire::{Control, Phase, ProcessState, Role, Status};

/// A millisecond, ns.
pub const MS: u64 = 1_000_000;

/// What happens to one start of a process.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fate {
    /// Nothing.
    Sound,
    /// It ends after running for so long, ns.
    Dies(u64, DeathKind),
    /// From then on it gives no sign of life, and heeds no phase.
    Hangs(u64),
    /// It never gets ready.
    NeverReady,
    /// It lives and does not tick any more: in lockstep, when a sample was lost.
    LosesSample(u64),
}

impl Fate {
    /// A fate; `faulty` is the chance that it is not a sound one.
    pub fn draw(rng: &mut Rng, faulty: f64, lockstep: bool) -> Self {
        if !rng.random_bool(faulty) {
            return Self::Sound;
        }
        let after = rng.random_range(0..3000 * MS);
        match rng.random_range(0..9) {
            0..=3 => Self::Dies(after, DeathKind::Failure),
            4 => Self::Dies(after, DeathKind::EarlyExit),
            5 => Self::Dies(after, DeathKind::Final),
            6 => Self::Hangs(after),
            7 => Self::NeverReady,
            _ if lockstep => Self::LosesSample(after),
            _ => Self::Hangs(after),
        }
    }
}

/// One start of a process.
#[derive(Debug)]
pub struct Process {
    role: Role,
    pub fate: Fate,
    /// How long it takes to get ready, to connect, and to close its files, ns; `None`: the disk never answers.
    ready_ns: u64,
    connect_ns: u64,
    close_ns: Option<u64>,
    began_ns: u64,
    running_since: Option<u64>,
    closing_since: Option<u64>,
    /// Since when it has given no sign of life though it should, ns.
    pub silent_since: Option<u64>,
    /// SIGSTOP.
    pub stopped: bool,
    /// How it has ended, if it has: the kind of its death, or `None` after its part was done.
    pub ended: Option<Option<DeathKind>>,
}

/// How long half of a set-up takes, ns: mostly not long, and never as long as the limit.
fn set_up_ns(rng: &mut Rng) -> u64 {
    let longest = if rng.random_bool(0.05) { 2500 * MS } else { 100 * MS };
    rng.random_range(0..longest)
}

/// What a process sees of the others in a step.
pub struct Peers {
    /// The launcher's board.
    pub control: Control,
    /// Whether plant and controller have finished, or are lost for good.
    pub done: [bool; 2],
    /// Whether all processes tick: in lockstep each waits for the others.
    pub all_tick: bool,
    /// Ticks of the run.
    pub ticks: u64,
}

impl Process {
    /// Starts a process at `now`; `faulty` is the chance that something happens to it.
    pub fn start(role: Role, now: u64, rng: &mut Rng, faulty: f64, lockstep: bool) -> Self {
        let close_ns = match rng.random_range(0..40) {
            0 => None,
            1 => Some(rng.random_range(0..30_000 * MS)),
            _ => Some(rng.random_range(0..50 * MS)),
        };
        Self {
            role,
            fate: Fate::draw(rng, faulty, lockstep),
            ready_ns: set_up_ns(rng),
            connect_ns: set_up_ns(rng),
            close_ns: close_ns.filter(|_| faulty > 0.0).or((faulty == 0.0).then_some(MS)),
            began_ns: now,
            running_since: None,
            closing_since: None,
            silent_since: None,
            stopped: false,
            ended: None,
        }
    }

    /// Whether nothing happens to it.
    pub fn is_sound(&self) -> bool {
        self.fate == Fate::Sound && self.is_quick()
    }

    /// Whether nothing but its death can happen to it, so that nobody waits for it in vain.
    pub fn lives_or_dies(&self) -> bool {
        matches!(self.fate, Fate::Sound | Fate::Dies(..)) && self.is_quick()
    }

    fn is_quick(&self) -> bool {
        self.ready_ns + self.connect_ns < 2900 * MS && self.close_ns.is_some_and(|ns| ns <= 50 * MS)
    }

    /// Whether a launcher may think that it hangs, at `now`.
    pub fn may_be_killed(&self, now: u64, board: &Status, hang_ns: u64, set_up_ns: u64) -> bool {
        let silent = self.silent_since.is_some_and(|since| now - since > hang_ns);
        // One that is connected waits for the launcher.
        let slow = board.state() < ProcessState::Connected && now - self.began_ns > set_up_ns;
        let closes = self.closing_since.is_some_and(|since| now - since > 60_000 * MS);
        silent || slow || closes
    }

    fn hangs(&self, now: u64) -> bool {
        matches!((self.fate, self.running_since), (Fate::Hangs(after), Some(since)) if now >= since + after)
    }

    /// Whether it takes part in ticks at `now`.
    pub fn ticks(&self, now: u64) -> bool {
        let runs = self.running_since.is_some() && self.closing_since.is_none() && self.ended.is_none();
        let lost =
            matches!((self.fate, self.running_since), (Fate::LosesSample(after), Some(since)) if now >= since + after);
        runs && !self.stopped && !self.hangs(now) && !lost
    }

    /// Ends it: as the kind of a death says, unless its part is done.
    pub fn end(&mut self, kind: DeathKind, board: &Status) {
        self.ended.get_or_insert((board.state() != ProcessState::Finished).then_some(kind));
    }

    /// One step, to the instant `now`.
    pub fn step(&mut self, now: u64, board: &mut Status, peers: &Peers) {
        if self.ended.is_some() {
            return;
        }
        if self.stopped || self.hangs(now) {
            self.silent_since.get_or_insert(now);
            return;
        }
        self.silent_since = None;
        let phase = peers.control.phase();
        if phase == Phase::Abort && self.closing_since.is_none() {
            return self.end(DeathKind::EarlyExit, board);
        }
        match board.state() {
            ProcessState::Absent if self.fate != Fate::NeverReady && now >= self.began_ns + self.ready_ns => {
                board.state = ProcessState::Ready as u32;
            }
            ProcessState::Ready
                if phase >= Phase::Connect && now >= self.began_ns + self.ready_ns + self.connect_ns =>
            {
                board.state = ProcessState::Connected as u32;
            }
            ProcessState::Connected if phase >= Phase::Run => {
                board.state = ProcessState::Running as u32;
                self.running_since = Some(now);
            }
            ProcessState::Running => self.run(now, board, peers),
            ProcessState::Closing => {
                let since = *self.closing_since.get_or_insert(now);
                if self.close_ns.is_some_and(|ns| now >= since + ns) {
                    board.state = ProcessState::Finished as u32;
                    self.end(DeathKind::Final, board);
                }
            }
            _ => {}
        }
    }

    fn run(&mut self, now: u64, board: &mut Status, peers: &Peers) {
        board.beat += 1;
        if let (Fate::Dies(after, kind), Some(since)) = (self.fate, self.running_since)
            && now >= since + after
        {
            return self.end(kind, board);
        }
        if self.ticks(now) && peers.all_tick {
            board.ticks = (board.ticks + 1).min(peers.ticks);
        }
        let over = match self.role {
            Role::Plant => peers.control.phase() >= Phase::Stop || board.ticks == peers.ticks,
            Role::Controller => peers.done[0],
            Role::Logger => peers.done == [true; 2],
        };
        if over {
            board.state = ProcessState::Closing as u32;
            self.closing_since = Some(now);
        }
    }
}
