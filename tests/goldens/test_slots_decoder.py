"""The plain decoder of version 2, against a plain encoder: FORMAT.md can be read, and one way."""

from __future__ import annotations

import json
import math
import random
import struct
from pathlib import Path

import msgpack
import pytest

from tests.goldens.format_decoder import decode_object, f32
from tests.goldens.slots_cases import COARSE, FINE, assert_same, make_shape
from tests.goldens.slots_decoder import (
    CHANGE,
    ENDED,
    KEPT,
    MASK,
    NEW,
    PREDICTED,
    BitDecoder,
    Floats,
    Gaussian,
    Hole,
    Lattice,
    Slot,
    Unsupported,
    decode_change,
    decode_head,
    decode_mask,
    decode_snapshot,
    predict,
    to_floats,
    unzigzag,
)
from tests.goldens.slots_encoder import (
    BitEncoder,
    RandomStream,
    encode_change,
    encode_mask,
    encode_object,
    encode_record,
    encode_slice_record,
    encode_snapshot,
    head,
    zigzag,
)
from tests.goldens.slots_folder import (
    StreamFolder,
    decoded_whole,
    largest_content,
    read_index,
    read_manifest,
    state_at,
)

# --- Mask ---


@pytest.mark.parametrize("shares", [(1, 0, 0, 0), (0, 0, 0, 1), (50, 1, 9, 1), (1, 1, 1, 1)])
def test_masks_come_back(shares: tuple[int, ...]) -> None:
    rng = random.Random(1)
    slots = (3000, 1, 2, 3, 4)
    before: list[list[list[int]]] = []
    for _ in range(3):
        mask = [rng.choices(range(4), shares, k=count) for count in slots]
        assert decode_mask(encode_mask(mask, before), slots, before) == mask
        before = [mask, *before][:2]


def test_a_mask_of_one_status_after_long_runs_of_another_comes_back() -> None:
    """Probabilities at both ends, and carries."""
    for seed in range(300):
        rng = random.Random(seed)
        runs = [[rng.choice((KEPT, NEW, PREDICTED, ENDED))] * rng.randrange(200) for _ in range(9)]
        mask = [[status for run in runs for status in run]]
        assert decode_mask(encode_mask(mask), (len(mask[0]),), ()) == mask


def test_a_mask_that_costs_what_it_must() -> None:
    """All kept is a few bytes; noise costs its entropy, and little for what is learnt."""
    assert len(encode_mask([[KEPT] * 18000])) < 20
    rng = random.Random(0)
    mask = [rng.choices((KEPT, PREDICTED), (9, 1), k=18000)]
    entropy = -(0.1 * math.log2(0.1) + 0.9 * math.log2(0.9)) * 18000 / 8
    assert len(encode_mask(mask)) < 1.04 * entropy


def test_probabilities_stay_within_their_bounds() -> None:
    """All ones and all zeros are the ends: for one s a larger p stays the larger one."""
    for bit, end in ((1, 63), (0, 65472)):
        encoder = BitEncoder()
        for _ in range(1000):
            encoder.put(0, bit)
        assert encoder.p[0] == end
        decoder = BitDecoder(encoder.finish())
        assert {decoder.bit(0) for _ in range(1000)} == {bit}
        assert decoder.p[0] == end
    assert 3 * math.log2(4096 / (63 // 16)) < 32  # the bits of one slot


def test_adaptation_is_fast_at_first_and_slow_later() -> None:
    encoder, found = BitEncoder(), []
    for _ in range(8):
        encoder.put(0, 0)
        found.append(encoder.p[0])
    assert found == [49151, 57343, 59391, 60927, 62079, 62943, 63267, 63550]
    for _ in range(200):
        encoder.put(0, 0)
    p = encoder.p[0]
    encoder.put(0, 1)
    assert encoder.p[0] == p - p // 128


def test_a_mask_ends_with_the_last_byte_that_is_read() -> None:
    slots = (300,)
    body = encode_mask([[(i * i) % 4 for i in range(300)]])
    decode_mask(body, slots, ())
    for wrong in (body[:-1], body + b"\0", body[:3], b""):
        with pytest.raises(AssertionError):
            decode_mask(wrong, slots, ())


def test_only_four_bytes_of_255_break_the_range() -> None:
    assert decode_mask(b"\xff\xff\xff\xfe", (1,), ()) == [[ENDED]]
    with pytest.raises(AssertionError):
        decode_mask(b"\xff\xff\xff\xff", (1,), ())


def test_a_mask_is_never_longer_than_four_bytes_a_slot() -> None:
    """Whatever the bytes, so that a reader knows how much it may have to hold."""
    rng = random.Random(3)
    for count in (1, 2, 40):
        for _ in range(100):
            with pytest.raises(AssertionError):
                decode_mask(rng.randbytes(4 + 4 * count + 1), (count,), ())
    surprises = [[KEPT] * 900 + [NEW]] * 9
    assert len(encode_mask(surprises)) < 4 + 4 * 9 * 901


def test_heads() -> None:
    shape = make_shape()
    good = head(CHANGE, 5, 1, 1)
    assert decode_head(good, CHANGE, shape).birth == 5
    for at, value in ((4, 3), (6, 2), (7, 1)):
        with pytest.raises(Unsupported):
            decode_head(good[:at] + bytes([value]) + good[at + 1 :], CHANGE, shape)
    with pytest.raises(Unsupported):
        decode_head(head(MASK, 5, 0, 1), MASK, shape)
    for wrong, kind in (
        (good[:-1], CHANGE),
        (b"SWGC" + good[4:], CHANGE),
        (good, MASK),
        (head(CHANGE, 5, 2), CHANGE),
        (head(MASK, 5, 1), MASK),
    ):
        with pytest.raises(AssertionError):
            decode_head(wrong, kind, shape)


# --- Lattice ---


def test_floats_of_a_gaussian() -> None:
    attributes = (-128, 0, 127, 0, 60, -60, 10, 4, 3, 128)
    floats = to_floats(Gaussian(0, (-8388607, 0, 1), attributes), FINE)
    step, scale, turn = FINE.position_m, FINE.log_scale, FINE.rotation
    assert floats.mean == (f32(-8388607 * step), 0.0, step)
    assert floats.log_scales == (f32(f32(-128 * scale) - 3), -3.0, f32(f32(127 * scale) - 3))
    assert floats.quat[1:] == (0.0, f32(60 * turn), f32(-60 * turn))
    assert math.isclose(sum(q * q for q in floats.quat), 1, rel_tol=1e-6)
    assert math.isclose(floats.logit_opacity, math.log(128 / 127), rel_tol=1e-6)
    red, green, blue = floats.sh[0]
    assert [round(c / 0.02, 4) for c in (red, green, blue)] == [11, 13, 3]


def test_a_turn_longer_than_one_has_no_root() -> None:
    gaussian = Gaussian(0, (0, 0, 0), (0, 0, 0, 127, 127, -128, 0, 0, 0, 0))
    assert to_floats(gaussian, FINE).quat[0] == 0
    assert to_floats(gaussian, Lattice(1e-6, 1e6, 1e3, 1e6, 1e6, 2)).quat[0] == 0


def test_zigzag() -> None:
    assert [unzigzag(z) for z in range(5)] == [0, -1, 1, -2, 2]
    assert all(unzigzag(zigzag(d)) == d for d in (-(2**24), -128, 127, 2**24))


# --- Change ---

AT = Gaussian(0, (5, -6, 2**23 - 1), (0, 1, -128, 3, 4, 5, 6, 7, 8, 15))


def body_of(after: Gaussian, new: list[Gaussian] | None = None) -> bytes:
    return encode_change([(AT, after)], new or [], 1, None)


def test_attributes_wrap_and_positions_do_not() -> None:
    after = Gaussian(0, (5 + 128, -6 - 128, -(2**23) + 1), (*range(120, 129 - 1), -128, 0))
    change = decode_change(body_of(after), make_shape(), 1, (1, 0), False)
    assert struct.unpack_from("<I", body_of(after), 8)[0] == 3
    assert predict(AT, change.predicted[0], 0, COARSE) == after
    beyond = Gaussian(0, (5, -6, 2**23), AT.attributes)
    too_opaque = Gaussian(0, AT.position, (*AT.attributes[:-1], 16))
    for wrong in (beyond, too_opaque):
        change = decode_change(body_of(wrong), make_shape(), 1, (1, 0), False)
        assert predict(Hole.UNKNOWN, change.predicted[0], 0, COARSE) is Hole.UNKNOWN
        with pytest.raises(AssertionError):
            predict(AT, change.predicted[0], 0, COARSE)


def test_an_empty_slot_and_an_escaped_one_cannot_be_predicted() -> None:
    stream = RandomStream(make_shape(), 8, 0)
    change = decode_change(body_of(AT), make_shape(), 1, (1, 0), False)
    escaped = next(
        slot
        for lane in stream.truth[0]
        for slots in lane
        for slot in slots
        if isinstance(slot, Gaussian) and slot.escaped
    )
    for before in (Hole.EMPTY, escaped):
        with pytest.raises(AssertionError):
            predict(before, change.predicted[0], 0, COARSE)


def test_new_ones_outside_the_lattice_are_refused() -> None:
    edge = Gaussian(0, (2**23 - 1, 0, -(2**23) + 1), AT.attributes)
    far = Gaussian(0, (-(2**23), 0, 0), AT.attributes)
    opaque = Gaussian(0, (0, 0, 0), (*AT.attributes[:-1], 16))
    assert len(decode_change(body_of(AT, [edge, AT]), make_shape(), 1, (1, 2), False).new) == 2
    for wrong in (far, opaque):
        with pytest.raises(AssertionError):
            decode_change(body_of(AT, [edge, wrong]), make_shape(), 1, (1, 2), False)


def test_starts_are_below_swin_size() -> None:
    body = encode_change([(AT, AT)], [AT], 1, [1])
    change = decode_change(body, make_shape(), 0, (1, 1), True)
    assert (len(change.predicted), change.new[0].start) == (1, 1)
    with pytest.raises(AssertionError):
        decode_change(encode_change([], [AT], 1, [3]), make_shape(), 0, (0, 1), True)


def test_hostile_chunks_are_refused_or_decoded() -> None:
    """Nothing but a refusal comes of them, whatever the bytes."""
    shape, rng = make_shape(), random.Random(5)
    stream = RandomStream(shape, 12, 7, spelled_out=True)
    masks, refused = stream.masks, 0
    for turn in range(2000):
        birth, layer = rng.randrange(1, 12), rng.randrange(2)
        statuses = masks[birth][layer]
        counts = (statuses.count(PREDICTED), statuses.count(NEW))
        snapshot = encode_snapshot(stream.truth[7], 7, layer, shape)
        data = bytearray(snapshot if turn % 2 else stream.changes[birth][layer])
        for _ in range(rng.randrange(1, 3)):
            data[rng.randrange(len(data))] = rng.choice((0, 255, rng.randrange(256)))
        data = data[: rng.choice((len(data), rng.randrange(len(data))))]
        try:
            if turn % 2:
                decode_snapshot(bytes(data), shape)
            else:
                starts = decode_head(bytes(data), CHANGE, shape).has_starts
                decode_change(bytes(data[12:]), shape, layer, counts, starts)
        except AssertionError:
            refused += 1
    assert 1000 < refused < 1990


# --- Folder ---


def test_a_chunk_is_never_larger_than_its_slots_can_fill() -> None:
    shape = make_shape(swin_size=2, k=4, slots=(11,))
    exact = Floats((0.0,) * 3, (0.0,) * 3, (1.0,) * 4, 0.0, ((0.0,) * 3,) * 4)
    row = (*(0,) * 18, 0)
    edges = [Gaussian(0, (q, q, q), row, exact) for q in (1 - 2**23, 2**23 - 1)]
    body = encode_change([], [*edges * 5, edges[0]], 4, [0] * 11)
    empty = encode_change([], [], 4, None)
    # The plain encoder does not move where one escapes, so its low bits are none.
    assert 12 + len(body) + 9 * 11 == largest_content("0", shape)
    lanes: list[list[list[Slot]]] = [[[*edges * 5, edges[0]]], [[*edges * 5, edges[1]]]]
    assert len(encode_snapshot(lanes, 7, 0, shape)) < largest_content("snapshot-0", shape)
    assert largest_content("snapshot-0", shape) == 12 + len(empty) + 3 + 22 * (68 + 15 * 4)
    assert largest_content("masks", shape) == 16 + 4 * 11


def test_a_packet_that_inflates_beyond_its_slots_is_refused(tmp_path: Path) -> None:
    shape = make_shape()
    stream = RandomStream(shape, 3, 6, spelled_out=True)
    largest = largest_content("masks", shape)
    assert len(decode_object(encode_object(stream.mask_chunks, 1), 2, largest)) == 3
    stream.mask_chunks[1] += bytes(10**6)
    with pytest.raises(AssertionError):
        decode_object(encode_object(stream.mask_chunks, 1), 2, largest)
    with pytest.raises(AssertionError):  # and a writer refuses to make it
        stream.write(tmp_path / "s")


def test_a_play_record_that_no_reader_would_take_is_refused() -> None:
    record = encode_slice_record(5, b"mask", [])
    assert msgpack.unpackb(record[4:])["frames"] == []
    encode_slice_record(5, b"mask", [bytes(2**25)])
    for frames in ([bytes(2**25)] * 2, [b""] * 17):
        with pytest.raises(AssertionError):
            encode_slice_record(5, b"mask", frames)


@pytest.mark.parametrize("coder", [1, 2])
def test_what_changes_nothing_takes_nothing_or_says_so(tmp_path: Path, coder: int) -> None:
    shape = make_shape()
    for spelled_out in (False, True):
        stream = RandomStream(shape, 10, 6, still=True, spelled_out=spelled_out)
        stream.write(path := tmp_path / str(spelled_out), coder)
        for frame in (0, 6, 9):
            assert_same(state_at(path, frame, 2), stream.truth[frame], frame)
        folder = StreamFolder(path)
        for name in ("masks", "0", "1"):
            chunks = [*folder.chunks(0, name).values(), *folder.chunks(1, name).values()]
            assert len(chunks) == 10
            assert all(map(bool, chunks)) == spelled_out
            assert spelled_out or folder.index[1].files[name].size == 20


def test_a_birth_of_another_segment_is_refused(tmp_path: Path) -> None:
    shape = make_shape()
    stream = RandomStream(shape, 10, 6, spelled_out=True)
    stream.write(tmp_path / "s")
    folder = StreamFolder(tmp_path / "s")
    files = {name: encode_object(stream.mask_chunks[1:8], 1) for name in folder.index[0].files}
    (tmp_path / "s" / "segments" / "0" / "masks").write_bytes(files["masks"])
    record = encode_record(files, 0, 7, shape)
    data = (tmp_path / "s" / "index.bin").read_bytes()
    (tmp_path / "s" / "index.bin").write_bytes(record + data[len(record) :])
    with pytest.raises(AssertionError):
        StreamFolder(tmp_path / "s").chunks(0, "masks")


def test_the_slice_born_at_0_keeps_all_slots() -> None:
    shape = make_shape()
    stream = RandomStream(shape, 1, 6)
    assert stream.masks[0] == [[KEPT] * 9, [KEPT] * 5]
    assert stream.mask_chunks[0] == b""
    assert stream.changes[0] == [b"", b""]


def test_what_a_reader_of_whole_objects_counts() -> None:
    shape = make_shape()
    stream = RandomStream(shape, 7, 6, spelled_out=True)
    assert decoded_whole("masks", stream.mask_chunks, shape) == 7 * 14
    for layer in (0, 1):
        chunks = [changes[layer] for changes in stream.changes]
        statuses = [status for mask in stream.masks for status in mask[layer]]
        count = statuses.count(PREDICTED) + statuses.count(NEW)
        assert decoded_whole(str(layer), chunks, shape) == count * 4 * 14
    snapshot = encode_snapshot(stream.truth[0], 0, 1, shape)
    count = sum(isinstance(slot, Gaussian) for lane in stream.truth[0] for slot in lane[1])
    assert decoded_whole("snapshot-1", [snapshot], shape) == count * 4 * 14


def test_a_wrong_index_or_object_is_refused(tmp_path: Path) -> None:
    shape = make_shape()
    stream = RandomStream(shape, 17, 6)
    stream.write(tmp_path / "s")
    file = tmp_path / "s" / "index.bin"
    data = file.read_bytes()
    size = 20 + 44 * 2 + 40 * 3
    assert len(data) == 3 * size
    assert [r.num_frames for r in read_index(data, shape)] == [7, 7, 3]
    assert len(read_index(data + data[:9], shape)) == 3
    assert len(read_index(data + bytes(size), shape)) == 3
    for wrong in (data[size:], data + data[:size], bytes(size) + data):
        with pytest.raises(AssertionError):
            read_index(wrong, shape)
    target = tmp_path / "s" / "segments" / "1" / "snapshot-1"
    whole = target.read_bytes()
    target.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    state_at(tmp_path / "s", 16, 2)
    with pytest.raises(AssertionError):
        state_at(tmp_path / "s", 8, 2)


def test_a_wrong_manifest_is_refused(tmp_path: Path) -> None:
    RandomStream(make_shape(), 2, 6).write(tmp_path / "s")
    text = (tmp_path / "s" / "manifest.json").read_bytes()
    assert read_manifest(text) == make_shape()
    text = text.replace(b"0.05000000074505806", b"0.05")
    for old, new in (
        (b"[9, 5]", b"[9, 4]"),
        (b"[9, 5]", b"[14]"),
        (b"[9, 5]", b"[14, 0]"),
        (b"[9, 5]", b"[9, 5.0]"),
        (b'"slots"', b'"slot"'),
        (b"0.05", b"0"),
        (b"0.05", b"NaN"),
        (b"0.05", b"1e7"),
        (b'_base": -3.0', b'_base": -1001'),
        (b'_base": -3.0', b'_base": NaN'),
        (b'_base": -3.0', b'_base": null'),
        (b"log_scale_base", b"log_scale_bas"),
        (b": 256", b": 257"),
        (b'"position_m"', b'"position"'),
        (b'"version": 2', b'"version": 1'),
    ):
        assert old in text
        with pytest.raises(AssertionError):
            read_manifest(text.replace(old, new, 1))


def test_a_segment_of_too_many_slots_is_refused() -> None:
    """So that the masks of a segment fit memory."""
    rows = {"position_m": 1, "log_scale": 1, "log_scale_base": 0, "rotation": 1, "colour": 1}
    manifest = {
        "version": 2,
        "profile": "lattice",
        "swin_size": 2,
        "num_gs": 2 * 2**17,
        "segment_frames": 2**11,
        "sh_degree": 0,
        "slots": [2**17],
        "lattice": [{**rows, "opacity_levels": 2}],
    }
    read_manifest(json.dumps(manifest).encode())
    manifest["segment_frames"] = 2**11 + 1
    with pytest.raises(AssertionError):
        read_manifest(json.dumps(manifest).encode())
