//! The log ring: shared memory from which the logger takes what plant and controller have sent.
//!
//! Each of the three channels has a ring: a file of the run's domain with one writer (the process that sends on
//! the channel) and one reader (the logger). The writer appends each sample after it has sent it, while its
//! peer already works. The logger takes all new samples at each of its polls. So a channel of the loop
//! has one reader, its peer, and the logger costs the loop neither a second delivery nor a third send.
//!
//! The writer never waits: a reader that is a whole ring behind loses its oldest samples. It notices, because
//! the count of appended samples tells it which entries were overwritten, and the log states the gap in their
//! sequence numbers. A ring outlives both its processes: a logger that comes back finds the samples that were
//! sent while it was away, up to a whole ring.
//!
//! An entry is read as in a sequence lock (Boehm 2012, "Can seqlocks get along with programming language memory
//! models?"): the reader copies it, and then checks that the writer had not come round to it in the meantime.

use std::fs::{File, OpenOptions};
use std::marker::PhantomData;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering, fence};

use bytemuck::Zeroable;
use memmap2::{MmapOptions, MmapRaw};
use rustix::fs::{FallocateFlags, fallocate};

use super::own_files::open_own;
use super::{ChannelError, DomainName, LOG_BUFFER};
use crate::wire::Sample;

/// Changes whenever the layout does.
const LAYOUT: u64 = 0x7465_6374_7269_0001;
/// Entries of a ring: twice what the logger can be behind in lockstep.
pub(crate) const ENTRIES: u64 = 2 * LOG_BUFFER as u64;
/// Samples that the reader takes at a time.
const STRETCH: usize = 64;
/// Words of the file's first cache line: layout, bytes of a sample, entries.
const LINE: usize = 8;
/// Index of the word that counts the appended samples.
const COUNT: usize = LINE;
/// Index of the first entry's first word.
const FIRST: usize = 2 * LINE;

/// The file of the ring of the channel called `channel` in `LogRings`.
pub fn ring_file(domain: &DomainName, channel: &str) -> PathBuf {
    domain.root().join(format!("{channel}.log-ring"))
}

/// A mapped ring for samples of one type.
#[derive(Debug)]
struct Ring<T> {
    map: MmapRaw,
    sample: PhantomData<T>,
}

impl<T: Sample> Ring<T> {
    /// Words of a sample.
    const SAMPLE: usize = size_of::<T>() / 8;
    /// Words of an entry: whole cache lines, so that no two entries share one.
    const ENTRY: usize = Self::SAMPLE.next_multiple_of(LINE);
    /// Words of the file.
    const WORDS: usize = FIRST + ENTRIES as usize * Self::ENTRY;

    fn failed(channel: &str, cause: std::io::Error) -> ChannelError {
        ChannelError::set_up(format!("the log ring of channel {channel}"), cause)
    }

    fn header() -> [u64; 3] {
        const { assert!(size_of::<T>().is_multiple_of(8) && align_of::<T>() <= 8) };
        [LAYOUT, size_of::<T>() as u64, ENTRIES]
    }

    fn create(domain: &DomainName, channel: &str) -> Result<(), ChannelError> {
        let failed = |cause| Self::failed(channel, cause);
        let mut options = OpenOptions::new();
        let file = open_own(&ring_file(domain, channel), options.read(true).write(true).create_new(true));
        let file = file.map_err(failed)?;
        // Allocates all pages now: without room, a later write through the map would kill the process.
        fallocate(&file, FallocateFlags::empty(), 0, 8 * Self::WORDS as u64).map_err(|e| failed(e.into()))?;
        let ring = Self { map: Self::map(&file, true).map_err(failed)?, sample: PhantomData };
        for (word, value) in ring.words().iter().zip(Self::header()) {
            word.store(value, Ordering::Relaxed);
        }
        Ok(())
    }

    /// Opens the ring, to append to it or (`writes` is false) only to read.
    fn open(domain: &DomainName, channel: &str, writes: bool) -> Result<Self, ChannelError> {
        let failed = |cause| Self::failed(channel, cause);
        let mut options = OpenOptions::new();
        let file = open_own(&ring_file(domain, channel), options.read(true).write(writes)).map_err(failed)?;
        let other = || failed(std::io::Error::other("it has another layout"));
        if file.metadata().map_err(failed)?.len() != 8 * Self::WORDS as u64 {
            return Err(other());
        }
        let ring = Self { map: Self::map(&file, writes).map_err(failed)?, sample: PhantomData };
        let fits = ring.words().iter().zip(Self::header()).all(|(word, value)| word.load(Ordering::Relaxed) == value);
        if fits { Ok(ring) } else { Err(other()) }
    }

    /// Maps the file. A map is sound as long as no other process truncates the file under it. Its folder belongs to the
    /// run and is accessible to its user alone. The launcher gives the file its size before any process opens it, and
    /// removes it, without truncating it, at the end of the run. All processes access it as atomics.
    fn map(file: &File, writes: bool) -> std::io::Result<MmapRaw> {
        let mut options = MmapOptions::new();
        options.len(8 * Self::WORDS).populate();
        if writes { options.map_raw(file) } else { options.map_raw_read_only(file) }
    }

    /// The whole file as words.
    #[inline]
    fn words(&self) -> &[AtomicU64] {
        // SAFETY: The map has 8 * WORDS bytes, is page-aligned and readable, and lives as long as `self`; where words
        // are stored (`create`, `LogAppender`) it is writable, too. Every bit pattern is a valid `AtomicU64`, and all
        // processes access the words only as atomics, so there is no data race.
        unsafe { std::slice::from_raw_parts(self.map.as_ptr().cast(), Self::WORDS) }
    }

    /// The words of the entry of sample number `number`, counted from the first that was ever appended.
    #[inline]
    fn entry(&self, number: u64) -> &[AtomicU64] {
        let at = FIRST + (number % ENTRIES) as usize * Self::ENTRY;
        &self.words()[at..at + Self::SAMPLE]
    }
}

/// The writing end of a ring.
#[derive(Debug)]
pub struct LogAppender<T> {
    ring: Ring<T>,
    /// Samples appended so far.
    count: u64,
}

impl<T: Sample> LogAppender<T> {
    pub(super) fn open(domain: &DomainName, channel: &str) -> Result<Self, ChannelError> {
        let ring = Ring::open(domain, channel, true)?;
        let count = ring.words()[COUNT].load(Ordering::Relaxed);
        Ok(Self { ring, count })
    }

    /// Appends a copy of `sample`. Never waits: it overwrites the oldest entry. When the process is killed
    /// meanwhile, the entry does not count as appended.
    #[inline]
    pub fn append(&mut self, sample: &T) {
        // The count of the sample before must be visible before any word of this one, or a reader could take a
        // half overwritten entry for a whole one.
        fence(Ordering::Release);
        let words: &[u64] = bytemuck::cast_slice(std::slice::from_ref(sample));
        for (to, &word) in self.ring.entry(self.count).iter().zip(words) {
            to.store(word, Ordering::Relaxed);
        }
        self.count += 1;
        self.ring.words()[COUNT].store(self.count, Ordering::Release);
    }
}

/// The reading end of a ring. It takes samples in stretches, so that it seldom touches the memory that the writer
/// writes.
#[derive(Debug)]
pub struct LogTail<T> {
    ring: Ring<T>,
    /// Number of the next sample to take from the ring.
    next: u64,
    /// Most samples that are taken at a time.
    stretch: u64,
    /// The samples that were taken last, and how many of them were received.
    taken: Vec<T>,
    received: usize,
}

impl<T: Sample> LogTail<T> {
    /// Opens the ring at its oldest entry.
    pub(super) fn open(domain: &DomainName, channel: &str) -> Result<Self, ChannelError> {
        let ring = Ring::open(domain, channel, false)?;
        Ok(Self { ring, next: 0, stretch: STRETCH as u64, taken: Vec::with_capacity(STRETCH), received: 0 })
    }

    /// Opens the ring of the channel called `channel` (`observation`, `command` or `learning`) to watch it. Watching
    /// changes nothing in the ring, and any number of processes may do so beside the logger.
    ///
    /// # Errors
    /// [`ChannelError::SetUp`] when there is no such ring.
    pub fn watch(domain: &DomainName, channel: &str) -> Result<Self, ChannelError> {
        Self::open(domain, channel)
    }

    /// Passes over all samples but the newest `keep` that have not been received yet, and returns how many it passed
    /// over.
    pub fn skip_to_newest(&mut self, keep: u64) -> u64 {
        let appended = self.ring.words()[COUNT].load(Ordering::Acquire);
        let count = appended.saturating_sub(keep).saturating_sub(self.next_received());
        if count > 0 {
            self.pass_over(count);
        }
        count
    }

    /// The oldest sample that has not been received yet and is still in the ring.
    #[inline]
    pub fn receive(&mut self) -> Option<T> {
        let sample = self.front().copied();
        if sample.is_some() {
            self.pop_front();
        }
        sample
    }

    /// The sample that [`receive`](Self::receive) would return, in place.
    #[inline]
    pub fn front(&mut self) -> Option<&T> {
        if self.received == self.taken.len() {
            self.take();
        }
        self.taken.get(self.received)
    }

    /// Passes over the sample that [`front`](Self::front) has returned.
    #[inline]
    pub fn pop_front(&mut self) {
        self.received = self.taken.len().min(self.received + 1);
    }

    /// Skips samples for as long as `known` returns true.
    pub fn skip_while(&mut self, known: impl Fn(&T) -> bool) {
        while let Some(sample) = self.receive() {
            if !known(&sample) {
                self.received -= 1;
                return;
            }
        }
    }

    /// A copy of sample `number`, which is of no use if the writer has come round to it meanwhile.
    #[inline]
    fn copy(&self, number: u64) -> T {
        let mut sample: T = Zeroable::zeroed();
        let words: &mut [u64] = bytemuck::cast_slice_mut(std::slice::from_mut(&mut sample));
        for (to, word) in words.iter_mut().zip(self.ring.entry(number)) {
            *to = word.load(Ordering::Relaxed);
        }
        sample
    }

    /// Number of the next sample to receive.
    fn next_received(&self) -> u64 {
        self.next - (self.taken.len() - self.received) as u64
    }

    /// From now on takes samples one by one, for a reader that passes over most of them.
    pub fn take_singly(&mut self) {
        self.stretch = 1;
    }

    /// The number of samples that wait to be received, overwritten ones included.
    pub fn waiting(&self) -> u64 {
        self.ring.words()[COUNT].load(Ordering::Acquire) - self.next_received()
    }

    /// The sample after the next `count` ones, if it is in the ring.
    pub fn peek(&self, count: u64) -> Option<T> {
        let number = self.next_received() + count;
        let appended = &self.ring.words()[COUNT];
        if number >= appended.load(Ordering::Acquire) {
            return None;
        }
        let sample = self.copy(number);
        // As in `take`.
        fence(Ordering::Acquire);
        (appended.load(Ordering::Relaxed) - number < ENTRIES).then_some(sample)
    }

    /// Passes over the next `count` samples, which must be in the ring.
    pub fn pass_over(&mut self, count: u64) {
        self.next = self.next_received() + count;
        self.taken.clear();
        self.received = 0;
    }

    /// Takes the next samples from the ring, a stretch at most.
    fn take(&mut self) {
        let count = &self.ring.words()[COUNT];
        self.taken.clear();
        self.received = 0;
        loop {
            let appended = count.load(Ordering::Acquire);
            if appended - self.next >= ENTRIES {
                // A whole ring behind. Leaves some room, so that the writer does not overtake at once.
                self.next = appended - ENTRIES + ENTRIES / 8;
            }
            let end = appended.min(self.next + self.stretch);
            for number in self.next..end {
                self.taken.push(self.copy(number));
            }
            // If any word above was of a newer sample, the count before that sample is visible now. The writer may
            // be writing entry `appended`, over entry `appended - ENTRIES`.
            fence(Ordering::Acquire);
            if count.load(Ordering::Relaxed) - self.next < ENTRIES {
                self.next = end;
                return;
            }
            self.taken.clear();
        }
    }
}

/// Creates the three rings of a run. For the launcher, before any process of the run starts.
pub(super) fn create_rings(domain: &DomainName) -> Result<(), ChannelError> {
    use crate::wire::{Command, Learning, Observation};
    Ring::<Observation>::create(domain, "observation")?;
    Ring::<Command>::create(domain, "command")?;
    Ring::<Learning>::create(domain, "learning")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::Command;

    /// A domain's root with a ring, removed on drop.
    struct TestDomain(DomainName);

    impl TestDomain {
        fn new(id: u64) -> Self {
            let name = DomainName::of(id ^ u64::from(std::process::id()) << 32 ^ 0x1063);
            std::fs::create_dir_all(name.root()).unwrap();
            Ring::<Command>::create(&name, "command").unwrap();
            Self(name)
        }

        fn ends(&self) -> (LogAppender<Command>, LogTail<Command>) {
            (LogAppender::open(&self.0, "command").unwrap(), LogTail::open(&self.0, "command").unwrap())
        }
    }

    impl Drop for TestDomain {
        fn drop(&mut self) {
            super::super::remove_domain(&self.0);
        }
    }

    /// A sample whose every word tells its number.
    fn command(number: u64) -> Command {
        let mut command = Command::default();
        bytemuck::cast_slice_mut::<_, u64>(std::slice::from_mut(&mut command)).fill(number);
        command
    }

    fn number(command: &Command) -> u64 {
        let words: &[u64] = bytemuck::cast_slice(std::slice::from_ref(command));
        assert!(words.iter().all(|word| *word == words[0]), "a torn sample: {words:?}");
        words[0]
    }

    #[test]
    fn samples_arrive_in_order_and_outlive_both_ends() {
        let domain = TestDomain::new(1);
        let (mut appender, mut tail) = domain.ends();
        assert!(tail.receive().is_none());
        (0..100).for_each(|i| appender.append(&command(i)));
        assert!((0..100).all(|i| tail.receive() == Some(command(i))) && tail.receive().is_none());
        drop((appender, tail));
        let (mut appender, mut tail) = domain.ends();
        appender.append(&command(100));
        tail.skip_while(|sample| number(sample) < 98);
        assert_eq!([(); 4].map(|()| tail.receive().as_ref().map(number)), [Some(98), Some(99), Some(100), None]);
        tail.skip_while(|_| true);
        assert!(tail.receive().is_none());
        assert!(Ring::<Command>::create(&domain.0, "command").is_err(), "a second ring of this name");
        let other = LogTail::<crate::wire::Observation>::open(&domain.0, "command");
        assert!(other.unwrap_err().to_string().contains("another layout"));
    }

    #[test]
    fn a_reader_that_is_behind_loses_its_oldest_samples_only() {
        let domain = TestDomain::new(2);
        let (mut appender, mut tail) = domain.ends();
        (0..ENTRIES - 1).for_each(|i| appender.append(&command(i)));
        assert_eq!(tail.receive().as_ref().map(number), Some(0));
        (ENTRIES - 1..3 * ENTRIES).for_each(|i| appender.append(&command(i)));
        let received: Vec<u64> = std::iter::from_fn(|| tail.receive()).map(|sample| number(&sample)).collect();
        let first_kept = 2 * ENTRIES + ENTRIES / 8;
        let expected: Vec<u64> = (1..STRETCH as u64).chain(first_kept..3 * ENTRIES).collect();
        assert_eq!(received, expected);
    }

    #[test]
    fn samples_are_passed_over_unread() {
        let domain = TestDomain::new(5);
        let (mut appender, mut tail) = domain.ends();
        (0..50).for_each(|i| appender.append(&command(i)));
        tail.take_singly();
        assert_eq!(tail.waiting(), 50);
        assert_eq!([0, 49, 50].map(|count| tail.peek(count).as_ref().map(number)), [Some(0), Some(49), None]);
        assert_eq!(tail.receive().as_ref().map(number), Some(0));
        tail.pass_over(19);
        assert_eq!(tail.front().map(number), Some(20));
        tail.pop_front();
        // One that was taken and is not wanted yet is the next.
        tail.skip_while(|_| false);
        assert_eq!(tail.peek(0).as_ref().map(number), Some(21));
        tail.pass_over(3);
        assert_eq!(tail.waiting(), 26);
        assert_eq!(tail.receive().as_ref().map(number), Some(24));
        (50..24 + ENTRIES).for_each(|i| appender.append(&command(i)));
        assert_eq!(tail.peek(0).as_ref().map(number), Some(25));
        // The writer may be writing over entry 25.
        (24 + ENTRIES..26 + ENTRIES).for_each(|i| appender.append(&command(i)));
        assert!(tail.peek(0).is_none() && tail.peek(2).is_some());
    }

    #[test]
    fn a_watcher_takes_the_newest_and_changes_nothing() {
        let domain = TestDomain::new(4);
        let (mut appender, mut tail) = domain.ends();
        let mut watcher = LogTail::<Command>::watch(&domain.0, "command").unwrap();
        (0..100).for_each(|i| appender.append(&command(i)));
        assert_eq!(watcher.receive().as_ref().map(number), Some(0));
        assert_eq!((watcher.skip_to_newest(3), watcher.skip_to_newest(3)), (96, 0));
        let newest: Vec<u64> = std::iter::from_fn(|| watcher.receive()).map(|sample| number(&sample)).collect();
        assert_eq!((newest, watcher.skip_to_newest(0)), (vec![97, 98, 99], 0));
        assert_eq!(std::iter::from_fn(|| tail.receive()).count(), 100);
    }

    /// A writer that overtakes the reader all the time never makes it take a torn sample.
    #[test]
    fn no_sample_is_torn() {
        let domain = TestDomain::new(3);
        let (mut appender, mut tail) = domain.ends();
        let last = 200 * ENTRIES;
        std::thread::scope(|scope| {
            scope.spawn(move || (0..=last).for_each(|i| appender.append(&command(i))));
            let (mut before, mut received) = (None, 0);
            while before != Some(last) {
                let Some(sample) = tail.receive() else { continue };
                let now = Some(number(&sample));
                assert!(before < now, "{before:?} before {now:?}");
                (before, received) = (now, received + 1);
            }
            println!("{received} of {} samples received", last + 1);
        });
    }
}
