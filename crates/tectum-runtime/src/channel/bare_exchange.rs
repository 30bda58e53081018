//! The minimal exchange over iceoryx2: an observation to another process and a command back.
//!
//! It has two publish-subscribe services and a wake-up event for each, but no boards, no crash store and no
//! other readers. `tectum bench` measures the cost of a run's own channels against it.

use std::time::Duration;

use iceoryx2::port::{listener::Listener, notifier::Notifier};
use iceoryx2::prelude::ipc;

use super::domain::{Domain, DomainName};
use super::domain_lock::DomainGuard;
use super::ports::{Factory, Payload, Receiver, Sender};
use super::{ChannelError, service_name};
use crate::wire::{Command, Observation};

/// Name of the service from the asking to the answering process.
const REQUEST: &str = "out";
/// Name of the service back.
const REPLY: &str = "back";
/// Samples that a reader may be behind.
const BUFFER: usize = 2;

/// One end of a bare exchange: it sends `S` and receives `R`.
pub struct BareExchange<S: Payload, R: Payload> {
    to: Sender<S>,
    from: Receiver<R>,
    notifier: Notifier<ipc::Service>,
    listener: Listener<ipc::Service>,
    // Fields drop in this order: the node after its ports, the domain's files after the node.
    _domain: Domain,
    _guard: Option<DomainGuard>,
}

impl BareExchange<Observation, Command> {
    /// Creates the domain `name` and the asking end in it. The domain is removed on drop.
    ///
    /// # Errors
    /// [`ChannelError::SetUp`] when shared memory cannot be used.
    pub fn create(name: &DomainName) -> Result<Self, ChannelError> {
        let guard = DomainGuard::take(name)?;
        let domain = Domain::join(name)?;
        let (request, reply) = (service(&domain, REQUEST)?, service(&domain, REPLY)?);
        Self::new(domain, (REQUEST, request), (REPLY, reply), Some(guard))
    }
}

impl BareExchange<Command, Observation> {
    /// Opens the answering end in the domain `name`.
    ///
    /// # Errors
    /// [`ChannelError::SetUp`] when there is no such domain.
    pub fn open(name: &DomainName) -> Result<Self, ChannelError> {
        let domain = Domain::join(name)?;
        let (request, reply) = (service(&domain, REQUEST)?, service(&domain, REPLY)?);
        Self::new(domain, (REPLY, reply), (REQUEST, request), None)
    }
}

impl<S: Payload, R: Payload> BareExchange<S, R> {
    fn new(
        domain: Domain,
        (to_name, to): (&str, Factory<S>),
        (from_name, from): (&str, Factory<R>),
        guard: Option<DomainGuard>,
    ) -> Result<Self, ChannelError> {
        let event = |name: &str| {
            let name = service_name(&format!("{name}/wake"))?;
            let service = domain.node.service_builder(&name).event().open_or_create();
            service.map_err(|e| ChannelError::set_up("a wake-up service", e))
        };
        let listener =
            event(from_name)?.listener_builder().create().map_err(|e| ChannelError::set_up("a wake-up listener", e))?;
        let notifier =
            event(to_name)?.notifier_builder().create().map_err(|e| ChannelError::set_up("a wake-up notifier", e))?;
        let to = Sender::new(to_name, to)?;
        // Created last, because the other process sends as soon as it sees this end.
        let from = Receiver::new(from_name, from, BUFFER)?;
        Ok(Self { to, from, notifier, listener, _domain: domain, _guard: guard })
    }

    /// Whether the other process has created all its ends.
    ///
    /// # Errors
    /// [`ChannelError::Transfer`] when its memory cannot be mapped.
    pub fn connected(&self) -> Result<bool, ChannelError> {
        Ok(self.from.connect()? >= 1 && self.to.connect()? >= 1)
    }

    /// Wakes the other process.
    #[inline]
    pub fn notify(&self) {
        let _ = self.notifier.notify();
    }

    /// Sleeps until the other process notifies, for `timeout` at most and some milliseconds.
    pub fn wait(&self, timeout: Duration) {
        let _ = self.listener.timed_wait(|_| {}, timeout);
    }
}

/// Sends `S` and receives `R`.
pub trait Exchange<S, R> {
    /// Sends a sample.
    ///
    /// # Errors
    /// [`ChannelError::Transfer`] when the other process's memory cannot be mapped, or there is no free sample.
    fn send(&mut self, sample: &S) -> Result<(), ChannelError>;

    /// The next sample, if there is one.
    ///
    /// # Errors
    /// [`ChannelError::Transfer`] when the other process's memory cannot be mapped.
    fn receive(&mut self) -> Result<Option<R>, ChannelError>;
}

/// One implementation for each end, so that both are compiled in this crate, with full optimisation.
macro_rules! exchange {
    ($out:ty, $in:ty) => {
        impl Exchange<$out, $in> for BareExchange<$out, $in> {
            fn send(&mut self, sample: &$out) -> Result<(), ChannelError> {
                self.to.send(sample).map(drop)
            }

            fn receive(&mut self) -> Result<Option<$in>, ChannelError> {
                self.from.receive()
            }
        }
    };
}

exchange!(Observation, Command);
exchange!(Command, Observation);

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
