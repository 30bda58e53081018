//! The least that iceoryx2 needs to carry an observation to another process and a command back: two services, a bell for
//! each, no boards, no vault, no other readers. What a run's own channels cost is measured against it (`tectum bench`).

use std::time::Duration;

use super::domain::{Domain, DomainName, remove_domain};
use super::ports::{Factory, Payload, Receiver, Sender, WakeListener, WakeNotifier};
use super::stale_domains::DomainLock;
use super::{ChannelError, services::service_name};
use crate::wire::{Command, Observation};

/// Names of the services.
const OUT: &str = "out";
const BACK: &str = "back";
/// Samples that a reader may be behind.
const BUFFER: usize = 2;

/// The ends of a bare exchange: what is sent, what is received, and the bells for both.
pub struct BareExchange<S: Payload, R: Payload> {
    /// To the other process.
    pub to: Sender<S>,
    /// From the other process.
    pub from: Receiver<R>,
    wake: WakeNotifier,
    listener: WakeListener,
    // The node goes after its ports, and the files after the node.
    _domain: Domain,
    _claim: Option<DomainGuard>,
}

/// The domain of a bare exchange: held by the process that asks, and wiped when it is done.
struct DomainGuard {
    name: DomainName,
    _claim: DomainLock,
}

impl Drop for DomainGuard {
    fn drop(&mut self) {
        remove_domain(&self.name);
    }
}

impl BareExchange<Observation, Command> {
    /// Makes the domain `name` and the asking ends in it.
    ///
    /// # Errors
    /// [`ChannelError::SetUp`] when shared memory cannot be used.
    pub fn create(name: &DomainName) -> Result<Self, ChannelError> {
        let claim = DomainLock::take(name).map_err(|e| ChannelError::set_up("the root", e.kind()))?;
        let held = DomainGuard { name: name.clone(), _claim: claim };
        let domain = Domain::join(name)?;
        let (out, back) = (service(&domain, OUT)?, service(&domain, BACK)?);
        Self::ends(domain, (OUT, out), (BACK, back), Some(held))
    }
}

impl BareExchange<Command, Observation> {
    /// Opens the answering ends in the domain `name`.
    ///
    /// # Errors
    /// [`ChannelError::SetUp`] when there is no such domain.
    pub fn open(name: &DomainName) -> Result<Self, ChannelError> {
        let domain = Domain::join(name)?;
        let (out, back) = (service(&domain, OUT)?, service(&domain, BACK)?);
        Self::ends(domain, (BACK, back), (OUT, out), None)
    }
}

impl<S: Payload, R: Payload> BareExchange<S, R> {
    fn ends(
        domain: Domain,
        (to_name, to): (&str, Factory<S>),
        (from_name, from): (&str, Factory<R>),
        claim: Option<DomainGuard>,
    ) -> Result<Self, ChannelError> {
        let event = |name: &str| {
            let name = service_name(&format!("{name}/bell"))?;
            let service = domain.node.service_builder(&name).event().open_or_create();
            service.map_err(|e| ChannelError::set_up("a bell's service", e))
        };
        let listener =
            event(from_name)?.listener_builder().create().map_err(|e| ChannelError::set_up("a wake-up listener", e))?;
        let wake = event(to_name)?.notifier_builder().create().map_err(|e| ChannelError::set_up("a bell", e))?;
        let to = Sender::new(to_name, to)?;
        // Last, because whoever sees this end sends.
        let from = Receiver::new(from_name, from, BUFFER)?;
        Ok(Self {
            to,
            from,
            wake: WakeNotifier(wake),
            listener: WakeListener(listener),
            _domain: domain,
            _claim: claim,
        })
    }

    /// Whether the other process is there, with all its ends.
    ///
    /// # Errors
    /// [`ChannelError::Transfer`] when its memory cannot be mapped.
    pub fn connected(&self) -> Result<bool, ChannelError> {
        Ok(self.from.connect()? >= 1 && self.to.connect()? >= 1)
    }

    /// Wakes the other process.
    #[inline]
    pub fn notify(&self) {
        self.wake.notify();
    }

    /// Sleeps until the other process rings, for `timeout` at most and some milliseconds.
    pub fn wait(&self, timeout: Duration) {
        self.listener.wait(timeout);
    }
}

fn service<T: Payload>(domain: &Domain, name: &str) -> Result<Factory<T>, ChannelError> {
    domain
        .node
        .service_builder(&service_name(name)?)
        .publish_subscribe::<T>()
        .max_publishers(1)
        .max_subscribers(1)
        .subscriber_max_buffer_size(BUFFER)
        .history_size(0)
        .enable_safe_overflow(true)
        .open_or_create()
        .map_err(|e| ChannelError::set_up(format!("channel {name}"), e))
}
