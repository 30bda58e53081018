"""Random streams that depend on the run's seed and a name alone.

`stream` yields the numbers of a Rust plant's stream of that name. `generator` is a numpy generator, for programs that
need no numbers of a Rust process.
"""

from typing import Any

import numpy as np

from .xxh3 import MASK, xxh3_64


class Stream:
    """Xoshiro256++, as in the Rust processes."""

    def __init__(self, seed: int) -> None:
        self.words: list[int] = []
        for _ in range(4):  # SplitMix64
            seed = (seed + 0x9E3779B97F4A7C15) & MASK
            z = ((seed ^ seed >> 30) * 0xBF58476D1CE4E5B9) & MASK
            z = ((z ^ z >> 27) * 0x94D049BB133111EB) & MASK
            self.words.append(z ^ z >> 31)

    def next(self) -> int:
        """The next 64 bits."""
        a, b, c, d = self.words
        total = (a + d) & MASK
        drawn = ((total << 23 | total >> 41) + a) & MASK
        c, d = c ^ a, d ^ b
        self.words = [a ^ d, b ^ c, c ^ (b << 17 & MASK), (d << 45 | d >> 19) & MASK]
        return drawn

    def single(self) -> float:
        """Uniform in [0, 1), a number of single precision."""
        return (self.next() >> 40) / (1 << 24)


def stream(seed: int, name: str) -> Stream:
    """The random stream `name` of a run with `seed`. It yields the same numbers as in a Rust plant."""
    return Stream(xxh3_64(name.encode(), seed))


def generator(seed: int, name: str) -> "np.random.Generator":
    """A numpy generator from the run's seed and a name. Its numbers are not those of `stream`."""
    return np.random.Generator(np.random.PCG64(xxh3_64(name.encode(), seed)))


def generator_state(source: "np.random.Generator") -> dict[str, int]:
    """The state of a generator of this module as four plain numbers."""
    state: Any = source.bit_generator.state
    inner = state["state"]
    return {"state": inner["state"], "inc": inner["inc"], "half": state["has_uint32"], "word": state["uinteger"]}


def restore_generator(source: "np.random.Generator", state: dict[str, int]) -> None:
    """Sets a generator to a state that `generator_state` gave."""
    source.bit_generator.state = {
        "bit_generator": "PCG64",
        "state": {"state": state["state"], "inc": state["inc"]},
        "has_uint32": state["half"],
        "uinteger": state["word"],
    }
