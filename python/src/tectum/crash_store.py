"""Memory that outlives a process: a state at some tick, and what came since then.

As `channel/crash_store.rs` of tectum-runtime, in files of its own in the run's part of shared memory. A record has a
checksum over its bytes and its number. That checksum alone tells a torn record from a whole one: a process that is
killed between any two stores leaves a record whose checksum does not fit, which counts as absent.

It covers the death of a process, not of the machine.
"""

import hashlib
import mmap
import os
import struct
from collections.abc import Sequence
from pathlib import Path

HEAD = struct.Struct("<8sQQ")  # checksum, number, length


def checksum(number: int, data: bytes | memoryview) -> bytes:
    digest = hashlib.blake2b(data, digest_size=8, key=number.to_bytes(8, "little"))
    return digest.digest()


class MappedFile:
    """A file of fixed size in shared memory."""

    def __init__(self, path: Path, size: int) -> None:
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
        try:
            if os.fstat(handle).st_size != size:
                os.ftruncate(handle, 0)
                # Allocates all pages now: without room, a later write through the map would kill the process.
                os.posix_fallocate(handle, 0, size)
            self.size = size
            self.map = mmap.mmap(handle, size)
        finally:
            os.close(handle)

    def write(self, at: int, number: int, parts: Sequence[bytes | memoryview]) -> None:
        """Writes a record at `at`, the checksum last."""
        data = b"".join(parts)
        self.map[at : at + 8] = b"\0" * 8
        self.map[at + HEAD.size : at + HEAD.size + len(data)] = data
        self.map[at : at + HEAD.size] = HEAD.pack(b"\0" * 8, number, len(data))
        self.map[at : at + 8] = checksum(number, data)

    def read(self, at: int, most: int) -> tuple[int, bytes] | None:
        """Number and bytes of the record at `at`, if it is whole."""
        found, number, length = HEAD.unpack_from(self.map, at)
        if length > most:
            return None
        data = self.map[at + HEAD.size : at + HEAD.size + length]
        return (number, data) if found == checksum(number, data) and found != b"\0" * 8 else None


class CrashStore:
    """Two slots for a whole state, written in turn, and rings of numbered entries."""

    def __init__(self, root: Path, name: str) -> None:
        self.paths = [root / f"{name}.state-{i}" for i in range(2)]
        self.slots: list[MappedFile | None] = [None, None]
        self.last: int | None = None
        for i, path in enumerate(self.paths):
            if path.exists() and (size := path.stat().st_size) >= HEAD.size:
                self.slots[i] = MappedFile(path, size)

    def _numbers(self) -> list[tuple[int, bytes] | None]:
        return [slot.read(0, slot.size - HEAD.size) if slot else None for slot in self.slots]

    def newest(self) -> tuple[int, bytes] | None:
        """The newest whole state, with its number."""
        return max((record for record in self._numbers() if record), key=lambda record: record[0], default=None)

    def store(self, number: int, parts: Sequence[bytes | memoryview]) -> None:
        """Stores a state under `number`, which grows from call to call. The state before it stays whole meanwhile."""
        turn = self._turn()
        size = sum(len(part) for part in parts)
        slot = self.slots[turn]
        if slot is None or slot.size < HEAD.size + size:
            self.slots[turn] = slot = None
            self.paths[turn].unlink(missing_ok=True)
            slot = self.slots[turn] = MappedFile(self.paths[turn], HEAD.size + size + size // 4 + 256)
        slot.write(0, number, parts)
        self.last = turn

    def _turn(self) -> int:
        """The slot to write next: the one without the newest state."""
        if self.last is None:
            numbers = [record[0] if record else -1 for record in self._numbers()]
            self.last = 0 if numbers[0] > numbers[1] else 1
        return 1 - self.last


class Ring:
    """A ring of numbered entries of one size."""

    def __init__(self, path: Path, entries: int, size: int) -> None:
        self.entries, self.size = entries, size
        self.stride = (HEAD.size + size + 63) // 64 * 64
        self.file = MappedFile(path, entries * self.stride)

    def append(self, number: int, parts: Sequence[bytes | memoryview]) -> None:
        """Appends entry `number`; it takes the place of `number - entries`."""
        self.file.write(number % self.entries * self.stride, number, parts)

    def entry(self, number: int) -> bytes | None:
        """Entry `number`, if it is still there and whole."""
        record = self.file.read(number % self.entries * self.stride, self.size)
        return record[1] if record and record[0] == number else None
