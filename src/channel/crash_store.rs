//! What outlives a process: its state as of some tick, and a journal of what it was given since.
//!
//! A vault is a file in the run's corner of shared memory, mapped by one process at a time. It has two slots for a whole
//! state, which are written in turn, and a ring of entries. A process that dies by SIGKILL leaves it as it stood at that
//! instant: what it had stored is there, and at most one slot or one entry is half-written. Each carries a checksum over
//! its bytes, its number and the run's id, so that a torn one, or an older one in its place, is told from a whole one: it
//! counts as not there. The other slot still is, and the ring reaches back far enough for it.
//!
//! It is for the death of a process, not of the machine: memory is not written to any disk.

use std::fs::{File, OpenOptions};

use memmap2::MmapMut;
use rustix::fs::{FallocateFlags, fallocate};
use xxhash_rust::xxh3::xxh3_64_with_seed;

use super::{ChannelError, DomainName};
use crate::wire::Role;

/// Changes whenever the layout does.
const LAYOUT: u64 = 0x7665_6374_756d_0001;
/// The file's own description: layout, run, room, size of an entry, number of entries.
const HEADER: usize = 64;
/// Before each slot's and entry's bytes: checksum, number, length.
const MARK: usize = 24;

/// A process's vault.
#[derive(Debug)]
pub struct CrashStore {
    map: MmapMut,
    run: u64,
    /// Bytes that a state may have.
    room: usize,
    /// Bytes of an entry.
    entry: usize,
    entries: usize,
    /// The slot that is written next.
    turn: usize,
}

fn up(bytes: usize) -> usize {
    bytes.next_multiple_of(64)
}

impl CrashStore {
    /// Opens the vault of `role` in the run `run`, or makes it: for a state of up to `room` bytes, and the last `entries`
    /// entries of `entry` bytes each.
    ///
    /// # Errors
    /// [`ChannelError::SetUp`] when shared memory has no room for it. A vault that was made for something else is made
    /// anew.
    pub fn open(
        domain: &DomainName,
        role: Role,
        run: u64,
        room: usize,
        [entries, entry]: [usize; 2],
    ) -> Result<Self, ChannelError> {
        let path = domain.root().join(format!("{}.vault", role.name()));
        let size = HEADER + 2 * up(MARK + room) + entries * up(MARK + entry);
        let failed = |what: rustix::io::Errno| ChannelError::set_up(format!("the {}'s vault", role.name()), what);
        let io = |e: std::io::Error| failed(rustix::io::Errno::from_io_error(&e).unwrap_or(rustix::io::Errno::IO));
        let file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path).map_err(io)?;
        if file.metadata().map_err(io)?.len() != size as u64 {
            file.set_len(0).map_err(io)?;
            // All pages now: without room a write through the map would be the end of the process.
            fallocate(&file, FallocateFlags::empty(), 0, size as u64).map_err(failed)?;
        }
        let map = mapped(&file).map_err(io)?;
        let mut crash_store = Self { map, run, room, entry, entries, turn: 0 };
        let header = [LAYOUT, run, room as u64, entry as u64, entries as u64, 0, 0, 0];
        if crash_store.map[..HEADER] != *bytemuck::bytes_of(&header) {
            crash_store.map.fill(0);
            crash_store.map[..HEADER].copy_from_slice(bytemuck::bytes_of(&header));
        }
        Ok(crash_store)
    }

    fn slot(&self, slot: usize) -> usize {
        HEADER + slot * up(MARK + self.room)
    }

    fn place(&self, number: u64) -> usize {
        self.slot(2) + (number % self.entries as u64) as usize * up(MARK + self.entry)
    }

    fn word(&self, at: usize) -> u64 {
        bytemuck::pod_read_unaligned(&self.map[at..at + 8])
    }

    fn put(&mut self, at: usize, word: u64) {
        self.map[at..at + 8].copy_from_slice(&word.to_ne_bytes());
    }

    fn check(&self, at: usize, number: u64, len: usize) -> u64 {
        let seed = self.run ^ number.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ ((len as u64) << 32);
        // 0 is what an empty vault has.
        xxh3_64_with_seed(&self.map[at + MARK..][..len], seed) | 1
    }

    /// The number and bytes at `at`, if they are whole.
    fn whole(&self, at: usize, most: usize) -> Option<(u64, &[u8])> {
        let [check, number, len] = [0, 8, 16].map(|offset| self.word(at + offset));
        let len = usize::try_from(len).ok().filter(|&len| len <= most)?;
        (check == self.check(at, number, len)).then(|| (number, &self.map[at + MARK..][..len]))
    }

    fn seal(&mut self, at: usize, number: u64, len: usize) {
        self.put(at + 8, number);
        self.put(at + 16, len as u64);
        let check = self.check(at, number, len);
        self.put(at, check);
    }

    /// Keeps a state, under a number that grows: `write` copies it in and returns its size, or `None` if it has no room. False
    /// in that case; the state before it stays.
    pub fn store(&mut self, number: u64, write: impl FnOnce(&mut [u8]) -> Option<usize>) -> bool {
        let at = self.slot(self.turn);
        let room = self.room;
        self.put(at, 0);
        let Some(len) = write(&mut self.map[at + MARK..][..room]) else { return false };
        self.seal(at, number, len);
        self.turn = 1 - self.turn;
        true
    }

    /// The newest whole state, with its number.
    pub fn newest(&self) -> Option<(u64, &[u8])> {
        let slots = [0, 1].map(|slot| self.whole(self.slot(slot), self.room));
        slots.into_iter().flatten().max_by_key(|(number, _)| *number)
    }

    /// After a return: the slot that does not hold the newest state is the one to write next.
    pub fn reopen(&mut self) {
        let numbers = [0, 1].map(|slot| self.whole(self.slot(slot), self.room).map(|(number, _)| number));
        self.turn = usize::from(numbers[0] > numbers[1]);
    }

    /// Notes an entry; the one that is as many entries older gives way.
    #[inline]
    pub fn append(&mut self, number: u64, bytes: &[u8]) {
        debug_assert!(bytes.len() == self.entry);
        let at = self.place(number);
        self.map[at + MARK..][..bytes.len()].copy_from_slice(bytes);
        self.seal(at, number, bytes.len());
    }

    /// The entry `number`, if it is still there and whole.
    pub fn entry(&self, number: u64) -> Option<&[u8]> {
        self.whole(self.place(number), self.entry).filter(|(there, _)| *there == number).map(|(_, bytes)| bytes)
    }
}

fn mapped(file: &File) -> std::io::Result<MmapMut> {
    // SAFETY: A map is sound as long as nobody else changes or truncates the file under it. Its folder belongs to the run and is
    // readable by its user alone; a role's vault is opened by the process in that role, of which there is one at a time (the
    // launcher starts the next one after the last has died); it is given its size before it is mapped, and removed, not
    // truncated, when the run is over. This does not guard against the same user writing into it by hand: bytes are then
    // wrong, which the checksums tell, and never anything but bytes.
    unsafe { MmapMut::map_mut(file) }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Place(DomainName);

    impl Place {
        fn new(id: u64) -> Self {
            let name = DomainName::of(id ^ u64::from(std::process::id()) << 32 ^ 0x5eed);
            std::fs::create_dir_all(name.root()).unwrap();
            Self(name)
        }

        fn open(&self, run: u64) -> CrashStore {
            CrashStore::open(&self.0, Role::Controller, run, 100, [4, 16]).unwrap()
        }
    }

    impl Drop for Place {
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
        let place = Place::new(1);
        let mut crash_store = place.open(7);
        assert!(crash_store.newest().is_none());
        for (number, byte) in [(3, 1), (8, 2), (13, 3)] {
            assert!(crash_store.store(number, state(byte)));
        }
        drop(crash_store);
        let mut crash_store = place.open(7);
        assert_eq!(crash_store.newest(), Some((13, &[3; 50][..])));
        // A death in the middle of the next writing, and then the same once more.
        for _ in 0..2 {
            crash_store.reopen();
            let turn = crash_store.turn;
            assert!(!crash_store.store(18, |to| {
                to[..20].fill(9);
                None
            }));
            assert_eq!((crash_store.newest(), crash_store.turn), (Some((13, &[3; 50][..])), turn));
        }
        assert!(crash_store.store(18, state(4)));
        assert_eq!(crash_store.newest(), Some((18, &[4; 50][..])));
        drop(crash_store);
        assert!(place.open(8).newest().is_none(), "another run's");
    }

    #[test]
    fn entries_are_there_until_others_take_their_place() {
        let place = Place::new(2);
        let mut crash_store = place.open(7);
        for number in 0..6_u64 {
            crash_store.append(number, &[number as u8; 16]);
        }
        let there = |crash_store: &CrashStore| (0..8).filter(|&n| crash_store.entry(n).is_some()).collect::<Vec<_>>();
        assert_eq!(there(&crash_store), [2, 3, 4, 5]);
        assert_eq!(crash_store.entry(3), Some(&[3; 16][..]));
        let crash_store = {
            drop(crash_store);
            place.open(7)
        };
        assert_eq!(there(&crash_store), [2, 3, 4, 5]);
    }

    /// Any flipped bit of a slot or an entry makes it one that is not there.
    #[test]
    fn a_torn_one_is_told_from_a_whole_one() {
        let place = Place::new(3);
        let mut crash_store = place.open(7);
        assert!(crash_store.store(1, state(5)));
        crash_store.append(9, &[6; 16]);
        let places = [(crash_store.slot(0), MARK + 50), (crash_store.place(9), MARK + 16)];
        for (which, (at, len)) in places.into_iter().enumerate() {
            for bit in 0..8 * len {
                crash_store.map[at + bit / 8] ^= 1 << (bit % 8);
                let gone = if which == 0 { crash_store.newest().is_none() } else { crash_store.entry(9).is_none() };
                assert!(gone, "{which} {bit}");
                crash_store.map[at + bit / 8] ^= 1 << (bit % 8);
            }
        }
        assert!(crash_store.newest().is_some() && crash_store.entry(9).is_some());
    }
}
