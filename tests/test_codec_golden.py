"""The bytes of chunks, pinned; and FORMAT.md, by a decoder written from it alone."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from codec.chunk import Chunk, decode_chunk, encode_chunk
from codec.profile import Profile
from tests.format_decoder import PlainChunk, decode
from tests.goldens.cases import CASES, FILE, Case, decoded_sha256, encode
from tests.trained_like import trained_like_slice

GOLDENS: list[dict[str, Any]] = json.loads(FILE.read_text(encoding="utf-8"))


def same_bits(found: npt.NDArray[np.float32], expected: object) -> bool:
    return found.tobytes() == np.array(expected, np.float32).reshape(found.shape).tobytes()


def assert_same(chunk: Chunk, plain: PlainChunk) -> None:
    splats = chunk.slice.splats
    assert (chunk.birth, chunk.layer) == (plain.birth, plain.layer)
    assert same_bits(splats.means, plain.means)
    assert same_bits(splats.log_scales, plain.log_scales)
    assert same_bits(splats.quats, plain.quats)
    assert same_bits(splats.logit_opacities, plain.logit_opacities)
    assert same_bits(splats.sh, plain.sh)
    assert chunk.slice.start_offsets.tolist() == plain.start_offsets


def test_every_case_is_pinned() -> None:
    assert [golden["name"] for golden in GOLDENS] == [case.name for case in CASES]


@pytest.mark.parametrize(
    ("case", "golden"), list(zip(CASES, GOLDENS, strict=True)), ids=[c.name for c in CASES]
)
def test_bytes_and_values_are_as_pinned(case: Case, golden: dict[str, Any]) -> None:
    data = bytes.fromhex(golden["chunk_hex"])
    assert encode(case) == data
    chunk = decode_chunk(data)
    assert chunk.slice.splats.means[:1].ravel().tolist() == golden["first_mean"]
    assert decoded_sha256(chunk) == golden["decoded_sha256"]
    assert_same(chunk, decode(data))


@pytest.mark.parametrize("profile", list(Profile))
@pytest.mark.parametrize("sh_degree", [0, 1, 3])
def test_a_decoder_written_from_the_format_agrees_bit_for_bit(
    profile: Profile, sh_degree: int
) -> None:
    data = encode_chunk(trained_like_slice(3, 300, sh_degree), 2, profile)
    assert_same(decode_chunk(data), decode(data))
