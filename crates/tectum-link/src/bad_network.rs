//! `tectum link network`: a network that loses and delays datagrams and is cut for a while, to try a link on.
//!
//! It stands between the two machines: the end that connects goes to it, and it passes the datagrams on to the end that
//! listens. What is lost follows from a seed. It counts what it lost; where the link has no key, also how many of these
//! were observations and commands, so that a run's misses can be held against it.

use std::net::{IpAddr, SocketAddr, UdpSocket};
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread::Scope;
use std::time::Duration;

use rand::RngExt as _;
use serde::Serialize;
use tectum::clock::{TerminationSignals, monotonic_ns, precise_timers, sleep_until};
use tectum::seed::{Rng, stream};

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
    pub fn to_text(self) -> String {
        let line = |name, WayCounts { passed, lost, samples_lost }: WayCounts| {
            format!("{name}: {passed} datagrams passed, {lost} lost, {samples_lost} of them samples\n")
        };
        line("to the end that listens", self.to_listener) + &line("to the end that connects", self.to_connecting)
    }
}

/// A datagram on its way.
struct Delayed {
    /// When it is to be passed on, ns.
    due_ns: u64,
    bytes: Vec<u8>,
    from: Arc<UdpSocket>,
    to: SocketAddr,
}

/// The end that connects, and a socket towards the other one.
type NewClient = (SocketAddr, std::io::Result<Arc<UdpSocket>>);

/// What all threads share.
struct Traffic {
    network: BadNetwork,
    /// When the first datagram came, ns.
    began: OnceLock<u64>,
    /// The end that connects, as it was last heard. One that opens its way anew has a new address, and gets a new one
    /// towards the other end, as from a router.
    client: Mutex<Option<SocketAddr>>,
    counts: Mutex<NetworkCounts>,
    ends: AtomicBool,
}

impl BadNetwork {
    /// Carries datagrams until a signal comes.
    ///
    /// # Errors
    /// When the address cannot be used, or there can be no thread or no socket.
    pub fn carry(&self, signals: &TerminationSignals) -> Result<NetworkCounts, LinkError> {
        let failed =
            |cause: std::io::Error| LinkError::Carrier { address: self.listen.to_string(), cause: cause.to_string() };
        let near = UdpSocket::bind(self.listen).map_err(failed)?;
        near.set_read_timeout(Some(LOOK)).map_err(failed)?;
        let near = Arc::new(near);
        precise_timers();
        let traffic = Traffic {
            network: self.clone(),
            began: OnceLock::new(),
            client: Mutex::new(None),
            counts: Mutex::default(),
            ends: AtomicBool::new(false),
        };
        std::thread::scope(|scope| {
            let outcome = traffic.carry(scope, &near, signals);
            traffic.ends.store(true, Ordering::Relaxed);
            outcome
        })?;
        Ok(*traffic.counts())
    }
}

/// Starts a thread that ends with `scope`.
fn start<'scope>(scope: &'scope Scope<'scope, '_>, work: impl FnOnce() + Send + 'scope) -> Result<(), LinkError> {
    std::thread::Builder::new().spawn_scoped(scope, work).map(|_| ()).map_err(LinkError::Thread)
}

impl Traffic {
    fn counts(&self) -> MutexGuard<'_, NetworkCounts> {
        self.counts.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn client(&self) -> MutexGuard<'_, Option<SocketAddr>> {
        self.client.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Carries datagrams in threads of `scope` until a signal comes.
    fn carry<'scope>(
        &'scope self,
        scope: &'scope Scope<'scope, '_>,
        near: &Arc<UdpSocket>,
        signals: &TerminationSignals,
    ) -> Result<(), LinkError> {
        let ((later_there, due_there), (later_back, due_back)) = (channel(), channel());
        start(scope, move || pass_on(&due_there))?;
        start(scope, move || pass_on(&due_back))?;
        let (clients, new_clients) = channel();
        let there = Arc::clone(near);
        start(scope, move || self.take_there(&there, &later_there, &clients))?;
        while signals.received() == 0 {
            let Ok((client, far)) = new_clients.recv_timeout(LOOK) else { continue };
            let address = self.network.to.to_string();
            let far = far.map_err(|cause| LinkError::Carrier { address, cause: cause.to_string() })?;
            let (near, later) = (Arc::clone(near), later_back.clone());
            start(scope, move || self.take_back(client, &far, &near, &later))?;
        }
        Ok(())
    }

    /// Takes what the end that connects sends, and hands on each address of it with the socket that stands for it.
    fn take_there(&self, near: &UdpSocket, later: &Sender<Delayed>, clients: &Sender<NewClient>) {
        let (mut random, mut bytes) = (stream(self.network.seed, "to the end that listens"), vec![0; LONGEST]);
        let mut far: Option<Arc<UdpSocket>> = None;
        while !self.ends.load(Ordering::Relaxed) {
            // Errors are time-outs, and what ICMP says of an end that is not there yet.
            let Ok((length, from)) = near.recv_from(&mut bytes) else { continue };
            if self.client().replace(from) != Some(from) {
                let socket = self.far_socket();
                far = socket.as_ref().ok().cloned();
                let _ = clients.send((from, socket));
            }
            let Some(far) = &far else { continue };
            let datagram = &bytes[..length];
            let due_ns = self.due(datagram, &mut random, |counts| &mut counts.to_listener);
            self.hand_on(later, due_ns, datagram, far, self.network.to);
        }
    }

    /// Takes what the end that listens sends to this client, until there is another one.
    fn take_back(&self, client: SocketAddr, far: &UdpSocket, near: &Arc<UdpSocket>, later: &Sender<Delayed>) {
        let (mut random, mut bytes) = (stream(self.network.seed, "to the end that connects"), vec![0; LONGEST]);
        while !self.ends.load(Ordering::Relaxed) && *self.client() == Some(client) {
            let Ok((length, _)) = far.recv_from(&mut bytes) else { continue };
            let datagram = &bytes[..length];
            let due_ns = self.due(datagram, &mut random, |counts| &mut counts.to_connecting);
            self.hand_on(later, due_ns, datagram, near, client);
        }
    }

    fn hand_on(
        &self,
        later: &Sender<Delayed>,
        due_ns: Option<u64>,
        datagram: &[u8],
        from: &Arc<UdpSocket>,
        to: SocketAddr,
    ) {
        if let Some(due_ns) = due_ns {
            // At the end nobody passes it on.
            let _ = later.send(Delayed { due_ns, bytes: datagram.to_vec(), from: Arc::clone(from), to });
        }
    }

    fn far_socket(&self) -> std::io::Result<Arc<UdpSocket>> {
        let any: IpAddr = if self.network.to.is_ipv4() { [0, 0, 0, 0].into() } else { [0; 16].into() };
        let socket = UdpSocket::bind((any, 0))?;
        socket.set_read_timeout(Some(LOOK))?;
        Ok(Arc::new(socket))
    }

    /// When a datagram is to be passed on, ns; `None` if it is lost.
    fn due(
        &self,
        datagram: &[u8],
        random: &mut Rng,
        way: impl FnOnce(&mut NetworkCounts) -> &mut WayCounts,
    ) -> Option<u64> {
        let now = monotonic_ns();
        let since_s = (now - self.began.get_or_init(|| now).min(&now)) as f64 / 1e9;
        let cut = self.network.cut.as_ref().is_some_and(|cut| cut.contains(&since_s));
        // Drawn in any case, so that a cut changes nothing else.
        let lost = random.random::<f64>() < self.network.loss || cut;
        let (mut counts, sample) = (self.counts(), is_sample(datagram));
        let counts = way(&mut counts);
        counts.passed += u64::from(!lost);
        counts.lost += u64::from(lost);
        counts.samples_lost += u64::from(lost && sample);
        (!lost).then_some(now + self.network.delay.as_nanos() as u64)
    }
}

/// Passes datagrams on when they are due, until nobody hands on more.
fn pass_on(due: &Receiver<Delayed>) {
    while let Ok(Delayed { due_ns, bytes, from, to }) = due.recv() {
        if due_ns > monotonic_ns() {
            sleep_until(due_ns);
        }
        // The end may not be there yet.
        let _ = from.send_to(&bytes, to);
    }
}

/// Whether a datagram of bare UDP without a key is an observation or a command.
fn is_sample(datagram: &[u8]) -> bool {
    let message = is_open(datagram).then(|| Message::decode(&datagram[HEADER..])).flatten();
    matches!(message, Some((_, Message::Observation(_) | Message::Answer(..) | Message::Lockstep(..))))
}
