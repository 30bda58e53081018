"""Checkpoints of a process in Python: its whole state at a tick, in a file from which a later run continues.

The file is what a Rust process writes (`checkpoint` of tectum-runtime): safetensors, with the run's facts and a
checksum in the metadata. The state itself is one row of bytes, `python.state`, which `state.unpack` reads; it
belongs to the program that wrote it.
"""

import contextlib
import json
import os
import tempfile
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

from .errors import Refused, error_text
from .transport import JoinedRun
from .xxh3 import xxh3_64

FORMAT = 1
Tensors = dict[str, tuple[str, bytes]]
BYTES = {"U64": 8, "U32": 4}


def path(folder: Path, tick: int, role: str) -> Path:
    """The file of a checkpoint in a run's folder."""
    return folder / "checkpoints" / f"{tick}.{role}.safetensors"


def plain(value: Any) -> bytes:
    """JSON as the Rust processes write it."""
    return json.dumps(value, separators=(",", ":"), ensure_ascii=False).encode()


def checksum(facts: dict[str, Any], tensors: Tensors) -> str:
    parts = [plain(facts)]
    for name, (kind, data) in sorted(tensors.items()):
        parts += [f"{name} {kind} [{len(data) // BYTES[kind]}] {len(data)}\n".encode(), data]
    return f"{xxh3_64(b''.join(parts)):016x}"


def encode(facts: dict[str, Any], state: bytes) -> bytes:
    """The bytes of a checkpoint."""
    padded = state + bytes(-len(state) % 4)
    tensors: Tensors = {"python.length": ("U64", len(state).to_bytes(8, "little")), "python.state": ("U32", padded)}
    header: dict[str, Any] = {
        "__metadata__": {"tectum": plain(facts | {"check": checksum(facts, tensors)}).decode()}
    }
    at = 0
    for name, (kind, data) in tensors.items():
        header[name] = {"dtype": kind, "shape": [len(data) // BYTES[kind]], "data_offsets": [at, at + len(data)]}
        at += len(data)
    text = plain(header)
    text += b" " * (-len(text) % 8)
    return b"".join([len(text).to_bytes(8, "little"), text, *(data for _, data in tensors.values())])


def decode(file: Path) -> tuple[dict[str, Any], bytes]:
    """Facts and state of a checkpoint that a process in Python has written."""
    try:
        data = file.read_bytes()
    except OSError as cause:
        raise Refused(f"{file} cannot be read: {error_text(cause)}") from None
    try:
        size = int.from_bytes(data[:8], "little")
        header = json.loads(data[8 : 8 + size])
        facts: dict[str, Any] = json.loads(header["__metadata__"]["tectum"])
        if "python.state" not in header:
            raise Refused(f"{file} is not of a process in Python; continue with the program that wrote it")
        (first, last), (start, end) = (header[f"python.{name}"]["data_offsets"] for name in ("length", "state"))
        body = data[8 + size :]
        state = body[start:end][: int.from_bytes(body[first:last], "little")]
        facts.pop("check")
        whole = encode(facts, state) == data
    except (ValueError, KeyError, TypeError, AttributeError):
        whole = False
    if not whole:
        raise Refused(f"{file} is damaged; take it away to continue from the checkpoint before it")
    return facts, state


def ticks_of(folder: Path, role: str) -> list[int]:
    """The ticks of the checkpoints of `role` in a run's folder, in order."""
    names = (file.name.split(".") for file in (folder / "checkpoints").glob(f"*.{role}.safetensors"))
    return sorted(int(name[0]) for name in names if len(name) == 3 and name[0].isdecimal())


class Checkpoints:
    """The checkpoints of one process of a run: those that it writes, and the one from which the run goes on."""

    def __init__(self, run: JoinedRun, role: str) -> None:
        self.run, self.role = run, role
        self.every: int = run.manifest.get("checkpoint_every", 0)
        self.keep: int = run.manifest.get("keep_checkpoints", 0)
        """How many of its newest checkpoints this process keeps; 0: all."""
        self.writer = ThreadPoolExecutor(1)
        self.files: list[Future[None]] = []
        self.written = 0
        """Checkpoints that were written and are no longer in the list."""
        resumed: dict[str, Any] = run.manifest.get("resumed") or {}
        self.begin: int = resumed.get("tick", 0)
        """The tick with which the run begins."""
        self.source = Path(resumed["from"]) if resumed else None
        self.scenario: str | None = resumed.get("scenario")
        """Hash of the scenario of the part before, where this part has more ticks."""

    def resumed(self) -> tuple[int, bytes] | None:
        """The number of the next sample, and the state from which the run goes on; None if it begins anew."""
        if self.source is None:
            return None
        file = path(self.source, self.begin, self.role)
        facts, state = decode(file)
        ours = self.facts(self.begin, facts["sequence"])
        ours["scenario"] = self.scenario or ours["scenario"]
        for what in ("role", "scenario", "schema", "build"):
            if facts[what] != ours[what]:
                raise Refused(f"{file} is of another {what}: {facts[what]}, and the run's is {ours[what]}", 3)
        return facts["sequence"], state

    def facts(self, tick: int, sequence: int) -> dict[str, Any]:
        """What a checkpoint at `tick` says of itself."""
        wire = self.run.wire
        numbers = {"scenario": wire["scenario"], "schema": wire["schema"]}
        return {
            "format": FORMAT,
            "role": self.role,
            "run": f"{self.run.id:016x}",
            "tick": tick,
            "sequence": sequence,
            **{name: f"{int(text, 16):016x}" for name, text in numbers.items()},
            "build": wire["build"],
        }

    def write(self, tick: int, sequence: int, parts: list[bytes], sync: bool = True) -> None:
        """Writes the state at the beginning of `tick`, in a thread: no tick waits for the disk."""
        facts, file = self.facts(tick, sequence), path(self.run.folder, tick, self.role)
        self.files.append(self.writer.submit(self.put, file, lambda: encode(facts, b"".join(parts)), sync))
        # Of an endless run, only failures are remembered one by one.
        while len(self.files) > 1 and self.files[0].done() and self.files[0].exception() is None:
            del self.files[0]
            self.written += 1

    def put(self, file: Path, content: Callable[[], bytes], sync: bool) -> None:
        """Writes a checkpoint, and removes what is no longer kept. One that cannot be removed does no harm."""
        write_file(file, content, sync)
        if self.keep:
            for tick in ticks_of(self.run.folder, self.role)[: -self.keep]:
                with contextlib.suppress(OSError):
                    path(self.run.folder, tick, self.role).unlink()

    def finish(self) -> tuple[int, str | None]:
        """Waits until all are written. Their number, and what went wrong."""
        self.writer.shutdown()
        causes = [cause for file in self.files if (cause := file.exception())]
        failure = f"a checkpoint cannot be written: {error_text(causes[-1])}" if causes else None
        return self.written + len(self.files) - len(causes), failure


def write_file(file: Path, content: Callable[[], bytes], sync: bool) -> None:
    """Writes a file as a whole or not at all."""
    file.parent.mkdir(exist_ok=True)
    handle, draft = tempfile.mkstemp(".part", dir=file.parent)
    try:
        with os.fdopen(handle, "wb") as out:
            out.write(content())
            if sync:
                out.flush()
                os.fsync(out.fileno())
        os.rename(draft, file)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(draft)
        raise
