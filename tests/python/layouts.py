"""Prints size and fields (name, offset, bytes) of the samples in `tectum.py`, which is in the given folder."""

import ctypes
import json
import sys

sys.path.insert(0, sys.argv[1])
import tectum  # noqa: E402

SAMPLES = (
    tectum.Header,
    tectum.Observation,
    tectum.Command,
    tectum.Learning,
    tectum.Vision,
    tectum.Control,
    tectum.Status,
)

layouts = {}
for kind in SAMPLES:
    fields = [[name, getattr(kind, name).offset, getattr(kind, name).size] for name, _ in kind._fields_]
    layouts[kind.type_name()] = [ctypes.sizeof(kind), fields]
print(json.dumps(layouts))
