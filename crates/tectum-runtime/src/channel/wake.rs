//! The wake-up word: how the plant wakes the controller in real time.
//!
//! A file of the run's domain holds a counter of 32 bits, which all processes of the run map. The plant adds one
//! after each observation, and wakes whoever sleeps on the counter's futex. iceoryx2 carries the observation
//! itself. Its own event takes three times as long to wake a process as a futex does: it goes through a socket,
//! and through code that is cold after 50 ms.
//!
//! There is no queue: a listener that slept through two notifications wakes up once, and reads the newest
//! observation. A dead process leaves nothing behind, because the kernel forgets its sleep with it.

use std::fs::{File, OpenOptions};
use std::path::PathBuf;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use memmap2::{MmapMut, MmapOptions};
use rustix::fs::{FallocateFlags, fallocate};
use rustix::thread::futex::{self, Flags, Timespec};

use super::own_files::open_own;
use super::{ChannelError, DomainName};

/// Bytes of the file; the counter is its first word.
const SIZE: usize = 64;

/// The file of the domain's wake-up word.
pub fn wake_file(domain: &DomainName) -> PathBuf {
    domain.root().join("wake")
}

/// The mapped counter.
#[derive(Debug)]
pub(super) struct WakeWord(MmapMut);

impl WakeWord {
    /// Creates the file. For the launcher, before any process of the run starts.
    ///
    /// # Errors
    /// [`ChannelError::SetUp`] when shared memory has no room for it.
    pub(super) fn create(domain: &DomainName) -> Result<Self, ChannelError> {
        let failed = |cause: std::io::Error| ChannelError::set_up("the wake-up word", cause);
        let mut options = OpenOptions::new();
        let file = open_own(&wake_file(domain), options.read(true).write(true).create_new(true)).map_err(failed)?;
        // Allocates the page now: without room, a later write through the map would kill the process.
        fallocate(&file, FallocateFlags::empty(), 0, SIZE as u64).map_err(|e| failed(e.into()))?;
        Self::map(&file).map_err(failed)
    }

    /// Opens the file of a run.
    ///
    /// # Errors
    /// [`ChannelError::SetUp`] when there is no such run.
    pub(super) fn open(domain: &DomainName) -> Result<Self, ChannelError> {
        let failed = |cause: std::io::Error| ChannelError::set_up("the wake-up word", cause);
        let file = open_own(&wake_file(domain), OpenOptions::new().read(true).write(true)).map_err(failed)?;
        if file.metadata().map_err(failed)?.len() != SIZE as u64 {
            return Err(failed(std::io::Error::other("its size is wrong")));
        }
        Self::map(&file).map_err(failed)
    }

    fn map(file: &File) -> std::io::Result<Self> {
        // SAFETY: A map is sound as long as no other process truncates the file under it. Its folder belongs to the
        // run and is accessible to its user alone. The launcher gives the file its size before any process opens
        // it, and removes it, without truncating it, at the end of the run. All processes access it through atomics.
        unsafe { MmapOptions::new().len(SIZE).map_mut(file) }.map(Self)
    }

    fn count(&self) -> &AtomicU32 {
        // SAFETY: The map has SIZE bytes, is page-aligned, readable and writable, and lives as long as `self`. Every
        // process accesses the word only as an atomic, so there is no data race.
        unsafe { &*self.0.as_ptr().cast::<AtomicU32>() }
    }
}

/// Wakes the controller after an observation has been sent.
#[derive(Debug)]
pub struct WakeNotifier(WakeWord);

impl WakeNotifier {
    /// Opens the word of the run in `domain`.
    ///
    /// # Errors
    /// [`ChannelError::SetUp`] when there is no such run.
    pub fn open(domain: &DomainName) -> Result<Self, ChannelError> {
        WakeWord::open(domain).map(Self)
    }

    /// Wakes every listener.
    #[inline]
    pub fn notify(&self) {
        let count = self.0.count();
        count.fetch_add(1, Ordering::Release);
        // It fails only for an address that is not mapped.
        let _ = futex::wake(count, Flags::empty(), i32::MAX as u32);
    }
}

/// Waits for a [`WakeNotifier`].
#[derive(Debug)]
pub struct WakeListener {
    word: WakeWord,
    /// The count at the last wake-up.
    seen: u32,
}

impl WakeListener {
    pub(super) fn open(domain: &DomainName) -> Result<Self, ChannelError> {
        let word = WakeWord::open(domain)?;
        let seen = word.count().load(Ordering::Acquire);
        Ok(Self { word, seen })
    }

    /// Sleeps until a notification arrives, for `timeout` at most, or until a signal. A notification since the last
    /// call counts.
    pub fn wait(&mut self, timeout: Duration) {
        let count = self.word.count();
        if count.load(Ordering::Acquire) == self.seen {
            let limit = Timespec { tv_sec: timeout.as_secs() as i64, tv_nsec: i64::from(timeout.subsec_nanos()) };
            // The caller looks for what it waits for, whatever ended the sleep.
            let _ = futex::wait(count, Flags::empty(), self.seen, Some(&limit));
        }
        self.seen = count.load(Ordering::Acquire);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_notification_wakes_every_listener_and_is_not_lost_in_between() {
        let domain = DomainName::of(u64::from(std::process::id()) << 32 ^ 0x3a6e);
        std::fs::create_dir_all(domain.root()).unwrap();
        let _word = WakeWord::create(&domain).unwrap();
        let again = WakeWord::create(&domain).is_err();
        let notifier = WakeNotifier::open(&domain).unwrap();
        let mut listeners = [WakeListener::open(&domain).unwrap(), WakeListener::open(&domain).unwrap()];
        notifier.notify();
        // A wait without a notification would last for an hour, and the test's watchdog would end it.
        let hour = Duration::from_secs(3600);
        listeners.iter_mut().for_each(|listener| listener.wait(hour));
        std::thread::scope(|scope| {
            for listener in &mut listeners {
                scope.spawn(move || listener.wait(hour));
            }
            notifier.notify();
        });
        listeners[0].wait(Duration::from_millis(1));
        std::fs::write(wake_file(&domain), "short").unwrap();
        let short = WakeNotifier::open(&domain).is_err();
        super::super::remove_domain(&domain);
        assert!(again && short && WakeNotifier::open(&domain).is_err());
    }
}
