//! The ends of a channel: thin, typed, and free of iceoryx2's names for those who use them.

use std::time::Duration;

use iceoryx2::port::{
    listener::Listener,
    notifier::Notifier,
    publisher::Publisher,
    reader::{EntryHandle, Reader},
    subscriber::Subscriber,
    update_connections::UpdateConnections,
    writer::{EntryHandleMut, Writer},
};
use iceoryx2::prelude::*;
use iceoryx2::service::port_factory::publish_subscribe;

use super::ChannelError;
use crate::wire::{Command, Control, Learning, Observation, Sample, Status, Vision};

pub(super) type Factory<T> = publish_subscribe::PortFactory<ipc::Service, T, ()>;

/// What iceoryx2 asks of a payload; granted to the wire's types here, so that the wire need not know iceoryx2.
pub trait Payload: Sample + ZeroCopySend + core::fmt::Debug {}

macro_rules! payload {
    ($($ty:ty),+) => {$(
        // SAFETY: `Sample` implies `bytemuck::Pod`: `repr(C)`, no padding, no pointers, handles or references, every bit
        // pattern valid. The type name carries the layout's version. This says nothing about a program in another
        // language that uses the same name with another layout: the schema hash of the handshake is for that.
        unsafe impl ZeroCopySend for $ty {
            unsafe fn type_name() -> &'static str {
                <$ty as Sample>::NAME
            }
        }
        impl Payload for $ty {}
    )+};
}

payload!(Observation, Command, Learning, Vision, Control, Status);

/// The writing end of a channel.
#[derive(Debug)]
pub struct Sender<T: Payload> {
    port: Publisher<ipc::Service, T, ()>,
    factory: Factory<T>,
    name: String,
}

impl<T: Payload> Sender<T> {
    pub(super) fn new(name: &str, factory: Factory<T>) -> Result<Self, ChannelError> {
        let port = factory
            .publisher_builder()
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .max_loaned_samples(1)
            .create()
            .map_err(|e| ChannelError::set_up(format!("the writing end of channel {name}"), e))?;
        Ok(Self { port, factory, name: name.to_owned() })
    }

    /// Sends a copy of `sample` to every reader. Never waits: a reader that is full loses its oldest sample.
    ///
    /// # Errors
    /// [`ChannelError::Transfer`] when shared memory fails.
    #[inline]
    pub fn send(&self, sample: &T) -> Result<(), ChannelError> {
        let loan = self.port.loan_uninit().map_err(|e| self.failed(e))?;
        loan.write_payload(*sample).send().map_err(|e| self.failed(e))?;
        Ok(())
    }

    /// Connects to the readers that are there, and says how many.
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

    /// The oldest sample that has not been received yet, if there is one.
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

    /// Connects to the writers that are there, and says how many.
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

/// Rings when a sample has been sent, for a reader that sleeps.
#[derive(Debug)]
pub struct WakeNotifier(pub(super) Notifier<ipc::Service>);

impl WakeNotifier {
    /// Wakes the listeners. A failure is not an error of the run: the sample itself has been sent.
    #[inline]
    pub fn notify(&self) {
        let _ = self.0.notify();
    }
}

/// Hears the bell.
#[derive(Debug)]
pub struct WakeListener(pub(super) Listener<ipc::Service>);

impl WakeListener {
    /// Sleeps until the bell rings, for `timeout` at most (and some milliseconds more: the time-out is coarse and only
    /// for looking around). A ring before the call counts.
    pub fn wait(&self, timeout: Duration) {
        let _ = self.0.timed_wait(|_| {}, timeout);
    }
}

/// A process's desk: the launcher's board to read from, its own to write on.
pub struct StatusBoard {
    /// The launcher's board.
    pub control: BoardReader<Control>,
    /// This process's board.
    pub status: BoardWriter<Status>,
    /// The process's start number within the run.
    pub incarnation: u32,
}

/// The writing end of a board: the latest value counts.
pub struct BoardWriter<T: Payload> {
    entry: EntryHandleMut<ipc::Service, u64, T>,
    /// Kept, though the entry would do to write: with it goes the mark by which a dead process's place is found and freed.
    _port: Writer<ipc::Service, u64>,
}

impl<T: Payload> BoardWriter<T> {
    pub(super) fn new(port: Writer<ipc::Service, u64>, page: u32) -> Result<Self, ChannelError> {
        let entry = port.entry::<T>(&u64::from(page)).map_err(|e| ChannelError::set_up("a board's page", e))?;
        Ok(Self { entry, _port: port })
    }

    /// Replaces the value on the board.
    #[inline]
    pub fn put(&self, value: T) {
        self.entry.update_with_copy(value);
    }
}

/// A reading end of a board. A process that comes back writes on a page of its own, since nobody can take the pen from the
/// one before it: readers turn to that page.
pub struct BoardReader<T: Payload> {
    reader: Reader<ipc::Service, u64>,
    entry: EntryHandle<ipc::Service, u64, T>,
    page: u32,
}

impl<T: Payload> BoardReader<T> {
    pub(super) fn new(reader: Reader<ipc::Service, u64>, page: u32) -> Result<Self, ChannelError> {
        let entry = entry(&reader, page)?;
        Ok(Self { reader, entry, page })
    }

    /// The value on the board.
    #[inline]
    pub fn get(&self) -> T {
        *self.entry.get()
    }

    /// Turns to the page of `incarnation`. True if it was another one before.
    ///
    /// # Errors
    /// [`ChannelError::SetUp`] when there is no such page.
    pub fn set_incarnation(&mut self, incarnation: u32) -> Result<bool, ChannelError> {
        if incarnation == self.page {
            return Ok(false);
        }
        self.entry = entry(&self.reader, incarnation)?;
        self.page = incarnation;
        Ok(true)
    }
}

fn entry<T: Payload>(
    reader: &Reader<ipc::Service, u64>,
    page: u32,
) -> Result<EntryHandle<ipc::Service, u64, T>, ChannelError> {
    reader.entry::<T>(&u64::from(page)).map_err(|e| ChannelError::set_up("a board's page", e))
}
