"""Prints the schema hash and the size and fields (name, offset, bytes) of the samples in the package `tectum`."""

import json

from tectum import layouts

samples = {kind.type_name(): layouts.layout(kind) for kind in layouts.SAMPLES}
flags = {flag.name: flag.value.bit_length() - 1 for flag in layouts.Flag}
numbers = [layouts.MAX_INPUTS, layouts.MAX_OUTPUTS, layouts.MAX_MEASURES, layouts.LOG_BUFFER]
print(json.dumps({"samples": samples, "flags": flags, "numbers": numbers, "schema": layouts.SCHEMA}))
