"""Prints size and fields (name, offset, bytes) of the samples that `tectum.py`, in the folder that is named, has."""

import ctypes
import json
import sys

sys.path.insert(0, sys.argv[1])
import tectum  # noqa: E402

found = {}
for kind in (tectum.Header, tectum.Observation, tectum.Command, tectum.Learning, tectum.Vision, tectum.Control, tectum.Status):
    fields = [[name, getattr(kind, name).offset, getattr(kind, name).size] for name, _ in kind._fields_]
    found[kind.type_name()] = [ctypes.sizeof(kind), fields]
print(json.dumps(found))
