"""Reads a controller's checkpoint with Python's safetensors and hashes its policy like the log does.

    read_checkpoint.py CHECKPOINT    prints one JSON object
"""

import json
import sys

import xxhash
from safetensors import safe_open


def main(path):
    with safe_open(path, framework="numpy") as file:
        facts = json.loads(file.metadata()["tectum"])
        weights = file.get_tensor("weights")
        names = sorted(file.keys())
    print(json.dumps({
        "facts": facts,
        "shape": list(weights.shape),
        "weights_hash": f"{xxhash.xxh3_64_intdigest(weights.astype('<f4').tobytes()):016x}",
        "tensors": names,
    }))


if __name__ == "__main__":
    main(sys.argv[1])
