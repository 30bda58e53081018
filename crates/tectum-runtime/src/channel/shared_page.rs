//! A page of memory that two processes share, with a futex for each direction: the cheapest way of the
//! operating system to wake another process. No run uses it; `tectum bench` measures against it.

use std::os::fd::{AsFd, OwnedFd};
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::time::Duration;

use memmap2::{MmapMut, MmapOptions};
use rustix::fs::{MemfdFlags, ftruncate, memfd_create};
use rustix::thread::futex::{self, Flags, Timespec};

/// 64-bit words of a message: as many as an observation has.
const WORDS: usize = 23;
/// Bytes of the page.
const SIZE: usize = 4096;

/// The message of one direction.
#[repr(C, align(128))]
struct PageSlot {
    /// Grows with every message; the reader waits for it to change.
    count: AtomicU32,
    words: [AtomicU64; WORDS],
}

/// The page, as one of the two processes maps it.
pub struct SharedPage {
    map: MmapMut,
    /// Index of the slot to write.
    write_slot: usize,
    /// Index of the slot to read.
    read_slot: usize,
    /// Count of the last message read.
    read_count: u32,
}

impl SharedPage {
    /// Creates a page, and returns its descriptor for the other process to [`open`](Self::open). The memory has
    /// no name, so that nothing remains after the death of either process.
    ///
    /// # Errors
    /// The error of the operating system.
    pub fn create() -> std::io::Result<(Self, OwnedFd)> {
        let file = memfd_create("tectum-page", MemfdFlags::CLOEXEC)?;
        ftruncate(&file, SIZE as u64)?;
        Ok((Self { map: map_page(&file)?, write_slot: 0, read_slot: 1, read_count: 0 }, file))
    }

    /// Opens the other end of a page.
    ///
    /// # Errors
    /// When `file` is no page.
    pub fn open(file: impl AsFd) -> std::io::Result<Self> {
        if rustix::fs::fstat(&file)?.st_size != SIZE as i64 {
            return Err(std::io::Error::other("not a page"));
        }
        Ok(Self { map: map_page(file)?, write_slot: 1, read_slot: 0, read_count: 0 })
    }

    fn slot(&self, index: usize) -> &PageSlot {
        const { assert!(2 * size_of::<PageSlot>() <= SIZE) };
        // SAFETY: The map has SIZE bytes, is page-aligned, readable and writable, and lives as long as `self`.
        // Both slots (`index` is 0 or 1) lie in it, aligned. A `PageSlot` consists of atomics alone, for which
        // every bit pattern is valid, and both processes access it only as such, so there is no data race. This
        // does not guard against a third process that truncates the memory; only the two have its descriptor.
        unsafe { &*self.map.as_ptr().cast::<PageSlot>().add(index) }
    }

    /// Writes a message of up to `WORDS` words and wakes its reader, which must have read the one before.
    #[inline]
    pub fn send(&self, message: &[u64]) {
        let slot = self.slot(self.write_slot);
        for (to, &word) in slot.words.iter().zip(message) {
            to.store(word, Ordering::Relaxed);
        }
        slot.count.fetch_add(1, Ordering::Release);
        let _ = futex::wake(&slot.count, Flags::empty(), 1);
    }

    /// Sleeps until a message arrives, for `timeout` at most, and reads it. False if none arrived.
    #[inline]
    pub fn receive(&mut self, message: &mut [u64], timeout: Duration) -> bool {
        let slot = self.slot(self.read_slot);
        let limit = Timespec { tv_sec: timeout.as_secs() as i64, tv_nsec: i64::from(timeout.subsec_nanos()) };
        if slot.count.load(Ordering::Acquire) == self.read_count {
            // The count tells why the wait ended.
            let _ = futex::wait(&slot.count, Flags::empty(), self.read_count, Some(&limit));
        }
        let count = slot.count.load(Ordering::Acquire);
        if count == self.read_count {
            return false;
        }
        for (to, word) in message.iter_mut().zip(&slot.words) {
            *to = word.load(Ordering::Relaxed);
        }
        self.read_count = count;
        true
    }
}

fn map_page(file: impl AsFd) -> std::io::Result<MmapMut> {
    use std::os::fd::AsRawFd as _;
    // SAFETY: The file is anonymous memory of SIZE bytes. Only two processes of this program have its
    // descriptor; neither truncates it, and both read and write it through atomics.
    unsafe { MmapOptions::new().len(SIZE).map_mut(file.as_fd().as_raw_fd()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_arrive_in_both_directions() {
        let (mut asking, file) = SharedPage::create().unwrap();
        let mut answering = SharedPage::open(&file).unwrap();
        let mut message = [0; 3];
        assert!(!answering.receive(&mut message, Duration::from_millis(1)), "nothing was sent");
        for round in 0..5 {
            asking.send(&[round, 7, 8]);
            assert!(answering.receive(&mut message, Duration::from_secs(10)));
            assert_eq!(message, [round, 7, 8]);
            answering.send(&[round + 100]);
            assert!(asking.receive(&mut message[..1], Duration::from_secs(10)));
            assert_eq!(message[0], round + 100);
        }
        assert!(SharedPage::open(std::fs::File::open("/dev/null").unwrap()).is_err());
    }
}
