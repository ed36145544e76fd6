"""Profile `paper`: within what fp16 and bytes can say, 29 bytes a Gaussian, and nothing clamped."""

from __future__ import annotations

import struct
from functools import reduce

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.coders.coder import decompress
from codec.errors import CorruptError, InvalidError
from codec.pose import Doubles
from codec.profiles import paper
from codec.profiles.paper import ATTRIBUTES, quantise_attribute
from codec.profiles.profile import Profile
from codec.profiles.quantise import MAX_LOGIT
from codec.slice import Slice
from codec.splats import Floats, Splats, sh_count
from codec.stream.chunk import (
    HEADER_BYTES,
    MAX_CHUNK_BYTES,
    decode_chunk,
    encode_chunk,
)
from codec.stream.object import decode_packet, encode_packet
from tests.goldens.format_decoder import decode
from tests.support.hostile import flips, survives, truncations
from tests.support.trained_like import trained_like_slice, trained_like_splats

FIELDS = {
    "means": "means",
    "rotation": "quats",
    "scale": "log_scales",
    "feat": "sh",
    "opacity": "logit_opacities",
}


@st.composite
def slices(draw: st.DrawFn) -> Slice:
    """Any slice of up to 40 Gaussians that fp16 can hold, its numbers of any magnitude."""
    count = draw(st.integers(0, 40))
    degree = draw(st.integers(0, 3))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    largest = 2.0 ** draw(st.integers(-30, 15))

    def numbers(*shape: int) -> Floats:
        return rng.uniform(-largest, largest, shape).astype(np.float32)

    quats = rng.normal(size=(count, 4))
    if draw(st.booleans()):
        quats[:, 1:] *= 0.01  # hardly turned: one component near 1 or -1
    quats *= 10.0 ** draw(st.integers(-30, 30))
    splats = Splats(
        numbers(count, 3),
        numbers(count, 3),
        quats.astype(np.float32),
        numbers(count),
        numbers(count, sh_count(degree), 3),
    )
    late = rng.integers(0, 255, count) * draw(st.booleans())
    return Slice(draw(st.integers(-255, 2**31 - 1)), splats, late.astype(np.uint8))


def half_error(values: Floats) -> Doubles:
    """Half the distance between neighbouring fp16 at `values`: 11 bits, down to 2^-24."""
    bound: Doubles = np.maximum(2.0**-11 * np.abs(values.astype(np.float64)), 2.0**-25)
    return bound


def error(found: Floats, expected: Floats) -> Doubles:
    difference: Doubles = np.abs(found.astype(np.float64) - expected)
    return difference


def unit(quats: Floats) -> Doubles:
    doubles = quats.astype(np.float64)
    units: Doubles = doubles / np.linalg.norm(doubles, axis=1, keepdims=True)
    return units


def same(a: Splats, b: Splats, but: str = "") -> bool:
    """Whether all fields but one are equal bit for bit."""
    names = set(FIELDS.values()) - {but}
    return all(getattr(a, name).tobytes() == getattr(b, name).tobytes() for name in names)


@given(slices(), st.integers(0, 255))
@settings(max_examples=80, deadline=None)
def test_every_value_is_within_its_bit_depth(slice: Slice, layer: int) -> None:
    chunk = decode_chunk(encode_chunk(slice, layer, Profile.PAPER).data)
    assert (chunk.birth, chunk.layer, chunk.profile) == (slice.birth, layer, Profile.PAPER)
    assert (chunk.slice.start_offsets == slice.start_offsets).all()
    found, given_ = chunk.slice.splats, slice.splats
    assert (error(found.means, given_.means) <= half_error(given_.means)).all()
    assert (error(found.log_scales, given_.log_scales) <= half_error(given_.log_scales)).all()
    units = unit(given_.quats)
    turned = np.abs(found.quats - units)
    assert (turned <= np.where(units > 127.5 / 128, 1 / 128, 1 / 256) + 1e-12).all()
    # float32 rounds the opacity that goes in and the one that comes out.
    assert (error(found.opacities, given_.opacities) <= 1 / 510 + 3e-7).all()
    assert found.sh.tobytes() == given_.sh.tobytes()


@given(slices())
@settings(max_examples=30, deadline=None)
def test_a_second_time_changes_nothing_but_lengths_of_quaternions(slice: Slice) -> None:
    once = decode_chunk(encode_chunk(slice, 0, Profile.PAPER).data).slice
    twice = decode_chunk(encode_chunk(once, 0, Profile.PAPER).data).slice
    assert same(once.splats, twice.splats, but="quats")
    assert (np.abs(unit(once.splats.quats) - twice.splats.quats) <= 1 / 128 + 1e-12).all()


@pytest.mark.parametrize(("sh_degree", "expected"), [(0, 29), (1, 65), (2, 125), (3, 209)])
def test_bytes_per_gaussian_are_pinned(sh_degree: int, expected: int) -> None:
    assert paper.bytes_per_gaussian(sh_degree) == expected
    slice = trained_like_slice(0, 100, sh_degree)
    on_time = Slice(0, slice.splats, np.zeros(100, np.uint8))
    assert len(encode_chunk(on_time, 0, Profile.PAPER).data) == HEADER_BYTES + 100 * expected


def test_zstd_takes_no_more_than_27_bytes_of_a_trained_like_gaussian() -> None:
    splats = trained_like_splats(2500)
    chunk = encode_chunk(Slice(0, splats, np.zeros(2500, np.uint8)), 0, Profile.PAPER)
    assert len(encode_packet(chunk)) < 27 * 2500


def test_the_layout_is_pinned() -> None:
    splats = Splats(
        np.array([[1, -2, 0.1]], np.float32),
        np.array([[-4, -5.5, -8.01]], np.float32),
        np.array([[4, 0, -3, 0]], np.float32),
        np.array([0], np.float32),
        np.array([[[0.1, 0.2, 0.3]]], np.float32),
    )
    body = encode_chunk(Slice(0, splats, np.zeros(1, np.uint8)), 0, Profile.PAPER).data[
        HEADER_BYTES:
    ]
    assert struct.unpack("<6e4BB3f", body) == pytest.approx(
        (1, -2, 0.1, -4, -5.5, -8.01, 230, 128, 51, 128, 128, 0.1, 0.2, 0.3), rel=2**-11
    )


@pytest.mark.parametrize("count", [0, 1, 300])
@pytest.mark.parametrize("late", [False, True])
def test_a_packet_holds_the_chunk_whatever_its_size(count: int, late: bool) -> None:
    splats = trained_like_splats(count, sh_degree=1)
    chunk = encode_chunk(Slice(5, splats, np.full(count, late, np.uint8)), 1, Profile.PAPER)
    assert (chunk.edges[0], chunk.edges[-1]) == (0, len(chunk.data))
    packet = encode_packet(chunk)
    assert decompress(packet, MAX_CHUNK_BYTES) == chunk.data
    assert len(decode_packet(packet).slice.splats) == count


@pytest.mark.parametrize(
    ("field", "what"), [("means", "position"), ("log_scales", "log-scale"), ("sh", "colour")]
)
@pytest.mark.parametrize("value", [65520.0, -7e4, 3e38])
def test_what_fp16_cannot_hold_is_refused_in_one_line(field: str, what: str, value: float) -> None:
    splats = trained_like_splats(10)
    getattr(splats, field).flat[7] = value
    slice = Slice(0, splats, np.zeros(10, np.uint8))
    attribute = {field: name for name, field in FIELDS.items()}[field]
    with pytest.raises(InvalidError, match=rf"^paper: a {what} of .* does not fit fp16.*raw$"):
        quantise_attribute(splats, attribute)
    if field == "sh":
        found = decode_chunk(encode_chunk(slice, 0, Profile.PAPER).data).slice.splats.sh
        assert found.tobytes() == splats.sh.tobytes()
        return
    with pytest.raises(InvalidError, match=f"a {what} of"):
        encode_chunk(slice, 0, Profile.PAPER)


@pytest.mark.parametrize("value", [65504.0, 65519.0, -65519.0])
def test_the_largest_fp16_fits(value: float) -> None:
    splats = trained_like_splats(3)
    splats.means[1, 2] = value
    found = quantise_attribute(splats, "means").means
    assert found[1, 2] == np.copysign(np.float32(65504), np.float32(value))


def test_scales_of_any_unit_keep_their_logarithm() -> None:
    # The standard deviation 1e-9 m would be 0 as a linear fp16.
    splats = trained_like_splats(3)
    splats.log_scales[:] = np.log(1e-9)
    found = quantise_attribute(splats, "scale").log_scales
    assert np.exp(found) == pytest.approx(1e-9, rel=0.01)


def test_extreme_opacities_stay_finite() -> None:
    splats = trained_like_splats(2)
    splats.logit_opacities[:] = (-1e30, 1e30)
    assert quantise_attribute(splats, "opacity").logit_opacities.tolist() == [-MAX_LOGIT, MAX_LOGIT]


@pytest.mark.parametrize("attribute", list(ATTRIBUTES))
@pytest.mark.parametrize("sh_degree", [0, 2])
def test_one_attribute_at_a_time(attribute: str, sh_degree: int) -> None:
    splats = trained_like_splats(200, sh_degree=sh_degree)
    kept = [getattr(splats, name).copy() for name in FIELDS.values()]
    found = quantise_attribute(splats, attribute)
    field = FIELDS[attribute]
    assert same(found, splats, but=field)
    assert (getattr(found, field) != getattr(splats, field)).any()
    assert ATTRIBUTES[attribute](splats).sh.tobytes() == found.sh.tobytes()
    for before, name in zip(kept, FIELDS.values(), strict=True):
        assert before.tobytes() == getattr(splats, name).tobytes()


def test_the_columns_are_those_of_table_6() -> None:
    assert list(ATTRIBUTES) == ["means", "rotation", "scale", "feat", "opacity"]
    with pytest.raises(InvalidError, match="'colour' is not one of means, rotation"):
        quantise_attribute(Splats.empty(), "colour")


@given(slices())
@settings(max_examples=30, deadline=None)
def test_a_chunk_is_all_attributes_but_feat(slice: Slice) -> None:
    names = [name for name in ATTRIBUTES if name != "feat"]
    expected = reduce(quantise_attribute, names, slice.splats)
    found = decode_chunk(encode_chunk(slice, 0, Profile.PAPER).data).slice.splats
    assert same(found, expected)


@given(slices())
@settings(max_examples=30, deadline=None)
def test_feat_is_within_its_bit_depth(slice: Slice) -> None:
    found = quantise_attribute(slice.splats, "feat")
    assert (error(found.sh, slice.splats.sh) <= half_error(slice.splats.sh)).all()


@given(slices())
@settings(max_examples=30, deadline=None)
def test_the_decoder_of_the_format_agrees(slice: Slice) -> None:
    data = encode_chunk(slice, 3, Profile.PAPER).data
    plain, found = decode(data), decode_chunk(data).slice.splats
    for name in FIELDS.values():
        array = getattr(found, name)
        expected = np.array(getattr(plain, name), np.float32).reshape(array.shape)
        assert array.tobytes() == expected.tobytes()


@pytest.mark.parametrize("sh_degree", [0, 1])
def test_hostile_bytes(sh_degree: int) -> None:
    data = encode_chunk(trained_like_slice(1, 9, sh_degree), 0, Profile.PAPER).data
    for cut in truncations(data):
        assert not survives(decode_chunk, cut)
    assert not survives(decode_chunk, data + b"\0")
    kept = [survives(decode_chunk, altered) for altered in flips(data)]
    assert any(kept)
    assert not all(kept)


@given(st.binary(min_size=58, max_size=58))
@settings(max_examples=200, deadline=None)
def test_noise_of_the_right_length(noise: bytes) -> None:
    two = Slice(0, trained_like_splats(2), np.zeros(2, np.uint8))
    head = encode_chunk(two, 0, Profile.PAPER).data[:HEADER_BYTES]
    survives(decode_chunk, head + noise)


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        (0, b"\x00\x7c", "means holds a value that is not finite"),  # infinity
        (0, b"\x01\x7c", "means holds a value that is not finite"),  # a signalling NaN
        (8, b"\x00\xfe", "log_scales holds a value that is not finite"),
        (12, b"\x80\x80\x80\x80", "zero quaternion"),
        (17, b"\x00\x00\x80\x7f", "sh holds a value that is not finite"),
        (21, b"\x01\x00\x80\x7f", "sh holds a value that is not finite"),
    ],
)
def test_values_that_no_gaussian_has(place: int, value: bytes, message: str) -> None:
    splats = trained_like_splats(1)
    data = bytearray(encode_chunk(Slice(0, splats, np.zeros(1, np.uint8)), 0, Profile.PAPER).data)
    data[HEADER_BYTES + place : HEADER_BYTES + place + len(value)] = value
    with pytest.raises(CorruptError, match=message):
        decode_chunk(bytes(data))
