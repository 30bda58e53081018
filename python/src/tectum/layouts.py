"""Samples and boards as they lie in shared memory, and the numbers that their fields carry.

`docs/wire.md` describes each field. A test compares these layouts with those of the Rust processes.
"""

import ctypes
from ctypes import Structure, c_float, c_uint32, c_uint64
from enum import IntEnum, IntFlag

MAX_INPUTS, MAX_OUTPUTS, MAX_MEASURES, MAX_COLUMNS, MAX_AHEAD = 32, 16, 6, 8, 8
# The logger's buffer, and the number of ticks after which a plant in lockstep looks at how far the logger is.
LOG_BUFFER, CREDIT = 1024, 256
# The version of iceoryx2 that all processes of a run must have.
ICEORYX2 = "0.10.0"
# The hash over all samples and boards: `wire.schema` in the manifest of a run that these layouts fit.
SCHEMA = "5ab8aba64327db7e"


class Flag(IntFlag):
    """Bits of a header's `flags`. Docs: docs/wire.md, "Flags"."""

    FIRST = 1 << 0
    MISSED = 1 << 1
    HELD = 1 << 2
    DECAYED = 1 << 3
    STOPPED = 1 << 4
    CLAMPED = 1 << 5
    NON_FINITE = 1 << 6
    SKIPPED = 1 << 7
    NEW_TARGET = 1 << 8
    LATE = 1 << 9
    INVALID = 1 << 10
    DIVERGED = 1 << 11
    STEP_LIMITED = 1 << 12
    POSITION_LIMITED = 1 << 13
    RAMPED = 1 << 14
    UNHEARD = 1 << 15
    LEARNED = 1 << 16
    TRACE_CUT = 1 << 17
    HASHED = 1 << 18
    UNARMED = 1 << 19
    TRIPPED = 1 << 20
    BLIND = 1 << 21
    TERMINATED = 1 << 22
    TRUNCATED = 1 << 23
    AHEAD = 1 << 24


class Phase(IntEnum):
    """Phases of a run, on the launcher's board."""

    SET_UP, CONNECT, RUN, STOP, ABORT = range(5)


class State(IntEnum):
    """States of a process, on its own board."""

    ABSENT, READY, CONNECTED, RUNNING, FINISHED, FAILED, CLOSING = range(7)


class Role(IntEnum):
    """The processes of a run: their places on the launcher's board."""

    PLANT, CONTROLLER, LOGGER = range(3)


class Header(Structure):
    """The start of every sample: its writer, its tick and its instants."""

    _fields_ = [
        ("run", c_uint64),
        ("tick", c_uint64),
        ("sequence", c_uint64),
        ("scheduled_ns", c_uint64),
        ("sensed_ns", c_uint64),
        ("published_ns", c_uint64),
        ("incarnation", c_uint32),
        ("flags", c_uint32),
    ]

    @staticmethod
    def type_name() -> str:
        return "tectum.Header.v1"


class Observation(Structure):
    """The plant's sample at tick k: the current inputs, and the result of tick k-1."""

    _fields_ = [
        ("header", Header),
        ("inputs", c_float * MAX_INPUTS),
        ("applied", c_float * MAX_OUTPUTS),
        ("reward", c_float),
        ("skipped", c_uint32),
        ("measures", c_float * MAX_MEASURES),
    ]

    @staticmethod
    def type_name() -> str:
        return "tectum.Observation.v2"


class Command(Structure):
    """The controller's answer to the observation of the same tick."""

    _fields_ = [("header", Header), ("mean", c_float * MAX_OUTPUTS), ("drawn", c_float * MAX_OUTPUTS)]

    @staticmethod
    def type_name() -> str:
        return "tectum.Command.v2"


class Ahead(Structure):
    """Commands for the ticks after that of a command, which go with it."""

    _fields_ = [("header", Header), ("ticks", c_uint64), ("commands", c_float * (MAX_AHEAD * MAX_OUTPUTS))]

    @staticmethod
    def type_name() -> str:
        return "tectum.Ahead.v1"


class Learning(Structure):
    """The learner's record of tick k."""

    _fields_ = [
        ("header", Header),
        ("noise", c_float * MAX_OUTPUTS),
        ("reward", c_float),
        ("step", c_float),
        ("weights_norm", c_float),
        ("trace_norm", c_float),
        ("columns", c_float * MAX_COLUMNS),
        ("weights_hash", c_uint64),
    ]

    @staticmethod
    def type_name() -> str:
        return "tectum.Learning.v2"


class Vision(Structure):
    """What a tracker saw in one picture: target and end-effector, m."""

    _fields_ = [("header", Header), ("target", c_float * 2), ("end", c_float * 2)]

    @staticmethod
    def type_name() -> str:
        return "tectum.Vision.v1"


class Control(Structure):
    """The launcher's board."""

    _fields_ = [
        ("phase", c_uint32),
        ("checkpoints", c_uint32),
        ("t0_ns", c_uint64),
        ("incarnations", c_uint32 * 3),
        ("gone", c_uint32),
    ]

    @staticmethod
    def type_name() -> str:
        return "tectum.Control.v3"


class Status(Structure):
    """The board of a process."""

    _fields_ = [
        ("state", c_uint32),
        ("pid", c_uint32),
        ("beat", c_uint64),
        ("checkpoint", c_uint64),
        ("ticks", c_uint64),
        ("sent", c_uint64),
        ("missed", c_uint64),
        ("late", c_uint64),
        ("lost", c_uint64),
        ("consumed", c_uint64),
        ("learner_ns", c_uint64),
        ("loss", c_float),
        ("end_error", c_float),
        ("schema", c_uint64),
        ("scenario", c_uint64),
        ("build", c_uint64),
    ]

    @staticmethod
    def type_name() -> str:
        return "tectum.Status.v3"


SAMPLES: tuple[type[Structure], ...] = (Header, Observation, Command, Ahead, Learning, Vision, Control, Status)


def layout(kind: type[Structure]) -> tuple[int, list[tuple[str, int, int]]]:
    """Size of a sample, and name, offset and bytes of each of its fields."""
    fields = [(name, getattr(kind, name).offset, getattr(kind, name).size) for name, *_ in kind._fields_]
    return ctypes.sizeof(kind), fields
