//! What both stand-ins share: joining the run, waiting for the other machine, and the words at the end.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use tectum::channel::{StatusBoard, WakeNotifier};
use tectum::clock::{monotonic_ns, pause};
use tectum::process::print_error_line;
use tectum::runtime::{Participant, Session};
use tectum::wire::{Role, Status};

use crate::LinkError;
use crate::carrier::Endpoint;
use crate::connection::{LinkConnection, LinkSettings};
use crate::handshake::{hello_of, mismatch};
use crate::seal::{LinkSide, SharedKey};

/// How a stand-in finds the other machine.
#[derive(Debug, Clone)]
pub struct StandInSettings {
    /// Which end of the link this is.
    pub side: LinkSide,
    /// Where the ends meet.
    pub endpoint: Endpoint,
    /// The file of the shared key.
    pub key: Option<PathBuf>,
    /// How long to wait for the other machine before the run begins, s.
    pub wait_s: u64,
}

/// How often set-up looks, ns.
const LOOK_NS: u64 = 2_000_000;
/// After this time it says that it waits.
const PATIENCE: Duration = Duration::from_secs(1);
/// How long the last words may take to reach the other end: some hellos long.
const LAST_WORDS: Duration = Duration::from_millis(300);

impl StandInSettings {
    /// The role that this process takes.
    pub fn role(&self) -> Role {
        match self.side {
            LinkSide::Plant => Role::Controller,
            LinkSide::Controller => Role::Plant,
        }
    }

    /// Opens this end of the link for the run of `participant`.
    ///
    /// # Errors
    /// For a key that cannot be read, or an address that cannot be used.
    pub fn connect(&self, participant: &Participant, wake: Option<WakeNotifier>) -> Result<LinkConnection, LinkError> {
        let key = self.key.as_deref().map(SharedKey::read).transpose()?;
        let hosts = participant.plan.scenario.link.clone();
        let settings = LinkSettings { side: self.side, endpoint: self.endpoint.clone(), key, hosts };
        LinkConnection::open(settings, hello_of(participant), wake)
    }

    /// Waits until the other machine's run is there, fits, and its clock is known. A process that comes back in the
    /// middle of a run does not wait.
    ///
    /// # Errors
    /// When it does not come, does not fit, or the run on this machine ends first.
    pub fn await_peer(
        &self,
        connection: &LinkConnection,
        participant: &Participant,
        board: &StatusBoard,
    ) -> Result<(), LinkError> {
        let (began, mut told) = (Instant::now(), false);
        let address = || self.endpoint.text.clone();
        let own = hello_of(participant);
        loop {
            participant.check_set_up(board)?;
            let known = connection.peer_says(|hello| mismatch(self.side, &own, hello));
            if let Some(Some(text)) = known {
                // The other end has to hear who is here, too.
                std::thread::park_timeout(LAST_WORDS);
                return Err(LinkError::Refused(text));
            }
            if known.is_some() && connection.offset().is_some() {
                return Ok(());
            }
            let waited = began.elapsed();
            if waited > PATIENCE && !told {
                let (other, address) = (self.side.other().name(), &self.endpoint.text);
                print_error_line(&format!("tectum-link: waiting for the {other}'s machine at {address}"));
                told = true;
            }
            if waited.as_secs() >= self.wait_s {
                let (address, seconds, side) = (address(), self.wait_s, self.side.other().name());
                let hint = if self.key.is_some() { "the same address and --key" } else { "the same address" };
                return Err(match known {
                    Some(_) => LinkError::Clock { address, seconds },
                    None => LinkError::Silent { address, seconds, side, hint },
                });
            }
            pause(LOOK_NS);
        }
    }
}

/// Tells the other end why this one ends the run, and waits until it can have heard it.
pub fn say_farewell(connection: &LinkConnection, why: &str) {
    connection.say(|own| own.farewell = Some(why.to_owned()));
    std::thread::park_timeout(LAST_WORDS);
}

/// Ends the link in good order: waits until the other end needs nothing more, but not for long.
pub fn say_done(connection: &LinkConnection, limit: Duration) {
    connection.say(|own| own.done = true);
    let began = Instant::now();
    while began.elapsed() < limit && connection.peer_says(|hello| hello.done) == Some(false) {
        if connection.silence_ns() > 500_000_000 {
            return;
        }
        pause(LOOK_NS);
    }
    // The last hello may have been lost.
    (0..3).for_each(|_| connection.say(|_| ()));
}

/// The other machine's report as JSON, once it is there. `keep_up` is called meanwhile; none is waited for when the
/// limit is over, or the other end is silent for that long.
///
/// # Errors
/// As `keep_up`.
pub fn await_report(
    connection: &LinkConnection,
    limit: Duration,
    mut keep_up: impl FnMut() -> Result<(), LinkError>,
) -> Result<Option<serde_json::Value>, LinkError> {
    let (began, mut asked) = (Instant::now(), 0);
    while began.elapsed() < limit {
        keep_up()?;
        let now = monotonic_ns();
        if connection.peer_says(|hello| hello.reported) == Some(true) && now - asked > 30_000_000 {
            if let Some(report) = connection.peer_report() {
                return Ok(serde_json::from_slice(&report).ok());
            }
            asked = now;
        }
        if connection.silence_ns() > 3_000_000_000 {
            return Ok(None);
        }
        pause(LOOK_NS);
    }
    Ok(None)
}

/// Shows the numbers of the process on the other machine on this one's board.
pub fn mirror(session: &mut Session, other: &Status) {
    let own = session.status;
    session.status = Status {
        state: own.state,
        pid: own.pid,
        beat: own.beat,
        ticks: own.ticks,
        sent: own.sent,
        schema: own.schema,
        scenario: own.scenario,
        build: own.build,
        ..*other
    };
}
