"""Chunks of profile compact as a stranger may write them, without the encoder: most break one rule.

Their bytes come from FORMAT.md; the same in each run.
"""

from __future__ import annotations

import random
import struct
from collections.abc import Iterator

STEPS = (1e-3, 0.05, -0.25, 0.0, 1.0)
WILD_STEPS = (3e38, -3e38, 1e30, 1e19, 1e-45, float("nan"), float("inf"), -float("inf"))


def _floats(rng: random.Random, wild: bool) -> list[float]:
    """Origin, steps and bases; one of them wild."""
    floats = [rng.uniform(-9, 9) if rng.random() < 0.5 else rng.choice(STEPS) for _ in range(9)]
    if wild:
        floats[rng.randrange(9)] = rng.choice(WILD_STEPS)
    return floats


def hostile_chunk(rng: random.Random) -> bytes:
    """One chunk of up to 9 Gaussians, of any SH degree, a few of them escaped."""
    degree, inside, escapes = rng.randrange(4), rng.randrange(8), rng.randrange(3)
    coefficients = (degree + 1) ** 2
    breaks = rng.choice(
        ("", "floats", "levels", "half", "opacity", "gap", "bits", "filling", "size", "byte")
    )
    floats = _floats(rng, breaks == "floats")
    levels, half = rng.choice((2, 3, 160, 256)), rng.choice((1, 42, 127))
    planes = bytearray(rng.randbytes((8 + 3 * coefficients) * inside))
    gaps = [rng.choice((0, 1, 2, 9, 40, 56)) for _ in range(inside)]
    if breaks == "gap" and inside:
        gaps[rng.randrange(inside)] = rng.choice((59, 60, 61, 64, 255))
        if rng.random() < 0.3:
            gaps = [60] * inside  # whose sum is too large
    planes[:inside] = bytes(gaps)
    opacities = [rng.randrange(levels) for _ in range(inside)]
    if breaks == "opacity" and inside:
        opacities[rng.randrange(inside)] = rng.choice((levels - 1, min(levels, 255), 255))
    planes[7 * inside : 8 * inside] = bytes(opacities)
    num_bits = sum(max(gap - 1, 0) for gap in gaps)
    low_bits = rng.getrandbits(num_bits) if num_bits else 0
    size = (num_bits + 7) // 8
    if breaks == "filling":
        low_bits |= 1 << max(8 * size - 1, 0)
        size = max(size, 1)
    string = low_bits.to_bytes(size, "little")
    if breaks == "bits":
        string = string[:-1] if rng.random() < 0.5 else string + b"\0"
    if breaks == "levels":
        levels = rng.choice((0, 1, 257, 65535))
    if breaks == "half":
        half = rng.choice((0, 128, 65535))
    escaped = [rng.gauss(0, 1) for _ in range(escapes * (11 + 3 * coefficients))]
    sizes = [escapes, len(string), inside + escapes]
    if breaks == "size":
        at = rng.randrange(3)
        sizes[at] = rng.choice((sizes[at] + 1, max(sizes[at] - 1, 0), 1 << 20, sizes[at] << 8))
    body = struct.pack("<9fHHII", *floats, levels, half, *sizes[:2]) + planes + string
    body += struct.pack(f"<{len(escaped)}f", *escaped)
    head = (b"SWGC", 1, 0, 2, 0, 0, sizes[2], 0, degree, 0, len(body))
    chunk = bytearray(struct.pack("<4sBBBBiIBBHI", *head) + body)
    if breaks == "byte":
        chunk[rng.randrange(24, len(chunk))] = rng.randrange(256)
    return bytes(chunk)


def hostile_chunks(count: int) -> Iterator[bytes]:
    rng = random.Random(1)
    return (hostile_chunk(rng) for _ in range(count))
