"""A state as bytes: nested dicts and lists of numbers, texts, bytes and numpy arrays.

Nothing in it can be executed when it is read, unlike with pickle.
"""

import json
import struct
from typing import Any

import numpy as np

from .errors import Refused
from .streams import generator_state

State = Any
LENGTH = struct.Struct("<Q")


def pack(state: State) -> list[bytes]:
    """A state as parts that `unpack` reads when they are joined."""
    blobs: list[bytes] = []

    def plain(value: Any, path: str) -> Any:
        if value is None or isinstance(value, (bool, int, float, str)):
            return value
        if isinstance(value, np.random.Generator):
            return plain(generator_state(value), path)
        if isinstance(value, (np.ndarray, np.generic)):
            array = np.asarray(value)
            if array.dtype.hasobject:
                raise Refused(f"{path} is an array of Python objects; a state holds arrays of numbers", 4)
            blobs.append(np.ascontiguousarray(array).tobytes())
            return {"\0array": [len(blobs) - 1, array.dtype.str, list(array.shape)]}
        if isinstance(value, (bytes, bytearray)):
            blobs.append(bytes(value))
            return {"\0bytes": len(blobs) - 1}
        if isinstance(value, dict):
            return {str(key): plain(inner, f"{path}[{key!r}]") for key, inner in value.items()}
        if isinstance(value, (list, tuple)):
            return [plain(inner, f"{path}[{i}]") for i, inner in enumerate(value)]
        kinds = "numbers, texts, bytes, numpy arrays, and lists and dicts of these"
        raise Refused(f"{path} is a {type(value).__name__}; a state holds {kinds}", 4)

    head = json.dumps([plain(state, "state()"), [len(blob) for blob in blobs]]).encode()
    return [LENGTH.pack(len(head)), head, *blobs]


def unpack(data: bytes) -> State:
    """The state of which `data` is the joined parts. Lists take the place of tuples."""
    (length,) = LENGTH.unpack_from(data)
    value, sizes = json.loads(data[LENGTH.size : LENGTH.size + length])
    blobs, at = [], LENGTH.size + length
    for size in sizes:
        blobs.append(data[at : at + size])
        at += size

    def rich(value: Any) -> Any:
        if isinstance(value, dict):
            if "\0array" in value:
                index, kind, shape = value["\0array"]
                return np.frombuffer(blobs[index], dtype=np.dtype(kind)).reshape(shape).copy()
            if "\0bytes" in value:
                return blobs[value["\0bytes"]]
            return {key: rich(inner) for key, inner in value.items()}
        return [rich(inner) for inner in value] if isinstance(value, list) else value

    return rich(value)
