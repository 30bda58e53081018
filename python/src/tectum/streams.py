"""Random streams that depend on the run's seed and a name alone.

`stream` yields the numbers of a Rust plant's stream of that name. `generator` is a numpy generator, for programs that
need no numbers of a Rust process.
"""

from typing import Any

import numpy as np

MASK = (1 << 64) - 1


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


# --- XXH3, 64 bits, for the names of streams ------------------------------------------------------------------

# The first 192 bytes of XXH3's secret (https://github.com/Cyan4973/xxHash).
SECRET = bytes.fromhex(
    "b8fe6c3923a44bbe7c01812cf721ad1cded46de9839097db7240a4a4b7b3671fcb79e64eccc0e578825ad07dccff7221"
    "b8084674f743248ee03590e6813a264c3c2852bb91c300cb88d0658b1b532ea371644897a20df94e3819ef46a9deacd8"
    "a8fa763fe39c343ff9dcbbc7c70b4f1d8a51e04bcdb45931c89f7ec9d9787364eac5ac8334d3ebc3c581a0fffa1363eb"
    "170ddd51b7f0da49d316552629d4689e2b16be587d47a1fc8ff8b8d17ad031ce45cb3a8f95160428afd7fbcabb4b407e"
)
PRIME32_1, PRIME32_2 = 0x9E3779B1, 0x85EBCA77
PRIME64_1, PRIME64_2, PRIME64_3 = 0x9E3779B185EBCA87, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9
PRIME_MX1, PRIME_MX2 = 0x165667919E3779F9, 0x9FB21C651E98DF25


def _word(data: bytes, at: int, size: int = 8) -> int:
    return int.from_bytes(data[at : at + size], "little")


def _fold(a: int, b: int) -> int:
    product = a * b
    return (product & MASK) ^ (product >> 64)


def _avalanche(h: int) -> int:
    h = ((h ^ h >> 37) * PRIME_MX1) & MASK
    return h ^ h >> 32


def _mix(data: bytes, at: int, secret: int, seed: int) -> int:
    low = _word(data, at) ^ ((_word(SECRET, secret) + seed) & MASK)
    return _fold(low, _word(data, at + 8) ^ ((_word(SECRET, secret + 8) - seed) & MASK))


def xxh3_64(data: bytes, seed: int) -> int:
    """XXH3-64 of at most 128 bytes with a seed: how the Rust processes make a stream's seed from its name."""
    n = len(data)
    if n > 128:
        raise ValueError(f"the name of a stream has {n} bytes; give at most 128")
    if n > 16:
        total = n * PRIME64_1 & MASK
        for i in reversed(range((n - 1) // 32 + 1)):
            total += _mix(data, 16 * i, 32 * i, seed) + _mix(data, n - 16 * (i + 1), 32 * i + 16, seed)
        return _avalanche(total & MASK)
    if n > 8:
        low = _word(data, 0) ^ (((_word(SECRET, 24) ^ _word(SECRET, 32)) + seed) & MASK)
        high = _word(data, n - 8) ^ (((_word(SECRET, 40) ^ _word(SECRET, 48)) - seed) & MASK)
        swapped = int.from_bytes(low.to_bytes(8, "little"), "big")
        return _avalanche((n + swapped + high + _fold(low, high)) & MASK)
    if n >= 4:
        seed ^= int.from_bytes((seed & 0xFFFFFFFF).to_bytes(4, "little"), "big") << 32
        both = (_word(data, n - 4, 4) + (_word(data, 0, 4) << 32)) & MASK
        h = both ^ (((_word(SECRET, 8) ^ _word(SECRET, 16)) - seed) & MASK)
        h ^= ((h << 49 | h >> 15) ^ (h << 24 | h >> 40)) & MASK
        h = h * PRIME_MX2 & MASK
        h = ((h ^ (h >> 35) + n) * PRIME_MX2) & MASK
        return h ^ h >> 28
    if n:
        both = data[0] << 16 | data[n >> 1] << 24 | data[n - 1] | n << 8
        h = both ^ ((_word(SECRET, 0, 4) ^ _word(SECRET, 4, 4)) + seed & MASK)
    else:
        h = (seed ^ _word(SECRET, 56) ^ _word(SECRET, 64)) & MASK
    h = ((h ^ h >> 33) * PRIME64_2) & MASK
    h = ((h ^ h >> 29) * PRIME64_3) & MASK
    return h ^ h >> 32
