//! The ends of channels: thin and typed, so that their users need not name iceoryx2.

use std::cell::Cell;
use std::mem::MaybeUninit;

use iceoryx2::port::{publisher::Publisher, subscriber::Subscriber, update_connections::UpdateConnections};
use iceoryx2::prelude::*;
use iceoryx2::sample_mut_uninit::SampleMutUninit;
use iceoryx2::service::port_factory::publish_subscribe;

use super::ChannelError;
use crate::wire::{Ahead, Command, Control, Learning, Observation, Sample, Status, Vision};

pub(super) type Factory<T> = publish_subscribe::PortFactory<ipc::Service, T, ()>;

/// A sample that iceoryx2 can carry. Implemented here for the wire's types, so that the wire need not name
/// iceoryx2.
pub trait Payload: Sample + ZeroCopySend + core::fmt::Debug {}

macro_rules! payload {
    ($($ty:ty),+) => {$(
        // SAFETY: `Sample` implies `bytemuck::Pod`: `repr(C)`, no padding, no pointers, handles or references,
        // every bit pattern valid. The type name carries the layout's version. A program in another language
        // could use the same name with another layout; the schema hash of the handshake guards against that.
        unsafe impl ZeroCopySend for $ty {
            unsafe fn type_name() -> &'static str {
                <$ty as Sample>::NAME
            }
        }
        impl Payload for $ty {}
    )+};
}

payload!(Observation, Command, Ahead, Learning, Vision, Control, Status);

/// A sample's place in shared memory that is not filled yet.
type Loan<T> = SampleMutUninit<ipc::Service, MaybeUninit<T>, ()>;

/// The writing end of a channel.
pub struct Sender<T: Payload> {
    /// The place of the next sample, if it was [prepared](Self::prepare). Dropped before the port that it belongs to.
    loan: Cell<Option<Loan<T>>>,
    port: Publisher<ipc::Service, T, ()>,
    factory: Factory<T>,
    name: String,
}

impl<T: Payload> std::fmt::Debug for Sender<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Sender").field("name", &self.name).finish_non_exhaustive()
    }
}

impl<T: Payload> Sender<T> {
    pub(super) fn new(name: &str, factory: Factory<T>) -> Result<Self, ChannelError> {
        let port = factory
            .publisher_builder()
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .max_loaned_samples(1)
            .create()
            .map_err(|e| ChannelError::set_up(format!("the writing end of channel {name}"), e))?;
        Ok(Self { loan: Cell::new(None), port, factory, name: name.to_owned() })
    }

    /// Takes the place of the next sample, and puts `sample` there, which is not sent. A writer that has to wait anyway
    /// so fetches before the wait what the reader's core has had, and its next [`send`](Self::send) need not.
    ///
    /// # Errors
    /// [`ChannelError::Transfer`] when shared memory fails.
    #[inline]
    pub fn prepare(&self, sample: &T) -> Result<(), ChannelError> {
        let mut loan = self.loan()?;
        loan.payload_mut().write(*sample);
        self.loan.set(Some(loan));
        Ok(())
    }

    /// The prepared place, or else one that is free.
    #[inline]
    fn loan(&self) -> Result<Loan<T>, ChannelError> {
        self.loan.take().map_or_else(|| self.port.loan_uninit().map_err(|e| self.failed(e)), Ok)
    }

    /// Sends a copy of `sample` to every reader. Never waits: a reader that is full loses its oldest sample.
    ///
    /// # Errors
    /// [`ChannelError::Transfer`] when shared memory fails.
    #[inline]
    pub fn send(&self, sample: &T) -> Result<(), ChannelError> {
        self.loan()?.write_payload(*sample).send().map_err(|e| self.failed(e))?;
        Ok(())
    }

    /// Sends a copy of `sample` if there is any reader.
    ///
    /// # Errors
    /// [`ChannelError::Transfer`] when shared memory fails.
    #[inline]
    pub fn send_if_read(&self, sample: &T) -> Result<(), ChannelError> {
        if self.factory.dynamic_config().number_of_subscribers() == 0 { Ok(()) } else { self.send(sample) }
    }

    /// Connects to all current readers, and returns their number.
    ///
    /// # Errors
    /// [`ChannelError::Transfer`] when a reader's memory cannot be mapped.
    pub fn connect(&self) -> Result<usize, ChannelError> {
        self.port.update_connections().map_err(|e| self.failed(e))?;
        Ok(self.factory.dynamic_config().number_of_subscribers())
    }

    #[cold]
    fn failed(&self, cause: impl core::fmt::Debug) -> ChannelError {
        ChannelError::Transfer { channel: self.name.clone(), cause: format!("{cause:?}") }
    }
}

/// The reading end of a channel.
#[derive(Debug)]
pub struct Receiver<T: Payload> {
    port: Subscriber<ipc::Service, T, ()>,
    factory: Factory<T>,
    name: String,
}

impl<T: Payload> Receiver<T> {
    pub(super) fn new(name: &str, factory: Factory<T>, buffer: usize) -> Result<Self, ChannelError> {
        let port = factory
            .subscriber_builder()
            .buffer_size(buffer)
            .create()
            .map_err(|e| ChannelError::set_up(format!("the reading end of channel {name}"), e))?;
        Ok(Self { port, factory, name: name.to_owned() })
    }

    /// The oldest sample that has not been received yet.
    ///
    /// # Errors
    /// [`ChannelError::Transfer`] when shared memory fails.
    #[inline]
    pub fn receive(&self) -> Result<Option<T>, ChannelError> {
        match self.port.receive() {
            Ok(sample) => Ok(sample.map(|s| *s)),
            Err(e) => Err(self.failed(e)),
        }
    }

    /// Connects to all current writers, and returns their number.
    ///
    /// # Errors
    /// [`ChannelError::Transfer`] when a writer's memory cannot be mapped.
    pub fn connect(&self) -> Result<usize, ChannelError> {
        self.port.update_connections().map_err(|e| self.failed(e))?;
        Ok(self.factory.dynamic_config().number_of_publishers())
    }

    #[cold]
    fn failed(&self, cause: impl core::fmt::Debug) -> ChannelError {
        ChannelError::Transfer { channel: self.name.clone(), cause: format!("{cause:?}") }
    }
}
