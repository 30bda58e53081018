"""What a run shares beside iceoryx2's channels: the word that wakes the controller, and the rings for the logger.

docs/wire.md describes both. They are files of the run's domain, which each process maps.
"""

import ctypes
import mmap
import platform
import struct
from typing import Any

from .errors import Refused

FUTEX_WAIT, FUTEX_WAKE, EVERYBODY = 0, 1, 2**31 - 1
# The number of the system call `futex` on the machines that Linux and iceoryx2 run on.
FUTEX = {"x86_64": 202, "aarch64": 98, "riscv64": 98}


class Timespec(ctypes.Structure):
    """`struct timespec`."""

    _fields_ = [("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long)]


class WakeWord:
    """The futex that wakes the controller: the first word of a file. Only the plant changes it."""

    def __init__(self, path: str) -> None:
        if platform.machine() not in FUTEX:
            raise Refused(f"this package does not know the system call `futex` of {platform.machine()}", 1)
        with open(path, "r+b") as file:
            self.map = mmap.mmap(file.fileno(), 64)
        self.word = ctypes.c_uint32.from_buffer(self.map)
        self.address = ctypes.c_void_p(ctypes.addressof(self.word))
        self.futex, self.number = ctypes.CDLL(None).syscall, ctypes.c_long(FUTEX[platform.machine()])
        self.seen = self.word.value

    def notify(self) -> None:
        """Wakes the controller."""
        self.word.value = (self.word.value + 1) % 2**32
        self.futex(self.number, self.address, FUTEX_WAKE, EVERYBODY, None, None, 0)

    def wait(self, timeout_ms: int) -> None:
        """Sleeps until the plant notifies, or for `timeout_ms`. A notification since the last call counts."""
        if self.word.value == self.seen:
            limit = Timespec(timeout_ms // 1000, timeout_ms % 1000 * 1_000_000)
            self.futex(self.number, self.address, FUTEX_WAIT, ctypes.c_uint32(self.seen), ctypes.byref(limit), None, 0)
        self.seen = self.word.value


class LogRing:
    """The ring from which the logger takes what was sent on a channel."""

    def __init__(self, path: str, kind: type[ctypes.Structure]) -> None:
        with open(path, "r+b") as file:
            self.map = mmap.mmap(file.fileno(), 0)
        _, size, self.entries = struct.unpack_from("3Q", self.map)
        if size != ctypes.sizeof(kind):
            raise Refused(f"{path} has another layout than this package", 3)
        self.size, self.entry = size, (size + 63) // 64 * 64
        self.appended = ctypes.c_uint64.from_buffer(self.map, 64)

    def append(self, sample: Any) -> None:
        """Notes a sample that has been sent. The count changes last, so that the logger sees whole samples only."""
        at = 128 + self.appended.value % self.entries * self.entry
        self.map[at : at + self.size] = bytes(sample)
        self.appended.value += 1


__all__ = ["LogRing", "WakeWord"]
