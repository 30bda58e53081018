//! A page of memory that two processes share, with a futex for each direction: the least that the operating system has for
//! waking another process. No run uses it; `tectum bench` measures against it.

use std::os::fd::{AsFd, OwnedFd};
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::time::Duration;

use memmap2::{MmapMut, MmapOptions};
use rustix::fs::{MemfdFlags, ftruncate, memfd_create};
use rustix::thread::futex::{self, Flags, Timespec};

/// 64-bit words that a lane carries: an observation's.
pub const WORDS: usize = 23;
/// Bytes of the page.
const SIZE: usize = 4096;

/// One direction.
#[repr(C, align(128))]
struct PageSlot {
    /// Grows with every message; who waits, waits for it to change.
    count: AtomicU32,
    words: [AtomicU64; WORDS],
}

/// The page, as one of the two processes has it mapped.
pub struct SharedPage {
    map: MmapMut,
    /// The lane to write, and the one to read.
    lanes: [usize; 2],
    /// Messages read.
    seen: u32,
}

impl SharedPage {
    /// Makes a page. Its descriptor is for the other process to [`open`](Self::open); memory without a name, so that nothing
    /// is left whoever dies.
    ///
    /// # Errors
    /// What the operating system says.
    pub fn create() -> std::io::Result<(Self, OwnedFd)> {
        let file = memfd_create("tectum-page", MemfdFlags::CLOEXEC)?;
        ftruncate(&file, SIZE as u64)?;
        Ok((Self { map: mapped(&file)?, lanes: [0, 1], seen: 0 }, file))
    }

    /// The other end of a page.
    ///
    /// # Errors
    /// When `file` is no page.
    pub fn open(file: impl AsFd) -> std::io::Result<Self> {
        if rustix::fs::fstat(&file)?.st_size != SIZE as i64 {
            return Err(std::io::Error::other("not a page"));
        }
        Ok(Self { map: mapped(file)?, lanes: [1, 0], seen: 0 })
    }

    fn lane(&self, which: usize) -> &PageSlot {
        const { assert!(2 * size_of::<PageSlot>() <= SIZE) };
        // SAFETY: The map is of SIZE bytes, page-aligned, readable and writable, and lives as long as `self`; both lanes lie in it,
        // aligned. A `PageSlot` is made of atomics alone, for which every bit pattern is valid, and both processes touch it only as
        // such, so that there is no data race. This does not guard against a third process that truncates the memory: only the
        // two have its descriptor.
        unsafe { &*self.map.as_ptr().cast::<PageSlot>().add(self.lanes[which]) }
    }

    /// Writes a message of up to [`WORDS`] words and wakes who waits for it. Its reader must have read the one before.
    #[inline]
    pub fn send(&self, message: &[u64]) {
        let lane = self.lane(0);
        for (to, &word) in lane.words.iter().zip(message) {
            to.store(word, Ordering::Relaxed);
        }
        lane.count.fetch_add(1, Ordering::Release);
        let _ = futex::wake(&lane.count, Flags::empty(), 1);
    }

    /// Sleeps until a message is there, for `timeout` at most, and reads it. False if there was none.
    #[inline]
    pub fn receive(&mut self, message: &mut [u64], timeout: Duration) -> bool {
        let lane = self.lane(1);
        let limit = Timespec { tv_sec: timeout.as_secs() as i64, tv_nsec: i64::from(timeout.subsec_nanos()) };
        if lane.count.load(Ordering::Acquire) == self.seen {
            // Why it ended shows in the count.
            let _ = futex::wait(&lane.count, Flags::empty(), self.seen, Some(&limit));
        }
        let count = lane.count.load(Ordering::Acquire);
        if count == self.seen {
            return false;
        }
        for (to, word) in message.iter_mut().zip(&lane.words) {
            *to = word.load(Ordering::Relaxed);
        }
        self.seen = count;
        true
    }
}

fn mapped(file: impl AsFd) -> std::io::Result<MmapMut> {
    use std::os::fd::AsRawFd as _;
    // SAFETY: The file is memory without a name, SIZE bytes long, whose descriptor only two of our own processes have; neither
    // truncates it, and both read and write it through atomics.
    unsafe { MmapOptions::new().len(SIZE).map_mut(file.as_fd().as_raw_fd()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_go_there_and_back() {
        let (mut asks, file) = SharedPage::create().unwrap();
        let mut answers = SharedPage::open(&file).unwrap();
        let mut got = [0; 3];
        assert!(!answers.receive(&mut got, Duration::from_millis(1)), "nothing was sent");
        for round in 0..5 {
            asks.send(&[round, 7, 8]);
            assert!(answers.receive(&mut got, Duration::from_secs(10)));
            assert_eq!(got, [round, 7, 8]);
            answers.send(&[round + 100]);
            assert!(asks.receive(&mut got[..1], Duration::from_secs(10)));
            assert_eq!(got[0], round + 100);
        }
        assert!(SharedPage::open(std::fs::File::open("/dev/null").unwrap()).is_err());
    }
}
