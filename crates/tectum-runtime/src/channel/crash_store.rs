//! The crash store: memory that outlives a process. It holds the process's state at some tick, and a journal of
//! its inputs since then.
//!
//! A crash store is a file in the run's domain, mapped by one process at a time. It has two slots for a whole
//! state, which are written in turn, and a ring of journal entries. When a process is killed with SIGKILL, at
//! most one slot or one entry is half-written. Each carries a checksum over its bytes, its number and the run's
//! id. So a torn record, or an older one in its place, is detected and treated as absent. The other slot is
//! still valid, and the ring reaches back far enough for it.
//!
//! It covers the death of a process, not of the machine: the memory is not written to any disk.

use std::fs::{File, OpenOptions};

use memmap2::MmapMut;
use rustix::fs::{FallocateFlags, fallocate};
use xxhash_rust::xxh3::xxh3_64_with_seed;

use super::own_files::open_own;
use super::{ChannelError, DomainName};
use crate::wire::Role;

/// Changes whenever the layout does.
const LAYOUT: u64 = 0x7665_6374_756d_0001;
/// Bytes of the file's header: layout, run, capacity of a slot, size of an entry, number of entries.
const HEADER: usize = 64;
/// Bytes of the record header before the bytes of each slot and entry: checksum, number, length.
const RECORD_HEADER: usize = 24;

/// The crash store of one process.
#[derive(Debug)]
pub struct CrashStore {
    map: MmapMut,
    run: u64,
    /// Bytes that a state may have.
    capacity: usize,
    /// Bytes of an entry.
    entry_size: usize,
    /// Number of entries in the ring.
    entries: usize,
    /// The slot that is written next.
    next_slot: usize,
}

/// Rounds up to a whole number of cache lines.
fn padded(bytes: usize) -> usize {
    bytes.next_multiple_of(64)
}

impl CrashStore {
    /// Opens the crash store of `role` in the run `run`, or creates it, for a state of up to `capacity` bytes
    /// and the last `entries` entries of `entry_size` bytes each. A store with another layout or of another run
    /// is cleared.
    ///
    /// # Errors
    /// [`ChannelError::SetUp`] when shared memory has no room for it.
    pub(crate) fn open(
        domain: &DomainName,
        role: Role,
        run: u64,
        capacity: usize,
        [entries, entry_size]: [usize; 2],
    ) -> Result<Self, ChannelError> {
        let path = domain.root().join(format!("{}.crash-store", role.name()));
        let size = HEADER + 2 * padded(RECORD_HEADER + capacity) + entries * padded(RECORD_HEADER + entry_size);
        let failed =
            |cause: rustix::io::Errno| ChannelError::set_up(format!("the {}'s crash store", role.name()), cause);
        let io = |e: std::io::Error| failed(rustix::io::Errno::from_io_error(&e).unwrap_or(rustix::io::Errno::IO));
        let mut options = OpenOptions::new();
        let file = open_own(&path, options.read(true).write(true).create(true).truncate(false)).map_err(io)?;
        if file.metadata().map_err(io)?.len() != size as u64 {
            file.set_len(0).map_err(io)?;
            // Allocates all pages now: without room, a later write through the map would kill the process.
            fallocate(&file, FallocateFlags::empty(), 0, size as u64).map_err(failed)?;
        }
        let map = map_file(&file).map_err(io)?;
        let mut crash_store = Self { map, run, capacity, entry_size, entries, next_slot: 0 };
        let header = [LAYOUT, run, capacity as u64, entry_size as u64, entries as u64, 0, 0, 0];
        if crash_store.map[..HEADER] != *bytemuck::bytes_of(&header) {
            crash_store.map.fill(0);
            crash_store.map[..HEADER].copy_from_slice(bytemuck::bytes_of(&header));
        }
        Ok(crash_store)
    }

    /// Offset of a slot's record; that of the ring is `slot_offset(2)`.
    fn slot_offset(&self, slot: usize) -> usize {
        HEADER + slot * padded(RECORD_HEADER + self.capacity)
    }

    /// Offset of the record of entry `number` in the ring.
    fn entry_offset(&self, number: u64) -> usize {
        self.slot_offset(2) + (number % self.entries as u64) as usize * padded(RECORD_HEADER + self.entry_size)
    }

    fn read_word(&self, at: usize) -> u64 {
        bytemuck::pod_read_unaligned(&self.map[at..at + 8])
    }

    fn write_word(&mut self, at: usize, word: u64) {
        self.map[at..at + 8].copy_from_slice(&word.to_ne_bytes());
    }

    fn checksum(&self, at: usize, number: u64, len: usize) -> u64 {
        let seed = self.run ^ number.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ ((len as u64) << 32);
        // Never 0, which is the checksum word of an empty record.
        xxh3_64_with_seed(&self.map[at + RECORD_HEADER..][..len], seed) | 1
    }

    /// The number and bytes of the record at `at`, if it is whole and has at most `max_len` bytes.
    fn whole_record(&self, at: usize, max_len: usize) -> Option<(u64, &[u8])> {
        let [checksum, number, len] = [0, 8, 16].map(|offset| self.read_word(at + offset));
        let len = usize::try_from(len).ok().filter(|&len| len <= max_len)?;
        (checksum == self.checksum(at, number, len)).then(|| (number, &self.map[at + RECORD_HEADER..][..len]))
    }

    /// Writes the record header at `at`; the checksum last.
    fn seal(&mut self, at: usize, number: u64, len: usize) {
        self.write_word(at + 8, number);
        self.write_word(at + 16, len as u64);
        let checksum = self.checksum(at, number, len);
        self.write_word(at, checksum);
    }

    /// Stores a state under `number`, which must grow from call to call. `write` copies the state into the slot
    /// and returns its size, or `None` if it does not fit. Returns false in that case; the previous state
    /// stays.
    pub(crate) fn store(&mut self, number: u64, write: impl FnOnce(&mut [u8]) -> Option<usize>) -> bool {
        let at = self.slot_offset(self.next_slot);
        let capacity = self.capacity;
        self.write_word(at, 0);
        let Some(len) = write(&mut self.map[at + RECORD_HEADER..][..capacity]) else { return false };
        self.seal(at, number, len);
        self.next_slot = 1 - self.next_slot;
        true
    }

    /// The newest whole state, with its number.
    pub(crate) fn newest(&self) -> Option<(u64, &[u8])> {
        let slots = [0, 1].map(|slot| self.whole_record(self.slot_offset(slot), self.capacity));
        slots.into_iter().flatten().max_by_key(|(number, _)| *number)
    }

    /// Selects the slot to write next after a restart: the one that does not hold the newest state.
    pub(crate) fn reopen(&mut self) {
        let numbers =
            [0, 1].map(|slot| self.whole_record(self.slot_offset(slot), self.capacity).map(|(number, _)| number));
        self.next_slot = usize::from(numbers[0] > numbers[1]);
    }

    /// Appends an entry to the journal; it overwrites the one with the number `number - entries`.
    #[inline]
    pub(crate) fn append(&mut self, number: u64, bytes: &[u8]) {
        debug_assert!(bytes.len() == self.entry_size);
        let at = self.entry_offset(number);
        self.map[at + RECORD_HEADER..][..bytes.len()].copy_from_slice(bytes);
        self.seal(at, number, bytes.len());
    }

    /// The journal entry `number`, if it is still stored and whole.
    pub(crate) fn entry(&self, number: u64) -> Option<&[u8]> {
        let record = self.whole_record(self.entry_offset(number), self.entry_size);
        record.filter(|(stored, _)| *stored == number).map(|(_, bytes)| bytes)
    }
}

fn map_file(file: &File) -> std::io::Result<MmapMut> {
    // SAFETY: A map is sound as long as no other process changes or truncates the file under it. Its folder
    // belongs to the run and is readable by its user alone. A role's crash store is opened by the process in
    // that role only, of which there is one at a time: the launcher starts the next after the last has died.
    // The file gets its size before it is mapped, and is removed, not truncated, at the end of the run. This
    // does not guard against the same user writing into the file by hand; the bytes are then wrong, which the
    // checksums detect, but they are never anything but bytes.
    unsafe { MmapMut::map_mut(file) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The root of a domain, removed on drop.
    struct TestDomain(DomainName);

    impl TestDomain {
        fn new(id: u64) -> Self {
            let name = DomainName::of(id ^ u64::from(std::process::id()) << 32 ^ 0x5eed);
            std::fs::create_dir_all(name.root()).unwrap();
            Self(name)
        }

        fn open(&self, run: u64) -> CrashStore {
            CrashStore::open(&self.0, Role::Controller, run, 100, [4, 16]).unwrap()
        }
    }

    impl Drop for TestDomain {
        fn drop(&mut self) {
            super::super::remove_domain(&self.0);
        }
    }

    fn state(byte: u8) -> impl FnOnce(&mut [u8]) -> Option<usize> {
        move |to| {
            to[..50].fill(byte);
            Some(50)
        }
    }

    #[test]
    fn the_newest_whole_state_is_found_again() {
        let domain = TestDomain::new(1);
        let mut crash_store = domain.open(7);
        assert!(crash_store.newest().is_none());
        for (number, byte) in [(3, 1), (8, 2), (13, 3)] {
            assert!(crash_store.store(number, state(byte)));
        }
        drop(crash_store);
        let mut crash_store = domain.open(7);
        assert_eq!(crash_store.newest(), Some((13, &[3; 50][..])));
        // The process dies in the middle of the next write, twice.
        for _ in 0..2 {
            crash_store.reopen();
            let next_slot = crash_store.next_slot;
            assert!(!crash_store.store(18, |to| {
                to[..20].fill(9);
                None
            }));
            assert_eq!((crash_store.newest(), crash_store.next_slot), (Some((13, &[3; 50][..])), next_slot));
        }
        assert!(crash_store.store(18, state(4)));
        assert_eq!(crash_store.newest(), Some((18, &[4; 50][..])));
        drop(crash_store);
        assert!(domain.open(8).newest().is_none(), "a store of another run");
    }

    #[test]
    fn entries_are_stored_until_newer_ones_overwrite_them() {
        let domain = TestDomain::new(2);
        let mut crash_store = domain.open(7);
        for number in 0..6_u64 {
            crash_store.append(number, &[number as u8; 16]);
        }
        let stored = |crash_store: &CrashStore| (0..8).filter(|&n| crash_store.entry(n).is_some()).collect::<Vec<_>>();
        assert_eq!(stored(&crash_store), [2, 3, 4, 5]);
        assert_eq!(crash_store.entry(3), Some(&[3; 16][..]));
        let crash_store = {
            drop(crash_store);
            domain.open(7)
        };
        assert_eq!(stored(&crash_store), [2, 3, 4, 5]);
    }

    /// A slot or entry with any flipped bit is treated as absent.
    #[test]
    fn a_flipped_bit_makes_a_record_absent() {
        let domain = TestDomain::new(3);
        let mut crash_store = domain.open(7);
        assert!(crash_store.store(1, state(5)));
        crash_store.append(9, &[6; 16]);
        let records =
            [(crash_store.slot_offset(0), RECORD_HEADER + 50), (crash_store.entry_offset(9), RECORD_HEADER + 16)];
        for (which, (at, len)) in records.into_iter().enumerate() {
            for bit in 0..8 * len {
                crash_store.map[at + bit / 8] ^= 1 << (bit % 8);
                let absent = if which == 0 { crash_store.newest().is_none() } else { crash_store.entry(9).is_none() };
                assert!(absent, "{which} {bit}");
                crash_store.map[at + bit / 8] ^= 1 << (bit % 8);
            }
        }
        assert!(crash_store.newest().is_some() && crash_store.entry(9).is_some());
    }
}
