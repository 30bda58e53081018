//! The wake-up words: how the plant wakes the controller in real time, and how both wake each other in lockstep.
//!
//! A file of the run's domain holds a counter of 32 bits, which all processes of the run map. The plant adds one
//! after each observation, and wakes whoever sleeps on the counter's futex. iceoryx2 carries the observation
//! itself. Its own event takes three times as long to wake a process as a futex does: it goes through a socket,
//! and through code that is cold after 50 ms.
//!
//! There is no queue: a listener that slept through two notifications wakes up once, and reads the newest
//! observation. A dead process leaves nothing behind, because the kernel forgets its sleep with it.
//!
//! In lockstep plant and controller poll and yield, and need no wake-up as long as no other program wants their cores.
//! Where one does, they sleep instead ([`InterruptibleSleep`]). A second word beside each counter tells the peer
//! that it is waited for; nobody writes it as long as nobody sleeps, so that reading it costs nothing. A peer in
//! another language need not heed it: sleeps are short, and become shorter if nobody ends them.

use std::fs::{File, OpenOptions};
use std::path::PathBuf;
use std::sync::atomic::{AtomicU32, Ordering, fence};
use std::time::Duration;

use memmap2::{MmapMut, MmapOptions};
use rustix::fs::{FallocateFlags, fallocate};
use rustix::thread::futex::{self, Flags, Timespec};

use super::own_files::open_own;
use super::{ChannelError, DomainName};
use crate::clock::InterruptibleSleep;
use crate::wire::Role;

/// Bytes of the file: for each process that is woken a counter, and whether it waits in lockstep.
const SIZE: usize = 64;

/// The place of a process's counter among the words; whether it waits stands behind it.
fn place(role: Role) -> usize {
    if role == Role::Plant { 2 } else { 0 }
}

/// The file of the domain's wake-up word.
pub fn wake_file(domain: &DomainName) -> PathBuf {
    domain.root().join("wake")
}

/// The mapped words, and the place of those that are used.
#[derive(Debug)]
pub(super) struct WakeWord(MmapMut, usize);

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
        Self::map(&file, Role::Controller).map_err(failed)
    }

    /// Opens the file of a run, for the words of `role`.
    ///
    /// # Errors
    /// [`ChannelError::SetUp`] when there is no such run.
    pub(super) fn open(domain: &DomainName, role: Role) -> Result<Self, ChannelError> {
        let failed = |cause: std::io::Error| ChannelError::set_up("the wake-up word", cause);
        let file = open_own(&wake_file(domain), OpenOptions::new().read(true).write(true)).map_err(failed)?;
        if file.metadata().map_err(failed)?.len() != SIZE as u64 {
            return Err(failed(std::io::Error::other("its size is wrong")));
        }
        Self::map(&file, role).map_err(failed)
    }

    fn map(file: &File, role: Role) -> std::io::Result<Self> {
        // SAFETY: A map is sound as long as no other process truncates the file under it. Its folder belongs to the
        // run and is accessible to its user alone. The launcher gives the file its size before any process opens
        // it, and removes it, without truncating it, at the end of the run. All processes access it through atomics.
        unsafe { MmapOptions::new().len(SIZE).map_mut(file) }.map(|map| Self(map, place(role)))
    }

    fn words(&self) -> &[AtomicU32; SIZE / 4] {
        // SAFETY: The map has SIZE bytes, is page-aligned, readable and writable, and lives as long as `self`. Every
        // process accesses the words only as atomics, so there is no data race.
        unsafe { &*self.0.as_ptr().cast::<[AtomicU32; SIZE / 4]>() }
    }

    fn count(&self) -> &AtomicU32 {
        &self.words()[self.1]
    }

    fn waits(&self) -> &AtomicU32 {
        &self.words()[self.1 + 1]
    }
}

/// Wakes the controller after an observation has been sent, or in lockstep either process after a sample.
#[derive(Debug)]
pub struct WakeNotifier(WakeWord);

impl WakeNotifier {
    /// Opens the word of the run in `domain`.
    ///
    /// # Errors
    /// [`ChannelError::SetUp`] when there is no such run.
    pub fn open(domain: &DomainName) -> Result<Self, ChannelError> {
        Self::of(domain, Role::Controller)
    }

    /// The same, for the words of `role`.
    pub(super) fn of(domain: &DomainName, role: Role) -> Result<Self, ChannelError> {
        WakeWord::open(domain, role).map(Self)
    }

    /// Wakes every listener that [waits](InterruptibleSleep::set_expected) in lockstep, after a sample has been sent.
    #[inline]
    pub fn notify_waiting(&self) {
        // The sample is visible before the word is read: whoever begins to wait later finds it.
        fence(Ordering::SeqCst);
        if self.0.waits().load(Ordering::Relaxed) != 0 {
            self.notify();
        }
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
    /// In lockstep: the longest sleep, ns, and whether the last one took as long.
    sleep_ns: u64,
    slept: bool,
}

/// Shortest and longest sleep in lockstep, ns.
const SHORTEST_SLEEP_NS: u64 = 5_000;
const LONGEST_SLEEP_NS: u64 = 1_000_000;

impl WakeListener {
    pub(super) fn open(domain: &DomainName, role: Role) -> Result<Self, ChannelError> {
        let word = WakeWord::open(domain, role)?;
        // A process that was killed may have waited.
        word.waits().store(0, Ordering::Relaxed);
        let seen = word.count().load(Ordering::Acquire);
        Ok(Self { word, seen, sleep_ns: LONGEST_SLEEP_NS / 8, slept: false })
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

impl InterruptibleSleep for WakeListener {
    fn set_expected(&mut self, expected: bool) {
        self.word.waits().store(u32::from(expected), Ordering::Relaxed);
        fence(Ordering::SeqCst);
        self.seen = self.word.count().load(Ordering::Acquire);
    }

    fn sleep(&mut self) {
        let before = self.seen;
        self.wait(Duration::from_nanos(self.sleep_ns));
        self.slept = self.seen == before;
    }

    /// If it came without a wake-up, the peer wakes nobody, and sleeps have to be short.
    fn arrived(&mut self) {
        let next_ns = if self.slept { self.sleep_ns / 2 } else { self.sleep_ns * 2 };
        self.sleep_ns = next_ns.clamp(SHORTEST_SLEEP_NS, LONGEST_SLEEP_NS);
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
        let mut listeners = [
            WakeListener::open(&domain, Role::Controller).unwrap(),
            WakeListener::open(&domain, Role::Controller).unwrap(),
        ];
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

    #[test]
    fn a_process_that_waits_in_lockstep_is_woken_and_no_other() {
        let domain = DomainName::of(u64::from(std::process::id()) << 32 ^ 0x3a6f);
        std::fs::create_dir_all(domain.root()).unwrap();
        let _word = WakeWord::create(&domain).unwrap();
        let [plant, controller] = [Role::Plant, Role::Controller].map(|role| WakeNotifier::of(&domain, role).unwrap());
        let mut listener = WakeListener::open(&domain, Role::Plant).unwrap();
        plant.notify_waiting();
        assert_eq!(plant.0.count().load(Ordering::Relaxed), 0, "nobody waits");
        listener.set_expected(true);
        controller.notify_waiting();
        plant.notify_waiting();
        assert_eq!([&plant, &controller].map(|word| word.0.count().load(Ordering::Relaxed)), [1, 0]);
        // Woken in time, it may sleep for longer; what comes without a wake-up makes its sleeps short.
        let first_ns = listener.sleep_ns;
        listener.sleep();
        listener.arrived();
        assert_eq!(listener.sleep_ns, 2 * first_ns);
        (0..20).for_each(|_| {
            listener.sleep();
            listener.arrived();
        });
        assert_eq!(listener.sleep_ns, SHORTEST_SLEEP_NS);
        // A process that comes back waits for nothing yet.
        let _again = WakeListener::open(&domain, Role::Plant).unwrap();
        plant.notify_waiting();
        let count = plant.0.count().load(Ordering::Relaxed);
        super::super::remove_domain(&domain);
        assert_eq!(count, 1);
    }
}
