"""XXH3, 64 bits, as the Rust processes hash the names of streams and the content of checkpoints."""

import numpy as np

MASK = (1 << 64) - 1
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


def xxh3_64(data: bytes, seed: int = 0) -> int:
    """XXH3-64 of `data`. With a seed, of at most 128 bytes."""
    n = len(data)
    if n > 128:
        if seed:
            raise ValueError(f"the name of a stream has {n} bytes; give at most 128")
        return _middle(data) if n <= 240 else _long(data)
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


def _middle(data: bytes) -> int:
    """Of 129 to 240 bytes."""
    n = len(data)
    first = sum(_mix(data, 16 * i, 16 * i, 0) for i in range(8))
    rest = sum(_mix(data, 16 * i, 16 * (i - 8) + 3, 0) for i in range(8, n // 16))
    return _avalanche(_avalanche((n * PRIME64_1 + first) & MASK) + rest + _mix(data, n - 16, 136 - 17, 0) & MASK)


def _long(data: bytes) -> int:
    """Of more than 240 bytes: stripes of 64 bytes, 16 of them in a block."""
    n = len(data)
    lanes = np.array(
        [0xC2B2AE3D, PRIME64_1, PRIME64_2, PRIME64_3, 0x85EBCA77C2B2AE63, PRIME32_2, 0x27D4EB2F165667C5, PRIME32_1],
        dtype=np.uint64,
    )
    secret = np.frombuffer(SECRET, dtype=np.uint8)
    keys = np.lib.stride_tricks.sliding_window_view(secret, 64)[::8].copy().view("<u8")  # one row a stripe
    blocks = (n - 1) // 1024
    for block in range(blocks):
        lanes += _stripes(data[1024 * block : 1024 * (block + 1)], keys[:16])
        lanes = (lanes ^ (lanes >> np.uint64(47)) ^ keys[16]) * np.uint64(PRIME32_1)
    rest = data[1024 * blocks :]
    whole = (len(rest) - 1) // 64
    lanes += _stripes(rest[: 64 * whole], keys[:whole])
    last = secret[192 - 64 - 7 : 192 - 7].copy().view("<u8").reshape(1, 8)
    lanes += _stripes(data[n - 64 :], last)
    words = [int(lane) for lane in lanes]
    merged = n * PRIME64_1
    for i in range(4):
        merged += _fold(words[2 * i] ^ _word(SECRET, 11 + 16 * i), words[2 * i + 1] ^ _word(SECRET, 19 + 16 * i))
    return _avalanche(merged & MASK)


def _stripes(data: bytes, keys: np.ndarray) -> np.ndarray:
    """What some stripes add to the eight lanes."""
    words = np.frombuffer(data, dtype="<u8").reshape(-1, 8)
    mixed = words ^ keys
    product = (mixed & np.uint64(0xFFFFFFFF)) * (mixed >> np.uint64(32))
    # A lane also takes its neighbour's words.
    swapped = words.reshape(-1, 4, 2)[:, :, ::-1].reshape(-1, 8)
    total: np.ndarray = (product + swapped).sum(axis=0, dtype=np.uint64)
    return total
