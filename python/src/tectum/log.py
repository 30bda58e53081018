"""Reads a run's log into numpy arrays, with the scenario's names and units.

The log is MCAP with fixed-size messages whose schema stands in the log itself (docs/studies.md). So a log of another
version can be read, too. Its messages stand by themselves, or in chunks once it has been packed.
"""

import json
import os
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from .errors import Refused

MAGIC = b"\x89MCAP0\r\n"
SCHEMA, CHANNEL, MESSAGE, CHUNK, METADATA, DATA_END = 3, 4, 5, 6, 12, 15
TYPES = {"uint32": "<u4", "uint64": "<u8", "float32": "<f4"}
SAMPLES = ("observation", "command", "learning", "gap")
MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
CDR = 4  # bytes of a body's encapsulation header


@dataclass
class Log:
    """A run's log. `observation`, `command`, `learning` and `gap` are structured arrays, one row a sample; fields are
    those of docs/wire.md, those of the header among them."""

    path: Path
    observation: np.ndarray
    command: np.ndarray
    learning: np.ndarray
    gap: np.ndarray
    facts: dict[str, str] = field(repr=False)
    """The run's description: the metadata record `tectum.run`."""
    complete: bool
    """Whether the log was closed; one of a run that was killed may lack its end."""

    @property
    def inputs(self) -> list[str]:
        """Names of the inputs with their units."""
        return named(self.facts, "inputs")

    @property
    def outputs(self) -> list[str]:
        """Names of the outputs with their units."""
        return named(self.facts, "outputs")

    @property
    def measures(self) -> list[str]:
        """Names of the measures."""
        return [str(name) for name in json.loads(self.facts.get("measures", "[]"))]

    @property
    def period(self) -> float:
        """Seconds from tick to tick."""
        return int(self.facts.get("period_ns", 0)) / 1e9

    def columns(self, channel: str = "observation") -> dict[str, np.ndarray]:
        """A channel as named columns, as `tectum log csv` names them: `theta_1 (rad)`, `applied rate_1 (1)`, ..;
        `time (s)` is the tick's scheduled instant from the start of the run."""
        rows = self.rows(channel)
        if channel == "gap":
            return {name: rows[name] for name in ("channel", "first", "count", "total")}
        table = {"tick": rows["tick"], "time (s)": rows["tick"] * self.period}
        for name in ("sequence", "scheduled_ns", "sensed_ns", "published_ns"):
            table[re.sub("_ns$", " (ns)", name)] = rows[name]
        table |= {"incarnation": rows["incarnation"], "flags": rows["flags"]}
        lists = {"inputs": ("", self.inputs), "measures": ("", self.measures)}
        lists |= {name: (f"{name} ", self.outputs) for name in ("applied", "mean", "drawn", "noise")}
        lists["columns"] = "", [str(name) for name in json.loads(self.facts.get("columns", "[]"))]
        for name in (rows.dtype.names or ())[8:]:
            if name in lists:
                prefix, names = lists[name]
                table |= {prefix + column: rows[name][:, i] for i, column in enumerate(names)}
            else:
                table[name.replace("_", " ")] = rows[name]
        return table

    def rows(self, channel: str) -> np.ndarray:
        """The array of a channel."""
        if channel not in ("observation", "command", "learning", "gap"):
            raise Refused(f"a log has no channel {channel!r}; it has observation, command, learning and gap")
        rows: np.ndarray = getattr(self, channel)
        return rows

    def frame(self, channel: str = "observation") -> Any:
        """A channel as a pandas DataFrame with the columns of `columns`, and the tick as its index."""
        try:
            import pandas
        except ImportError:
            raise Refused("pandas is not installed; install it, or use log.columns() for numpy arrays") from None
        return pandas.DataFrame(self.columns(channel)).set_index("tick" if channel != "gap" else "channel")


def read_log(run: str | os.PathLike[str]) -> Log:
    """Reads a log: a run's folder, its name under `runs/`, or one file.

    Segments of one run (`log.mcap`, `log-1.mcap`, ..) are read as one log. A log of a run in progress, or of
    one that was killed, is read up to its last whole record.
    """
    path = Path(run)
    if not path.exists() and (Path("runs") / run).exists():
        path = Path("runs") / run
    files = segments(path) if path.is_dir() else [path]
    if not files or not files[0].is_file():
        raise Refused(f"there is no log in {path}; give a run's folder, its name under runs/, or a file")
    parts: list[dict[str, np.ndarray]] = []
    facts: dict[str, str] = {}
    complete = True
    for file in files:
        arrays, meta, whole = read_file(file)
        parts.append(arrays)
        facts, complete = facts or meta, whole
    joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return Log(path=path, facts=facts, complete=complete, **joined)


def segments(folder: Path) -> list[Path]:
    """The files of a run's log, in order."""
    later = sorted(folder.glob("log-*.mcap"), key=lambda path: int(re.sub(r"\D", "", path.stem) or 0))
    return [path for path in (folder / "log.mcap", *later) if path.is_file()]


def named(facts: dict[str, str], key: str) -> list[str]:
    signals = json.loads(facts.get(key, "[]"))
    return [f"{s['name']} ({s['unit']})" if s.get("unit") else str(s["name"]) for s in signals]


def read_file(path: Path) -> tuple[dict[str, np.ndarray], dict[str, str], bool]:
    """The channels of one file, its description, and whether it was closed."""
    data = memoryview(path.read_bytes())
    if bytes(data[: len(MAGIC)]) != MAGIC:
        raise Refused(f"{path} is no MCAP log")
    schemas: dict[int, tuple[str, np.dtype]] = {}
    channels: dict[int, str] = {}
    bodies: dict[int, list[memoryview]] = {}
    facts: dict[str, str] = {}
    complete = False
    for kind, content in records(data[len(MAGIC) :], path):
        if kind == MESSAGE:
            number = content[0] | content[1] << 8
            if number in channels:
                bodies[number].append(content[MESSAGE_HEAD.size + CDR :])
        elif kind == SCHEMA:
            number, name, text = schema(content)
            if name.lower().rpartition("/")[2] in SAMPLES:  # views and other programs' messages are no samples
                schemas[number] = name, sample_type(text)
        elif kind == CHANNEL:
            number, of = struct.unpack_from("<HH", content)
            if of in schemas:
                channels[number] = schemas[of][0]
                bodies.setdefault(number, [])
        elif kind == METADATA:
            name, pairs = metadata(content)
            facts = facts or (pairs if name == "tectum.run" else {})
        elif kind == DATA_END:
            complete = True
            break
    types = dict(schemas.values())
    arrays: dict[str, np.ndarray] = {}
    for short in SAMPLES:
        found = [number for number, name in channels.items() if name.lower().endswith(f"/{short}")]
        empty = np.dtype([("tick", "<u8")])
        row = next((of for name, of in types.items() if name.lower().endswith(f"/{short}")), empty)
        body = b"".join(bytes(part[: row.itemsize]) for number in found for part in bodies[number])
        arrays[short] = np.frombuffer(body, dtype=row)
    return arrays, facts, complete


def records(data: memoryview, path: Path) -> Iterator[tuple[int, memoryview]]:
    """Kind and content of every record, those in chunks included, up to the last whole one."""
    at = 0
    while at + 9 <= len(data):
        kind, length = data[at], int.from_bytes(data[at + 1 : at + 9], "little")
        at += 9
        if at + length > len(data) or kind == 0:
            return  # torn: what comes next was never written
        content = data[at : at + length]
        at += length
        if kind == CHUNK:
            yield from records(unpack(content, path), path)
        else:
            yield kind, content


def unpack(content: memoryview, path: Path) -> memoryview:
    """The records of a chunk."""
    size = int.from_bytes(content[16:24], "little")
    compression, at = text_at(content, 28)
    packed = content[at + 8 : at + 8 + int.from_bytes(content[at : at + 8], "little")]
    if compression == "":
        return packed
    if compression != "zstd":
        raise Refused(f"{path} is packed with {compression}, and only zstd can be read here")
    try:
        import zstandard
    except ImportError:
        raise Refused(f"{path} is packed, and zstandard is not installed: pip install zstandard") from None
    return memoryview(zstandard.ZstdDecompressor().decompress(bytes(packed), max_output_size=size))


def text_at(content: memoryview, at: int) -> tuple[str, int]:
    length = int.from_bytes(content[at : at + 4], "little")
    return bytes(content[at + 4 : at + 4 + length]).decode(), at + 4 + length


def schema(content: memoryview) -> tuple[int, str, str]:
    """Number, name and text of a schema record."""
    name, at = text_at(content, 2)
    _, at = text_at(content, at)
    text, _ = text_at(content, at)
    return content[0] | content[1] << 8, name, text


def metadata(content: memoryview) -> tuple[str, dict[str, str]]:
    """Name and pairs of a metadata record."""
    name, at = text_at(content, 0)
    end = at + 4 + int.from_bytes(content[at : at + 4], "little")
    at, pairs = at + 4, {}
    while at < end:
        key, at = text_at(content, at)
        pairs[key], at = text_at(content, at)
    return name, pairs


def sample_type(text: str) -> np.dtype:
    """The numpy type of a sample from its `ros2msg` text. The header's fields come first, without a prefix."""
    parts = re.split(r"^=+\s*$", text, flags=re.MULTILINE)
    nested = {}
    for part in parts[1:]:
        first, _, rest = part.strip().partition("\n")
        nested[first.removeprefix("MSG:").strip()] = rest

    def fields(text: str) -> list[tuple[Any, ...]]:
        found: list[tuple[Any, ...]] = []
        for line in text.splitlines():
            words = line.split("#")[0].split()
            if len(words) != 2:
                continue
            match = re.fullmatch(r"([\w/]+)(?:\[(\d+)\])?", words[0])
            if match is None:
                continue
            kind, count, name = match[1], match[2], words[1]
            if kind in TYPES:
                found.append((name, TYPES[kind], (int(count),)) if count else (name, TYPES[kind]))
            else:
                found += fields(nested[kind])
        return found

    return np.dtype(fields(parts[0]))
