"""The bytes of chunks and objects, pinned; and FORMAT.md, by a decoder written from it alone."""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
import pytest

from codec.coders.coder import Coder
from codec.errors import CodecError
from codec.profiles.profile import CHUNK_PROFILES, Profile
from codec.splats import Floats
from codec.stream.chunk import Chunk, decode_chunk, encode_chunk
from codec.stream.object import HEAD, decode_object, encode_object
from tests.goldens.cases import (
    CASES,
    CODERS,
    FILE,
    OBJECT_CASES,
    OBJECTS_FILE,
    Case,
    decoded_sha256,
    encode,
)
from tests.goldens.format_decoder import PlainChunk, decode
from tests.goldens.format_decoder import decode_object as decode_plain_object
from tests.support.hostile_chunks import hostile_chunks
from tests.support.trained_like import trained_like_slice

GOLDENS: list[dict[str, Any]] = json.loads(FILE.read_text(encoding="utf-8"))
OBJECTS: list[dict[str, Any]] = json.loads(OBJECTS_FILE.read_text(encoding="utf-8"))


def same_bits(found: Floats, expected: object) -> bool:
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
    assert encode(case).data == data
    chunk = decode_chunk(data)
    assert chunk.slice.splats.means[:1].ravel().tolist() == golden["first_mean"]
    assert decoded_sha256(chunk) == golden["decoded_sha256"]
    assert_same(chunk, decode(data))


@pytest.mark.parametrize("profile", CHUNK_PROFILES)
@pytest.mark.parametrize("sh_degree", [0, 1, 3])
def test_a_decoder_written_from_the_format_agrees_bit_for_bit(
    profile: Profile, sh_degree: int
) -> None:
    data = encode_chunk(trained_like_slice(3, 300, sh_degree), 2, profile).data
    assert_same(decode_chunk(data), decode(data))


def test_a_decoder_written_from_the_format_refuses_the_same() -> None:
    kept = 0
    for data in hostile_chunks(1500):
        try:
            chunk = decode_chunk(data)
        except CodecError:
            with pytest.raises(AssertionError):
                decode(data)
        else:
            assert_same(chunk, decode(data))
            kept += 1
    assert 300 < kept < 1200


def test_a_step_of_rotation_whose_square_is_infinite() -> None:
    """The text gives w = 0 then, and the quaternion is a valid one."""
    data = bytearray(encode_chunk(trained_like_slice(0, 50), 0, Profile.COMPACT).data)
    struct.pack_into("<f", data, 24 + 24, 1e19)
    chunk = decode_chunk(bytes(data))
    assert (chunk.slice.splats.quats[:, 0] == 0).any()
    assert_same(chunk, decode(bytes(data)))


def test_every_coder_is_pinned() -> None:
    assert [golden["coder"] for golden in OBJECTS] == [coder.value for coder in CODERS]


@pytest.mark.parametrize("golden", OBJECTS, ids=[Coder(g["coder"]).name for g in OBJECTS])
def test_objects_of_every_coder_are_read_for_ever(golden: dict[str, Any]) -> None:
    by_name = {g["name"]: g for g in GOLDENS}
    wanted = [by_name[name] for name in OBJECT_CASES]
    data = bytes.fromhex(golden["object_hex"])
    assert HEAD.unpack_from(data)[4] == golden["coder"]
    found = [decoded_sha256(chunk) for chunk in decode_object(data)]
    assert found == [g["decoded_sha256"] for g in wanted]
    assert [chunk.hex() for chunk in decode_plain_object(data)] == [g["chunk_hex"] for g in wanted]


@pytest.mark.parametrize("coder", list(Coder))
@pytest.mark.parametrize("profile", CHUNK_PROFILES)
def test_a_decoder_written_from_the_format_reads_what_is_written_now(
    profile: Profile, coder: Coder
) -> None:
    chunks = [encode_chunk(trained_like_slice(birth, 300, 1), 0, profile) for birth in (-1, 0, 4)]
    assert decode_plain_object(encode_object(chunks, coder)) == [chunk.data for chunk in chunks]
