//! One end of a link: who the other end is, whether it lives, and how its clock goes.
//!
//! A thread says hello and measures the clocks; the carrier's thread answers at once what needs no answer of the run.
//! Samples go into an inbox, from which the process that takes a peer's place takes them. Another session is believed
//! only if it has heard of this one, and none that was left before: a datagram that somebody repeats changes nothing.

use std::net::IpAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use tectum::channel::WakeNotifier;
use tectum::clock::monotonic_ns;
use tectum::process::print_error_line;
use tectum::scenario::LinkConfig;
use tectum::wire::Status;

use crate::LinkError;
use crate::carrier::{Carrier, Endpoint};
use crate::clock_offset::{ClockOffset, OffsetEstimator};
use crate::message::{EchoMessage, Hello, Message, PART, ReportPart};
use crate::seal::{LinkSide, ReplayWindow, Sealer, SharedKey, random};
use crate::silence_notice::SilenceNotice;

/// How often the thread looks around.
const LOOK: Duration = Duration::from_millis(20);
/// From one hello to the next, ns.
const HELLO_NS: u64 = 100_000_000;
/// From one round trip to the next once the clocks are known, ns.
const PING_NS: u64 = 250_000_000;
/// Silence after which hellos are for whoever is there: the other end may have been started again, ns.
const ESTRANGED_NS: u64 = 500_000_000;
/// Silence after which an end that connects opens its session anew, ns.
const RENEW_NS: u64 = 2_000_000_000;
/// Samples that may wait in the inbox. More are lost.
const INBOX: usize = 1024;
/// Parts of a report that are sent for each request.
const PARTS: usize = 8;
/// Longest report, bytes.
const LONGEST_REPORT: u32 = 16 << 20;
/// Sessions that were left and are remembered.
const RETIRED: usize = 256;

/// A message that came, and when.
#[derive(Debug)]
pub struct Arrival {
    /// The message.
    pub message: Message,
    /// When it came, ns.
    pub at_ns: u64,
}

/// What is known of the other end.
#[derive(Debug, Clone)]
pub struct Peer {
    /// Its session.
    pub session: u64,
    /// What it said last about itself.
    pub hello: Hello,
    /// When it was last heard, ns.
    pub heard_ns: u64,
}

/// Datagrams that were not taken.
#[derive(Debug, Clone, Copy, Default, serde::Serialize)]
pub struct StrangerCounts {
    /// Made with another key or by another program.
    pub unopened: u64,
    /// Repeated, or of a session that is over.
    pub repeated: u64,
    /// Without room in the inbox.
    pub overflowed: u64,
}

struct State {
    sealer: Sealer,
    own: Hello,
    peer: Option<Peer>,
    window: ReplayWindow,
    retired: Vec<u64>,
    offset: OffsetEstimator,
    counts: StrangerCounts,
    /// The board of the process on the other machine.
    board: Option<Status>,
    /// The report of the process on this machine, for the other one.
    report: Vec<u8>,
    /// What has come of the other machine's report, and its length.
    incoming: Vec<u8>,
    incoming_total: Option<u32>,
    intruder: Option<IpAddr>,
}

struct Shared {
    state: Mutex<State>,
    carrier: OnceLock<Carrier>,
    inbox: SyncSender<Arrival>,
    wake: Option<WakeNotifier>,
    ends: AtomicBool,
}

/// One end of a link.
pub struct LinkConnection {
    shared: Arc<Shared>,
    arrivals: Receiver<Arrival>,
    keeper: Option<JoinHandle<()>>,
}

/// What a connection needs.
pub struct LinkSettings {
    /// Which end this is.
    pub side: LinkSide,
    /// Where the ends meet.
    pub endpoint: Endpoint,
    /// The key, if there is one.
    pub key: Option<SharedKey>,
    /// The addresses that a link without a key may use.
    pub hosts: LinkConfig,
}

impl LinkConnection {
    /// Opens this end. `own` is what it says about itself; `wake` is notified with every sample.
    ///
    /// # Errors
    /// When the network cannot be used.
    pub fn open(settings: LinkSettings, own: Hello, wake: Option<WakeNotifier>) -> Result<Self, LinkError> {
        let LinkSettings { side, endpoint, key, hosts } = settings;
        let session = u64::from_le_bytes(random()?).max(1);
        let limited = key.is_none().then_some(hosts);
        let (inbox, arrivals) = sync_channel(INBOX);
        let state = State {
            sealer: Sealer::new(key, side, session),
            own,
            peer: None,
            window: ReplayWindow::default(),
            retired: Vec::new(),
            offset: OffsetEstimator::default(),
            counts: StrangerCounts::default(),
            board: None,
            report: Vec::new(),
            incoming: Vec::new(),
            incoming_total: None,
            intruder: None,
        };
        let shared = Arc::new(Shared {
            state: Mutex::new(state),
            carrier: OnceLock::new(),
            inbox,
            wake,
            ends: AtomicBool::new(false),
        });
        let taker = Arc::clone(&shared);
        let carrier = Carrier::open(&endpoint, side, limited, Arc::new(move |datagram| taker.take(datagram)))?;
        let _ = shared.carrier.set(carrier);
        let kept = Arc::clone(&shared);
        let keeper = std::thread::Builder::new().name("link-keeper".to_owned()).spawn(move || kept.keep());
        Ok(Self { shared, arrivals, keeper: Some(keeper.map_err(LinkError::Thread)?) })
    }

    /// The other end, if it is known.
    pub fn peer(&self) -> Option<Peer> {
        self.shared.state().peer.clone()
    }

    /// What the other end says of itself lately, read by `look`.
    pub fn peer_says<T>(&self, look: impl FnOnce(&Hello) -> T) -> Option<T> {
        self.shared.state().peer.as_ref().map(|peer| look(&peer.hello))
    }

    /// The clocks, if they are known.
    pub fn offset(&self) -> Option<ClockOffset> {
        self.shared.state().offset.best()
    }

    /// Datagrams that were not taken.
    pub fn counts(&self) -> StrangerCounts {
        self.shared.state().counts
    }

    /// For how long nothing has been heard of the other end, ns.
    pub fn silence_ns(&self) -> u64 {
        self.shared.state().peer.as_ref().map_or(u64::MAX, |peer| monotonic_ns().saturating_sub(peer.heard_ns))
    }

    /// The last board of the process on the other machine.
    pub fn board(&self) -> Option<Status> {
        self.shared.state().board
    }

    /// Changes what this end says of itself, and says it at once.
    pub fn say(&self, change: impl FnOnce(&mut Hello)) {
        change(&mut self.shared.state().own);
        self.shared.hello();
    }

    /// Sends a message to the other end. It is lost where there is none.
    pub fn send(&self, message: &Message) {
        self.shared.send(message);
    }

    /// The next sample, waiting for up to `limit`.
    pub fn receive(&self, limit: Duration) -> Option<Arrival> {
        if limit.is_zero() { self.arrivals.try_recv().ok() } else { self.arrivals.recv_timeout(limit).ok() }
    }

    /// Sets the report of the process on this machine, which the other end may then ask for.
    pub fn set_report(&self, report: Vec<u8>) {
        self.shared.state().report = report;
        self.say(|own| own.reported = true);
    }

    /// The other machine's report once all of it has come. Asks for what is missing.
    pub fn peer_report(&self) -> Option<Vec<u8>> {
        let state = self.shared.state();
        if state.incoming_total.is_some_and(|total| state.incoming.len() >= total as usize) {
            return Some(state.incoming.clone());
        }
        let next = state.incoming.len() as u32;
        drop(state);
        self.shared.send(&Message::Ask(next));
        None
    }
}

impl Drop for LinkConnection {
    fn drop(&mut self) {
        self.shared.ends.store(true, Ordering::Relaxed);
        if let Some(keeper) = self.keeper.take() {
            let _ = keeper.join();
        }
    }
}

impl Shared {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn send_to(&self, session: u64, message: &Message) {
        let datagram = self.state().sealer.seal(&message.encode(session));
        if let Some(carrier) = self.carrier.get() {
            carrier.send(&datagram);
        }
    }

    fn send(&self, message: &Message) {
        let peer = self.state().peer.as_ref().map(|peer| peer.session);
        if let Some(session) = peer {
            self.send_to(session, message);
        }
    }

    /// Says hello to the other end, or to whoever it may be.
    fn hello(&self) {
        let (own, to) = {
            let state = self.state();
            let now = monotonic_ns();
            let heard = state.peer.as_ref().filter(|peer| now.saturating_sub(peer.heard_ns) < ESTRANGED_NS);
            (state.own.clone(), heard.map_or(0, |peer| peer.session))
        };
        self.send_to(to, &Message::Hello(Box::new(own)));
    }

    /// Takes a datagram. True if it is one of the link.
    fn take(&self, datagram: &[u8]) -> bool {
        let at_ns = monotonic_ns();
        let mut state = self.state();
        let opened = state.sealer.open(datagram);
        let Some((opened, (to, message))) = opened.and_then(|o| Message::decode(&o.payload).map(|m| (o, m))) else {
            state.counts.unopened += 1;
            return false;
        };
        if state.intruder.is_some() {
            return false;
        }
        let own = state.sealer.session();
        if state.peer.as_ref().is_none_or(|peer| peer.session != opened.session) {
            return self.take_of_stranger(state, opened.session, to, message, at_ns);
        }
        let meant = to == own || to == 0 && matches!(message, Message::Hello(_));
        if !meant || !state.window.take(opened.count) {
            state.counts.repeated += 1;
            return true;
        }
        if let Some(peer) = &mut state.peer {
            peer.heard_ns = at_ns;
        }
        self.take_message(state, message, at_ns);
        true
    }

    /// A message of a session that is not the other end's. A hello that has heard of this session makes it the other
    /// end; one that has not is answered.
    fn take_of_stranger(
        &self,
        mut state: MutexGuard<'_, State>,
        session: u64,
        to: u64,
        message: Message,
        at_ns: u64,
    ) -> bool {
        let own = state.sealer.session();
        let Message::Hello(hello) = message else {
            state.counts.repeated += 1;
            return false;
        };
        if state.retired.contains(&session) || to != own && to != 0 {
            state.counts.repeated += 1;
            return false;
        }
        if to == own {
            if let Some(left) = state.peer.take() {
                state.retired.push(left.session);
                let more = state.retired.len().saturating_sub(RETIRED);
                state.retired.drain(..more);
            }
            (state.window, state.board) = (ReplayWindow::default(), None);
            (state.incoming, state.incoming_total) = (Vec::new(), None);
            state.offset.clear();
            state.peer = Some(Peer { session, hello: *hello, heard_ns: at_ns });
        }
        let answer = state.own.clone();
        drop(state);
        self.send_to(session, &Message::Hello(Box::new(answer)));
        true
    }

    fn take_message(&self, mut state: MutexGuard<'_, State>, message: Message, at_ns: u64) {
        match message {
            Message::Hello(hello) => {
                if let Some(peer) = &mut state.peer {
                    peer.hello = *hello;
                }
            }
            Message::Ping(echo) => {
                drop(state);
                let echo = EchoMessage { received_ns: at_ns, returned_ns: monotonic_ns(), ..echo };
                self.send(&Message::Pong(echo));
            }
            Message::Pong(echo) => state.offset.take(&echo, at_ns),
            Message::Board(status) => state.board = Some(*status),
            Message::Ask(offset) => {
                let parts = parts(&state.report, offset);
                drop(state);
                parts.into_iter().for_each(|part| self.send(&Message::Report(part)));
            }
            Message::Report(part) => {
                if let Some(next) = state.take_part(&part) {
                    drop(state);
                    self.send(&Message::Ask(next));
                }
            }
            Message::Observation(_) | Message::Answer(..) | Message::Learning(_) | Message::Lockstep(..) => {
                let full = self.inbox.try_send(Arrival { message, at_ns }).is_err();
                state.counts.overflowed += u64::from(full);
                drop(state);
                if let Some(wake) = &self.wake {
                    wake.notify();
                }
            }
        }
    }

    /// The thread that says hello, measures the clocks, and opens the way anew when nothing is heard.
    fn keep(&self) {
        let (mut greeted, mut pinged, mut renewed, mut complained) = (0, 0, monotonic_ns(), false);
        let mut silence = SilenceNotice::default();
        while !self.ends.load(Ordering::Relaxed) {
            let now = monotonic_ns();
            if now - greeted >= HELLO_NS {
                self.hello();
                greeted = now;
            }
            let (known, silent, unopened) = {
                let state = self.state();
                let silent = state.peer.as_ref().map(|peer| now.saturating_sub(peer.heard_ns));
                (state.offset.best().is_some(), silent, state.counts.unopened)
            };
            if !known || now - pinged >= PING_NS {
                self.send(&Message::Ping(EchoMessage { sent_ns: monotonic_ns(), ..EchoMessage::default() }));
                pinged = now;
            }
            if let Some(carrier) = self.carrier.get() {
                if silent.unwrap_or(now) > RENEW_NS && now - renewed > RENEW_NS {
                    carrier.renew();
                    renewed = monotonic_ns();
                }
                self.watch_for_intruders(carrier);
            }
            silent.and_then(|silent| silence.look(silent)).iter().for_each(|line| print_error_line(line));
            if unopened > 0 && !complained {
                print_error_line(
                    "tectum-link: datagrams come that were not made with this link's key; they are dropped and counted",
                );
                complained = true;
            }
            std::thread::park_timeout(LOOK);
        }
    }

    /// Takes nothing more while somebody takes part who may not.
    fn watch_for_intruders(&self, carrier: &Carrier) {
        let intruder = carrier.intruder();
        let before = std::mem::replace(&mut self.state().intruder, intruder);
        if let (Some(address), None) = (intruder, before) {
            print_error_line(&format!(
                "tectum-link: {address} has connected, which link.hosts does not name; nothing is taken while it is \
                 there; give both machines a --key"
            ));
        }
    }
}

impl State {
    /// Takes a part of the report. Returns what to ask for next when a stretch of parts is complete.
    fn take_part(&mut self, part: &ReportPart) -> Option<u32> {
        if part.total == 0 || part.total > LONGEST_REPORT || part.offset as usize != self.incoming.len() {
            return None;
        }
        self.incoming_total = Some(part.total);
        self.incoming.extend(&part.bytes);
        let have = self.incoming.len();
        let more = have < part.total as usize && have.is_multiple_of(PARTS * PART);
        more.then_some(have as u32)
    }
}

/// The next parts of a report.
fn parts(report: &[u8], offset: u32) -> Vec<ReportPart> {
    let rest = report.get(offset as usize..).unwrap_or_default();
    let part = |(i, bytes): (usize, &[u8])| ReportPart {
        offset: offset + (i * PART) as u32,
        total: report.len() as u32,
        bytes: bytes.to_vec(),
    };
    rest.chunks(PART).take(PARTS).enumerate().map(part).collect()
}
