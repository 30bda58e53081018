//! `tectum link network`: a network that loses and delays datagrams and is cut for a while, to try a link on.
//!
//! It stands between the two machines: the end that connects goes to it, and it passes the datagrams on to the end that
//! listens. What is lost follows from a seed. It counts what it lost; where the link has no key, also how many of these
//! were observations and commands, so that a run's misses can be held against it.

use std::net::{SocketAddr, UdpSocket};
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;

use rand::RngExt as _;
use serde::Serialize;
use tectum::clock::{TerminationSignals, monotonic_ns, precise_timers, sleep_until};
use tectum::seed::stream;

use crate::LinkError;
use crate::message::Message;
use crate::seal::{HEADER, is_open};

/// Longest datagram, bytes.
const LONGEST: usize = 65_536;
/// How often a thread looks whether it should end.
const LOOK: Duration = Duration::from_millis(50);

/// How the network is.
#[derive(Debug, Clone)]
pub struct BadNetwork {
    /// Where the end that connects goes to.
    pub listen: SocketAddr,
    /// The end that listens.
    pub to: SocketAddr,
    /// Share of the datagrams that are lost, each way.
    pub loss: f64,
    /// Delay each way.
    pub delay: Duration,
    /// Seconds after the first datagram in which nothing passes.
    pub cut: Option<Range<f64>>,
    /// Seed of what is lost.
    pub seed: u64,
}

/// What passed one way, and what did not.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct WayCounts {
    /// Datagrams that were passed on.
    pub passed: u64,
    /// Datagrams that were lost.
    pub lost: u64,
    /// Observations (to the controller) or commands (to the plant) among those, where the link has no key.
    pub samples_lost: u64,
}

/// What [`BadNetwork::carry`] counted.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct NetworkCounts {
    /// From the end that connects to the one that listens.
    pub to_listener: WayCounts,
    /// And back.
    pub to_connecting: WayCounts,
}

impl NetworkCounts {
    /// As text for people.
    pub fn to_text(&self) -> String {
        let line = |name, WayCounts { passed, lost, samples_lost }: WayCounts| {
            format!("{name}: {passed} datagrams passed, {lost} lost, {samples_lost} of them samples\n")
        };
        line("to the end that listens", self.to_listener) + &line("to the end that connects", self.to_connecting)
    }
}

/// One way through the network.
struct Way {
    network: BadNetwork,
    name: &'static str,
    /// When the first datagram came, ns.
    began: Arc<OnceLock<u64>>,
    ends: Arc<AtomicBool>,
}

/// A datagram, and when it is to be passed on.
type Delayed = (u64, Vec<u8>);

impl BadNetwork {
    /// Carries datagrams until a signal comes.
    ///
    /// # Errors
    /// When the address cannot be used, or the system has no thread.
    pub fn carry(&self, signals: &TerminationSignals) -> Result<NetworkCounts, LinkError> {
        let failed =
            |cause: std::io::Error| LinkError::Carrier { address: self.listen.to_string(), cause: cause.to_string() };
        let any = SocketAddr::new(if self.to.is_ipv4() { [0, 0, 0, 0].into() } else { [0; 8].into() }, 0);
        let (near, far) = (UdpSocket::bind(self.listen).map_err(failed)?, UdpSocket::bind(any).map_err(failed)?);
        for socket in [&near, &far] {
            socket.set_read_timeout(Some(LOOK)).map_err(failed)?;
        }
        precise_timers();
        // Where the end that connects was last heard.
        let (known, began, ends) =
            (Arc::new(Mutex::new(None)), Arc::new(OnceLock::new()), Arc::new(AtomicBool::new(false)));
        let way = |name| Way { network: self.clone(), name, began: Arc::clone(&began), ends: Arc::clone(&ends) };
        let (there, back) = (way("to the listener"), way("to the connecting end"));
        let (heard, to) = (Arc::clone(&known), self.to);
        let hear = move |from| *heard.lock().unwrap_or_else(PoisonError::into_inner) = Some(from);
        let knows = move || *known.lock().unwrap_or_else(PoisonError::into_inner);
        let (near_in, near_out, far_in, far_out) =
            (near.try_clone().map_err(failed)?, near, far.try_clone().map_err(failed)?, far);
        std::thread::scope(|scope| {
            let (later_there, due_there) = channel();
            let (later_back, due_back) = channel();
            scope.spawn(move || pass_on(&due_there, &far_out, || Some(to)));
            scope.spawn(move || pass_on(&due_back, &near_out, knows));
            let there = scope.spawn(move || there.take(&near_in, &later_there, hear));
            let back = scope.spawn(move || back.take(&far_in, &later_back, |_| ()));
            while signals.received() == 0 {
                std::thread::park_timeout(LOOK);
            }
            ends.store(true, Ordering::Relaxed);
            let counts = |way: std::thread::ScopedJoinHandle<'_, WayCounts>| way.join().unwrap_or_default();
            Ok(NetworkCounts { to_listener: counts(there), to_connecting: counts(back) })
        })
    }
}

impl Way {
    /// Takes datagrams from `socket`, and hands on those that are not lost.
    fn take(&self, socket: &UdpSocket, later: &Sender<Delayed>, hear: impl Fn(SocketAddr)) -> WayCounts {
        let mut random = stream(self.network.seed, self.name);
        let (mut counts, mut bytes) = (WayCounts::default(), vec![0; LONGEST]);
        let delay_ns = self.network.delay.as_nanos() as u64;
        while !self.ends.load(Ordering::Relaxed) {
            // Errors are time-outs, and what ICMP says of an end that is not there yet.
            let Ok((length, from)) = socket.recv_from(&mut bytes) else { continue };
            hear(from);
            let now = monotonic_ns();
            let since_s = (now - self.began.get_or_init(|| now).min(&now)) as f64 / 1e9;
            let cut = self.network.cut.as_ref().is_some_and(|cut| cut.contains(&since_s));
            // Drawn in any case, so that a cut changes nothing else.
            if random.random::<f64>() < self.network.loss || cut {
                counts.lost += 1;
                counts.samples_lost += u64::from(is_sample(&bytes[..length]));
            } else if later.send((now + delay_ns, bytes[..length].to_vec())).is_ok() {
                counts.passed += 1;
            }
        }
        counts
    }
}

/// Passes datagrams on when they are due, until nobody hands on more.
fn pass_on(due: &Receiver<Delayed>, socket: &UdpSocket, to: impl Fn() -> Option<SocketAddr>) {
    while let Ok((at, bytes)) = due.recv() {
        if at > monotonic_ns() {
            sleep_until(at);
        }
        if let Some(to) = to() {
            // The end may not be there yet.
            let _ = socket.send_to(&bytes, to);
        }
    }
}

/// Whether a datagram of bare UDP without a key is an observation or a command.
fn is_sample(datagram: &[u8]) -> bool {
    let message = is_open(datagram).then(|| Message::decode(&datagram[HEADER..])).flatten();
    matches!(message, Some((_, Message::Observation(_) | Message::Answer(_) | Message::Lockstep(_))))
}
