//! `tectum link ping`: how long a datagram takes to the other machine and back, over what carries the link.
//!
//! One end sends every datagram back at once, the other one measures. Nothing of the link's own is in it: no run, no
//! seal, no process beside. So it says what the network and its carrier (zenoh, bare UDP) take.

use std::sync::mpsc::sync_channel;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use serde::Serialize;
use tectum::clock::{TerminationSignals, monotonic_ns, precise_timers, sleep_until};
use tectum::stats::{Percentiles, histogram};

use crate::carrier::{Carrier, Endpoint};
use crate::{LinkError, LinkSide};

/// The first bytes of each datagram.
const MAGIC: [u8; 4] = *b"TLP1";
/// Fewest bytes of a datagram: the magic number, room, and a count.
pub const FEWEST: usize = 16;
/// After this time a datagram counts as lost.
const LOST: Duration = Duration::from_secs(1);
/// How often the listening end looks whether it should end.
const LOOK: Duration = Duration::from_millis(50);

/// What to measure.
#[derive(Debug, Clone, Copy)]
pub struct PingSettings {
    /// Number of datagrams.
    pub count: u64,
    /// Time from one to the next.
    pub every: Duration,
    /// Size, bytes.
    pub bytes: usize,
    /// How long to wait for the other end.
    pub wait: Duration,
}

/// What was measured.
#[derive(Debug, Serialize)]
pub struct RoundTrips {
    /// The address.
    pub address: String,
    /// Datagrams that were sent.
    pub sent: u64,
    /// Those that did not come back within a second.
    pub lost: u64,
    /// Size of each, bytes.
    pub bytes: usize,
    /// Percentiles of the time to the other machine and back, us.
    pub round_trip_us: Option<Percentiles>,
}

impl RoundTrips {
    /// As text for people.
    pub fn to_text(&self) -> String {
        let Self { address, sent, lost, bytes, round_trip_us } = self;
        let mut text = format!("{address}: {sent} datagrams of {bytes} bytes, {lost} lost\n");
        if let Some(Percentiles { p50, p90, p99, max, .. }) = round_trip_us {
            text += &format!("there and back: p50 {p50:.0} us, p90 {p90:.0}, p99 {p99:.0}, largest {max:.0}\n");
        }
        text
    }
}

/// Sends back what comes, until a signal comes.
///
/// # Errors
/// When the address cannot be used.
pub fn answer(endpoint: &Endpoint, signals: &TerminationSignals) -> Result<(), LinkError> {
    let carrier: Arc<OnceLock<Carrier>> = Arc::default();
    let own = Arc::clone(&carrier);
    let receive = Arc::new(move |datagram: &[u8]| {
        let ours = count(datagram).is_some();
        if let (true, Some(carrier)) = (ours, own.get()) {
            carrier.send(datagram);
        }
        ours
    });
    let _ = carrier.set(Carrier::open(endpoint, LinkSide::Plant, None, receive)?);
    while signals.received() == 0 {
        std::thread::park_timeout(LOOK);
    }
    Ok(())
}

/// Measures against an end that sends back. A signal ends it early, with what was measured until then.
///
/// # Errors
/// When the address cannot be used, or nobody answers there.
pub fn measure(
    endpoint: &Endpoint,
    settings: PingSettings,
    signals: &TerminationSignals,
) -> Result<RoundTrips, LinkError> {
    let (arrived, arrivals) = sync_channel(64);
    let receive = Arc::new(move |datagram: &[u8]| {
        let Some(count) = count(datagram) else { return false };
        // One that nobody waits for any more is lost.
        let _ = arrived.try_send((count, monotonic_ns()));
        true
    });
    let carrier = Carrier::open(endpoint, LinkSide::Controller, None, receive)?;
    precise_timers();
    let mut datagram = vec![0; settings.bytes.max(FEWEST)];
    datagram[..4].copy_from_slice(&MAGIC);
    let mut trip = |count: u64, limit: Duration| {
        datagram[8..16].copy_from_slice(&count.to_le_bytes());
        let sent = monotonic_ns();
        carrier.send(&datagram);
        let until = sent + limit.as_nanos() as u64;
        loop {
            let left = Duration::from_nanos(until.saturating_sub(monotonic_ns()));
            match arrivals.recv_timeout(left) {
                Ok((found, at)) if found == count => return Some(at - sent),
                Ok(_) => {}
                Err(_) => return None,
            }
        }
    };
    // Trips with the count 0 find out whether somebody is there, and are not measured.
    let until = monotonic_ns() + settings.wait.as_nanos() as u64;
    while trip(0, LOOK).is_none() {
        if monotonic_ns() > until || signals.received() != 0 {
            return Err(LinkError::NoEcho { address: endpoint.text.clone(), seconds: settings.wait.as_secs() });
        }
    }
    let (mut sent, mut lost, mut times) = (0, 0, histogram());
    let began = monotonic_ns();
    while sent < settings.count && signals.received() == 0 {
        sleep_until(began + sent * settings.every.as_nanos() as u64);
        sent += 1;
        match trip(sent, LOST) {
            Some(ns) => times.saturating_record(ns),
            None => lost += 1,
        }
    }
    let (address, bytes) = (endpoint.text.clone(), settings.bytes.max(FEWEST));
    Ok(RoundTrips { address, sent, lost, bytes, round_trip_us: Percentiles::of(&times) })
}

/// The count of a datagram of this kind.
fn count(datagram: &[u8]) -> Option<u64> {
    let ours = datagram.len() >= FEWEST && datagram[..4] == MAGIC;
    ours.then(|| u64::from_le_bytes(datagram[8..16].try_into().unwrap_or_default()))
}
