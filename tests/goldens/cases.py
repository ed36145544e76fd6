"""The golden chunks and objects: one table of cases, for the test and for the script that writes
them anew.

Values are chosen away from rounding boundaries, so that every platform quantises them alike.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from codec.coders.coder import Coder, EncodedChunk
from codec.profiles.profile import Profile
from codec.profiles.quantise import Steps
from codec.slice import Slice
from codec.splats import Splats, sh_count
from codec.stream.chunk import Chunk, decode_chunk, encode_chunk
from codec.stream.object import encode_object

FILE = Path(__file__).parent / "chunks.json"
OBJECTS_FILE = Path(__file__).parent / "objects.json"

STEPS = Steps(
    position_m=1 / 1024, log_scale=0.125, rotation=1 / 100, opacity=1 / 200, colour=1 / 32
)


@dataclass(frozen=True, slots=True)
class Case:
    """One chunk to pin."""

    name: str
    profile: Profile
    count: int
    sh_degree: int = 0
    birth: int = 0
    layer: int = 0
    late: bool = False
    """Whether some start offsets are not zero."""
    outlier: bool = False
    """Whether one Gaussian lies too far away for the integers."""


CASES = (
    Case("raw-empty", Profile.RAW, 0),
    Case("raw-degree-0", Profile.RAW, 3, birth=-4, layer=3),
    Case("raw-degree-1-late", Profile.RAW, 2, sh_degree=1, birth=70_000, late=True),
    Case("compact-empty", Profile.COMPACT, 0),
    Case("compact-one", Profile.COMPACT, 1, birth=-1),
    Case("compact-degree-0", Profile.COMPACT, 24, birth=12, layer=1),
    Case("compact-late", Profile.COMPACT, 6, late=True),
    Case("compact-degree-2", Profile.COMPACT, 4, sh_degree=2),
    Case("compact-outlier", Profile.COMPACT, 40, outlier=True),
    Case("paper-empty", Profile.PAPER, 0),
    Case("paper-degree-0", Profile.PAPER, 24, birth=12, layer=1),
    Case("paper-degree-1-late", Profile.PAPER, 5, sh_degree=1, birth=-2, late=True),
)

OBJECT_CASES = (
    "raw-degree-0",
    "compact-one",
    "compact-late",
    "compact-degree-0",
    "raw-degree-1-late",
)
"""The chunks in each object, in order of birth."""

CODERS = tuple(Coder)
"""One object of each."""


def make_slice(case: Case) -> Slice:
    """The Gaussians of `case`; nothing lies within 0.05 % of a step from a rounding boundary."""
    n = case.count
    i = np.arange(n, dtype=np.float64)
    off = 1 / 3
    axes = np.stack([(37 * i) % 101, (53 * i) % 97, (71 * i) % 89], axis=1)
    means = (axes + off) * STEPS.position_m
    # One Gaussian holds each range's lower end, from which the quantisers count.
    means[:1] = 0
    if case.outlier:
        means[n // 2] = 1e6
    scales = np.stack([-2 - (i % 5), -4 - (i % 7), -8 - (i % 3)], axis=1) + off * STEPS.log_scale
    scales[:1] = -7
    turns = np.stack([((11 * i) % 13) - 6, ((5 * i) % 11) - 5, ((7 * i) % 9) - 4], axis=1) * 0.04
    quats = np.concatenate([np.ones((n, 1)), turns + 0.003], axis=1)
    logits = 0.41 * ((i * 3) % 17) - 3.3
    colours = 0.2 * np.sin(np.arange(n * sh_count(case.sh_degree) * 3) * 1.7)
    return Slice(
        case.birth,
        Splats(
            means.astype(np.float32),
            scales.astype(np.float32),
            quats.astype(np.float32),
            logits.astype(np.float32),
            colours.reshape(n, -1, 3).astype(np.float32)
            if n
            else np.zeros((0, sh_count(case.sh_degree), 3), np.float32),
        ),
        (np.arange(n) % 3 if case.late else np.zeros(n)).astype(np.uint8),
    )


def encode(case: Case) -> EncodedChunk:
    return encode_chunk(make_slice(case), case.layer, case.profile, STEPS)


def decoded_sha256(chunk: Chunk) -> str:
    """One hash over every decoded number, as little-endian float32 and bytes."""
    digest = hashlib.sha256()
    for array in chunk.slice.splats.arrays:
        digest.update(array.astype("<f4").tobytes())
    digest.update(chunk.slice.start_offsets.tobytes())
    return digest.hexdigest()


def record(case: Case) -> dict[str, object]:
    """What is pinned of `case`: the chunk, and what it decodes to."""
    data = encode(case).data
    chunk = decode_chunk(data)
    return {
        "name": case.name,
        "chunk_hex": data.hex(),
        "first_mean": chunk.slice.splats.means[:1].ravel().tolist(),
        "decoded_sha256": decoded_sha256(chunk),
    }


def object_record(coder: Coder) -> dict[str, object]:
    """What is pinned of an object: its bytes, to be read for ever; an encoder may find better."""
    by_name = {case.name: case for case in CASES}
    chunks = [encode(by_name[name]) for name in OBJECT_CASES]
    return {"coder": coder.value, "object_hex": encode_object(chunks, coder).hex()}
