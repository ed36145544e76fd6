"""Chunks: what goes in comes out, within the steps; what never went in is refused."""

from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.errors import CorruptError, InvalidError, UnsupportedError
from codec.pose import Doubles
from codec.profiles import compact
from codec.profiles.compact import Head
from codec.profiles.orientation import canonical
from codec.profiles.profile import CHUNK_PROFILES, Profile
from codec.profiles.quantise import Steps, choose_steps, to_luma
from codec.slice import Slice
from codec.splats import SH_C0, Floats, Splats, sh_count
from codec.stream.chunk import (
    HEADER_BYTES,
    MAX_SPLATS_PER_CHUNK,
    decode_chunk,
    encode_chunk,
    read_header,
)
from tests.support.drawn import same
from tests.support.hostile import flips, survives, truncations
from tests.support.trained_like import covariances, trained_like_slice, trained_like_splats


@st.composite
def slices(draw: st.DrawFn, limit: float = 1e3) -> Slice:
    """Any slice of up to 40 Gaussians whose numbers are at most `limit`."""
    count = draw(st.integers(0, 40))
    degree = draw(st.integers(0, 3))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    size = limit ** draw(st.floats(-1, 1))

    def numbers(*shape: int) -> Floats:
        return rng.uniform(-size, size, shape).astype(np.float32)

    quats = rng.normal(size=(count, 4)).astype(np.float32)
    splats = Splats(
        numbers(count, 3),
        numbers(count, 3) / np.float32(size) * np.float32(min(size, 20)),
        quats,
        numbers(count),
        numbers(count, sh_count(degree), 3),
    )
    late = rng.integers(0, 255, count) * draw(st.booleans())
    return Slice(draw(st.integers(-255, 2**31 - 1)), splats, late.astype(np.uint8))


@given(slices(limit=1e30), st.integers(0, 255))
@settings(max_examples=60, deadline=None)
def test_raw_keeps_every_bit(slice: Slice, layer: int) -> None:
    chunk = decode_chunk(encode_chunk(slice, layer, Profile.RAW).data)
    assert (chunk.birth, chunk.layer, chunk.profile) == (slice.birth, layer, Profile.RAW)
    assert same(chunk.slice.splats, slice.splats)
    assert (chunk.slice.start_offsets == slice.start_offsets).all()


def assert_within_steps(slice: Slice, data: bytes) -> None:
    """`data` decodes to the Gaussians of `slice`, in any order, within the steps that it names."""
    head = Head.unpack(memoryview(data)[HEADER_BYTES:])
    chunk = decode_chunk(data)
    # The encoder's own order pairs the Gaussians: it is not in the file.
    steps = Steps(
        head.position_step_m,
        head.scale_step,
        0.5**0.5 / head.rotation_half,
        1 / (head.opacity_levels - 1),
        head.colour_step,
    )
    order = compact.encode(slice.splats, steps).order
    assert order is not None
    given_, found = slice.splats.take(order), chunk.slice.splats
    inside = len(given_) - head.escapes
    assert (chunk.slice.start_offsets == slice.start_offsets[order]).all()

    def close(a: Doubles, b: Doubles, tolerance: float) -> None:
        # A product and a sum in float32; the product is as large as the origin of the range.
        rounding = 4e-7 * (np.abs(b).max(initial=0) + tolerance)
        assert (np.abs(a - b) <= tolerance * 0.5001 + rounding)[:inside].all()
        assert (a == b)[inside:].all()

    close(found.means.astype(float), given_.means.astype(float), head.position_step_m)
    scales, quats = canonical(given_.log_scales, given_.quats)
    close(found.log_scales[:inside].astype(float), scales[:inside], head.scale_step)
    close(found.quats[:inside, 1:].astype(float), quats[:inside, 1:], head.rotation_step)
    close(
        found.opacities[:inside].astype(float),
        given_.opacities[:inside].astype(float),
        1 / (head.opacity_levels - 1),
    )
    rgb = given_.sh[:inside].astype(float)
    if given_.sh_degree == 0:
        rgb = np.maximum(rgb, -0.5 / SH_C0)
    # Each of Y, Co, Cg is off by half a step at most, and they are sums of R, G, B.
    close(to_luma(found.sh[:inside].astype(float)), to_luma(rgb), head.colour_step)


@given(slices())
@settings(max_examples=60, deadline=None)
def test_compact_stays_within_its_steps(slice: Slice) -> None:
    assert_within_steps(slice, encode_chunk(slice, 0, Profile.COMPACT).data)


@pytest.mark.parametrize("sh_degree", [0, 1, 2, 3])
def test_compact_of_a_trained_like_slice(sh_degree: int) -> None:
    slice = trained_like_slice(7, 2000, sh_degree)
    data = encode_chunk(slice, 1, Profile.COMPACT).data
    assert_within_steps(slice, data)
    assert Head.unpack(memoryview(data)[HEADER_BYTES:]).escapes < 20


def test_compact_keeps_the_shape_of_a_gaussian() -> None:
    splats = trained_like_splats(500)
    steps = Steps(1e-3, 1e-3, 1e-2, 1e-2, 1e-2)
    body = compact.encode(splats, steps)
    found = compact.decode(memoryview(body.data), len(splats), 0)
    assert body.order is not None
    given_ = splats.take(body.order)
    expected = covariances(given_.log_scales.astype(float), given_.quats.astype(float))
    actual = covariances(found.log_scales.astype(float), found.quats.astype(float))
    # Half a step of each of x, y, z turns by at most 2 * sqrt(3) / 2 of one, and w adds its share.
    turn = 4 * 0.5**0.5 / round(0.5**0.5 / steps.rotation)
    largest = np.exp(2 * given_.log_scales.max(axis=1).astype(float))
    assert (np.abs(actual - expected).max(axis=(1, 2)) <= (2 * turn + 0.01) * largest).all()


def test_coarser_steps_give_fewer_bytes() -> None:
    slice = trained_like_slice(0, 3000)
    steps = choose_steps(slice.splats)
    sizes = [
        len(encode_chunk(slice, 0, Profile.COMPACT, steps.coarser(f)).data) for f in (0.5, 1.0, 2.0)
    ]
    # Only the low bits of positions shrink before the entropy coder: 3 bits each time.
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[1] - sizes[2] == pytest.approx(3000 * 3 / 8, rel=0.2)


def test_outliers_escape_and_harm_nobody() -> None:
    slice = trained_like_slice(0, 400)
    means = slice.splats.means.copy()
    means[5] = (3e38, -3e38, 1e9)
    log_scales = slice.splats.log_scales.copy()
    log_scales[6] = 80
    sh = slice.splats.sh.copy()
    sh[7] = -1e20, 4e6, 1e33
    splats = Splats(means, log_scales, slice.splats.quats, slice.splats.logit_opacities, sh)
    wild = Slice(0, splats, slice.start_offsets)
    data = encode_chunk(wild, 0, Profile.COMPACT).data
    assert_within_steps(wild, data)
    head = Head.unpack(memoryview(data)[HEADER_BYTES:])
    assert head.escapes == 3
    assert head.position_step_m < 0.01


def test_the_header_is_pinned() -> None:
    slice = trained_like_slice(-3, 10, sh_degree=1)
    data = encode_chunk(slice, 2, Profile.RAW).data
    assert struct.unpack_from("<4sBBBBiIBBHI", data) == (
        *(b"SWGC", 1, 0, 0, int(slice.start_offsets.any())),
        *(-3, 10, 2, 1, 0, len(data) - 24),
    )
    assert compact.HEAD.size == 48
    on_time = Slice(0, slice.splats, np.zeros(10, np.uint8))
    assert not read_header(encode_chunk(on_time, 0, Profile.RAW).data).has_start_offsets


@pytest.mark.parametrize("profile", CHUNK_PROFILES)
def test_every_truncation_is_refused(profile: Profile) -> None:
    data = encode_chunk(trained_like_slice(1, 9, sh_degree=1), 0, profile).data
    for cut in truncations(data):
        assert not survives(decode_chunk, cut)
    assert not survives(decode_chunk, data + b"\0")


@pytest.mark.parametrize("profile", CHUNK_PROFILES)
def test_any_altered_byte_gives_a_value_or_our_error(profile: Profile) -> None:
    data = encode_chunk(trained_like_slice(1, 30), 0, profile).data
    kept = [survives(decode_chunk, altered) for altered in flips(data)]
    assert any(kept)
    assert not all(kept)


@given(st.binary(max_size=300), st.sampled_from(CHUNK_PROFILES))
@settings(max_examples=200, deadline=None)
def test_noise_after_a_good_header(noise: bytes, profile: Profile) -> None:
    good = bytearray(encode_chunk(trained_like_slice(0, 3), 0, profile).data[:HEADER_BYTES])
    good[20:24] = struct.pack("<I", len(noise))
    survives(decode_chunk, bytes(good) + noise)
    survives(decode_chunk, noise)


@pytest.mark.parametrize(
    ("place", "value", "error"),
    [
        (0, b"X", CorruptError),
        (4, b"\2", UnsupportedError),
        (5, b"\1", UnsupportedError),
        (6, b"\3", UnsupportedError),
        (7, b"\2", UnsupportedError),
        (12, struct.pack("<I", MAX_SPLATS_PER_CHUNK + 1), CorruptError),
        (12, b"\xff\xff\xff\xff", CorruptError),
        (17, b"\4", UnsupportedError),
        (18, b"\1", UnsupportedError),
        (20, b"\xff\xff\xff\xff", CorruptError),
    ],
)
def test_a_header_out_of_bounds(place: int, value: bytes, error: type[Exception]) -> None:
    data = bytearray(encode_chunk(trained_like_slice(0, 4), 0, Profile.COMPACT).data)
    data[place : place + len(value)] = value
    with pytest.raises(error):
        decode_chunk(bytes(data))


def altered_head(place: int, layout: str, value: float) -> bytes:
    """A compact chunk of 50 Gaussians with another number at `place` of its head."""
    data = bytearray(encode_chunk(trained_like_slice(0, 50), 0, Profile.COMPACT).data)
    struct.pack_into(layout, data, HEADER_BYTES + place, value)
    return bytes(data)


@pytest.mark.parametrize("number", [float("nan"), float("inf"), -float("inf")])
@pytest.mark.parametrize("field", range(9))
def test_a_head_that_is_not_finite(field: int, number: float) -> None:
    with pytest.raises(CorruptError, match="a number in the head is not finite"):
        decode_chunk(altered_head(4 * field, "<f", number))


@pytest.mark.parametrize("field", [3, 5, 6, 8])
def test_a_step_so_large_that_values_are_not_finite(field: int) -> None:
    for number in (3e38, -3e38):
        with pytest.raises(CorruptError, match="holds a value that is not finite"):
            decode_chunk(altered_head(4 * field, "<f", number))


@pytest.mark.parametrize("field", [0, 1, 2, 4, 7])
def test_a_base_as_large_as_float32_goes(field: int) -> None:
    splats = decode_chunk(altered_head(4 * field, "<f", 3e38)).slice.splats
    largest = (splats.means, splats.log_scales, splats.sh)[min(field // 3, 2)]
    assert largest.max() == np.float32(3e38)


@pytest.mark.parametrize(
    ("place", "layout", "value", "message"),
    [
        (36, "<H", 0, "0 opacity levels"),
        (36, "<H", 1, "1 opacity levels"),
        (36, "<H", 257, "257 opacity levels"),
        (36, "<H", 65535, "65535 opacity levels"),
        (36, "<H", 2, r"opacity \d+ of 2 levels"),
        (38, "<H", 0, "rotation half 0"),
        (38, "<H", 128, "rotation half 128"),
        (38, "<H", 65535, "rotation half 65535"),
        (40, "<I", 51, "51 escapes among 50"),
        (40, "<I", 1 << 31, "2147483648 escapes among 50"),
        (44, "<I", 1 << 20, "a body of .* for 50 Gaussians"),
    ],
)
def test_a_head_out_of_bounds(place: int, layout: str, value: int, message: str) -> None:
    with pytest.raises(CorruptError, match=message):
        decode_chunk(altered_head(place, layout, value))


@pytest.mark.parametrize("levels", [2, 3, 255])
def test_an_opacity_that_has_no_level(levels: int) -> None:
    """The kernel looks its logit up: beyond the table it would read what lies there."""
    head = Head(0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.1, 0.0, 1.0, levels, 127)
    for opacity in (levels - 1, levels, 255):
        body = head.pack() + bytes(7) + bytes([opacity]) + bytes(3)
        if opacity < levels:
            assert len(compact.decode(memoryview(body), 1, 0)) == 1
        else:
            with pytest.raises(CorruptError, match=f"opacity {opacity} of {levels} levels"):
                compact.decode(memoryview(body), 1, 0)


def test_a_chunk_of_nobody_still_has_a_head() -> None:
    """No value shows that its bounds are broken, so only the bounds can refuse."""
    good = Head(0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.1, 0.0, 1.0, 2, 1)
    assert len(compact.decode(memoryview(good.pack()), 0, 0)) == 0
    for change in (
        {"opacity_levels": 1},
        {"opacity_levels": 257},
        {"rotation_half": 0},
        {"rotation_half": 128},
        {"colour_step": float("nan")},
    ):
        bad = replace(good, **change)
        with pytest.raises(CorruptError, match="compact"):
            compact.decode(memoryview(bad.pack()), 0, 0)


def test_numbers_that_are_not_finite() -> None:
    raw = bytearray(encode_chunk(trained_like_slice(0, 5), 0, Profile.RAW).data)
    struct.pack_into("<f", raw, HEADER_BYTES + 8, float("nan"))
    with pytest.raises(CorruptError, match="not finite"):
        decode_chunk(bytes(raw))


def test_a_zero_quaternion_is_refused() -> None:
    raw = bytearray(encode_chunk(trained_like_slice(0, 1), 0, Profile.RAW).data)
    raw[HEADER_BYTES + 24 : HEADER_BYTES + 40] = bytes(16)
    with pytest.raises(CorruptError, match="zero quaternion"):
        decode_chunk(bytes(raw))


def test_arguments_that_do_not_fit_a_chunk() -> None:
    slice = trained_like_slice(0, 1)
    with pytest.raises(InvalidError, match="layer 256"):
        encode_chunk(slice, 256, Profile.RAW)
    with pytest.raises(InvalidError, match="32 bits"):
        encode_chunk(Slice(1 << 31, slice.splats, slice.start_offsets), 0, Profile.RAW)
