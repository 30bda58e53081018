"""A controller at the other end of a pipe: how a run in one process and `tectum replay` start it (docs/wire.md).

Observations come on standard input; commands and learning records go to standard output, in turn.
"""

import ctypes
import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

from .controller_core import ControllerCore
from .errors import Refused
from .facts import RunFacts
from .layouts import SCHEMA, Observation

START, READY, OBSERVATION, COMMAND, LEARNING, REPORT, FAILED, TEST, TESTED = range(1, 10)
VERSION = 2


class Pipe:
    """Frames: a kind, a length, and as many bytes."""

    def __init__(self, source: BinaryIO, target: BinaryIO) -> None:
        self.source, self.target = source, target

    def read(self) -> tuple[int, bytes] | None:
        """The next frame; None at the end."""
        head = self.source.read(8)
        if len(head) < 8:
            return None
        return int.from_bytes(head[:4], "little"), self.source.read(int.from_bytes(head[4:], "little"))

    def write(self, kind: int, data: bytes) -> None:
        self.target.write(kind.to_bytes(4, "little") + len(data).to_bytes(4, "little") + data)
        self.target.flush()

    def write_json(self, kind: int, value: Any) -> None:
        self.write(kind, json.dumps(value).encode())


def serve(make: Callable[[RunFacts], Any], arguments: Any) -> int:
    """Serves the parent with the controller that `make(run)` gives. Returns the exit code."""
    # What the author prints must not get between the frames: it goes to standard error.
    target = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    pipe = Pipe(sys.stdin.buffer, target)
    try:
        answer_all(pipe, make, arguments)
    except Refused as cause:
        pipe.write_json(FAILED, {"code": cause.code, "message": str(cause)})
        return cause.code
    return 0


def answer_all(pipe: Pipe, make: Callable[[RunFacts], Any], arguments: Any) -> None:
    """Answers every observation, until standard input ends."""
    first = pipe.read()
    if first is None or first[0] != START:
        raise Refused("the first frame on standard input is not that of a parent")
    start = json.loads(first[1])
    if "run" not in start:
        raise Refused("the parent is of another version than this package; install that of its checkout", 3)
    run = RunFacts(start["run"], "in-process", None)
    run.arguments = arguments
    core = ControllerCore(run, make(run))
    core.frozen = bool(start.get("frozen", False))
    if "start" in start:
        core.start_from(Path(start["start"]))
    pipe.write_json(READY, {"version": VERSION, "schema": SCHEMA, "columns": core.columns})
    testing = False
    while (frame := pipe.read()) is not None:
        kind, data = frame
        if kind == (TESTED if testing else TEST):
            testing = not testing
            if testing:
                core.begin_test()
            else:
                core.end_test()
            continue
        if kind != OBSERVATION or len(data) != ctypes.sizeof(Observation):
            raise Refused(f"frame {kind} of {len(data)} bytes came where an observation was due")
        observation = Observation.from_buffer_copy(data)
        if testing:
            pipe.write(COMMAND, bytes(core.answer_test(observation)))
            continue
        core.respond(observation)
        pipe.write(COMMAND, bytes(core.command))
        core.after_command(observation)
        pipe.write(LEARNING, bytes(core.learning))
    pipe.write_json(REPORT, core.full_report(None))
