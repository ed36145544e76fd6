"""codec.slots and the plain implementation of tests/goldens, which was written from FORMAT.md
alone, decode the same bytes to the same integers and bits, and refuse the same bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.goldens.decoder import Shape
from tests.goldens.folder import largest_content
from tests.support.slots.plain import (
    BothReaders,
    Chunks,
    encoded_chunks,
    layout_of,
    make_shape,
    spelled_out,
    try_keyframe,
)
from tests.support.slots.updates import patternless_updates

NUM_FRAMES = 14

shapes = st.builds(
    make_shape,
    swin_size=st.sampled_from([1, 2, 3]),
    segment_frames=st.sampled_from([1, 3, 5, 9]),
    k=st.sampled_from([1, 4]),
    slots=st.sampled_from([(1,), (9,), (6, 5), (1, 4, 3)]),
)
seeds = st.integers(0, 1 << 32)


@st.composite
def streams(draw: st.DrawFn) -> tuple[Shape, Chunks]:
    """A stream, possibly with the packets that a writer may omit."""
    shape, calm = draw(shapes), draw(st.sampled_from([1, 1, 20]))
    chunks = chunks_of(shape, draw(seeds), wild=draw(st.booleans()), calm=calm)
    return shape, spelled_out(shape, chunks) if draw(st.booleans()) else chunks


def chunks_of(shape: Shape, seed: int, wild: bool = False, calm: int = 1) -> Chunks:
    layout = layout_of(shape)
    return encoded_chunks(layout, patternless_updates(layout, NUM_FRAMES, seed, wild, calm))


@given(shapes)
@settings(max_examples=25)
def test_both_bound_a_chunk_alike(shape: Shape) -> None:
    layout = layout_of(shape)
    assert layout.max_skip_map_bytes == largest_content("skipmaps", shape)
    for layer in range(layout.num_layers):
        assert layout.max_change_bytes(layer) == largest_content(f"{layer}", shape)
        assert layout.max_keyframe_bytes(layer) == largest_content(f"keyframe-{layer}", shape)


@given(streams(), st.data())
@settings(max_examples=25)
def test_a_join_at_any_segment(stream: tuple[Shape, Chunks], data: st.DataObject) -> None:
    shape, chunks = stream
    first = data.draw(st.sampled_from(sorted(chunks.keyframes)))
    layers = data.draw(st.integers(1, len(shape.slots)))
    both = BothReaders(shape, layers)
    for keyframe in chunks.keyframes[first][:layers]:
        both.load(keyframe)
    both.check()
    for birth in range(first + 1, NUM_FRAMES):
        both.apply(birth, chunks.skip_maps[birth], chunks.changes[birth][:layers])


@given(streams(), seeds)
@settings(max_examples=20)
def test_who_lacks_something_holds_the_same(stream: tuple[Shape, Chunks], seed: int) -> None:
    """Packets that arrive late or never; skip maps that never arrive; keyframes of some layers,
    some of them late."""
    (shape, chunks), rng = stream, np.random.default_rng(seed)
    missing_skip_map, missing_change = rng.choice([0, 0, 0.2]), rng.choice([0.1, 0.4, 0.6])
    both = BothReaders(shape)
    waiting: list[tuple[int, int]] = []
    absent = {layer for layer in range(1, len(shape.slots)) if rng.random() < 0.3}
    for layer, keyframe in enumerate(chunks.keyframes[0]):
        if layer not in absent:
            both.load(keyframe)
    both.check()
    for birth in range(1, NUM_FRAMES):
        changes: list[bytes | None] = []
        for layer, change in enumerate(chunks.changes[birth]):
            lacks = layer in absent or rng.random() < missing_change
            changes.append(None if lacks else change)
            if lacks:
                waiting.append((birth, layer))
        both.apply(
            birth, None if rng.random() < missing_skip_map else chunks.skip_maps[birth], changes
        )
        for keyframe in chunks.keyframes.get(birth, []):
            if rng.random() < 0.4:
                both.load(keyframe)
        both.check()
        for layer in [layer for layer in absent if rng.random() < 0.3]:
            absent.remove(layer)
            both.load(chunks.keyframes[birth - birth % shape.segment_frames][layer])
            both.check()
        rng.shuffle(waiting)
        for late_birth, layer in waiting[: rng.integers(0, len(waiting) + 1)]:
            waiting.remove((late_birth, layer))
            assert both.late(late_birth, layer, chunks.changes[late_birth][layer])


@given(streams(), seeds)
@settings(max_examples=15)
def test_a_reader_that_takes_wrong_changes_late(stream: tuple[Shape, Chunks], seed: int) -> None:
    """An accepted wrong change makes later ones wrong, whether they arrived before it or after."""
    (shape, chunks), rng = stream, np.random.default_rng(seed)
    both = BothReaders(shape)
    waiting: list[tuple[int, int]] = []
    for keyframe in chunks.keyframes[0]:
        both.load(keyframe)
    for birth in range(1, NUM_FRAMES):
        changes: list[bytes | None] = [*chunks.changes[birth]]
        for lacking in np.flatnonzero(rng.random(len(changes)) < 0.3).tolist():
            changes[lacking] = None
            waiting.append((birth, lacking))
        both.apply_what_fits(birth, chunks.skip_maps[birth], changes)
        rng.shuffle(waiting)
        for late_birth, layer in waiting[: rng.integers(0, 3)]:
            change = chunks.changes[late_birth][layer]
            (wrong,) = mutants(change, rng, 1)
            if rng.random() < 0.5:
                wrong = other_opacities(change, shape, rng)
            if both.late(late_birth, layer, wrong):
                waiting.remove((late_birth, layer))


def other_opacities(change: bytes, shape: Shape, rng: np.random.Generator) -> bytes:
    """`change` with other opacities of new Gaussians, so that predictions from them fail."""
    if not change:
        return change
    predicted, new, long = struct.unpack_from("<3I", change, 12)
    num_planes = 10 + 3 * shape.num_coefficients
    end = 32 + num_planes * (predicted + new) + 4 * long
    levels = min(lattice.opacity_levels for lattice in shape.lattice)
    opacities: bytes = rng.integers(0, levels, new).astype(np.uint8).tobytes()
    return change[: end - new] + opacities + change[end:]


def mutants(data: bytes, rng: np.random.Generator, count: int) -> Iterator[bytes]:
    """`data` with some bytes altered, mostly at the front; sometimes longer or shorter."""
    for _ in range(count):
        wrong = bytearray(data or rng.bytes(int(rng.integers(1, 40))))
        for _ in range(rng.integers(1, 3)):
            place = rng.integers(len(wrong) if rng.random() < 0.7 else min(len(wrong), 40))
            near = (wrong[place] + int(rng.integers(-2, 3))) % 256
            wrong[place] = rng.choice([near, wrong[place] ^ 1 << int(rng.integers(8)), 0, 255])
        kind = rng.random()
        if kind < 0.05:
            del wrong[rng.integers(len(wrong)) :]
        elif kind < 0.1:
            wrong += rng.bytes(int(rng.integers(1, 5)))
        yield bytes(wrong)


@pytest.mark.parametrize("count", [2, pytest.param(40, marks=pytest.mark.deep)])
@given(stream=streams(), seed=seeds)
@settings(max_examples=10)
def test_both_refuse_the_same_slices(stream: tuple[Shape, Chunks], seed: int, count: int) -> None:
    (shape, chunks), rng = stream, np.random.default_rng(seed)
    both = BothReaders(shape)
    for keyframe in chunks.keyframes[0]:
        if rng.random() < 0.7 or both.decoder.frame is None:
            both.load(keyframe)
    for birth in range(1, NUM_FRAMES):
        skip_map, changes = chunks.skip_maps[birth], chunks.changes[birth]
        assert both.try_slice(birth, skip_map, changes)
        for wrong in mutants(skip_map, rng, count):
            if both.try_skip_map(birth, wrong):
                both.try_slice(birth, wrong, [None] * len(changes))
                both.try_slice(birth, wrong, changes)
        for layer, change in enumerate(changes):
            for wrong in mutants(change, rng, count):
                both.try_slice(birth, skip_map, [*changes[:layer], wrong, *changes[layer + 1 :]])
        here = [None if rng.random() < 0.1 else change for change in changes]
        both.apply(birth, skip_map, here)


@given(streams(), seeds)
@settings(max_examples=10)
def test_both_refuse_the_same_keyframes(stream: tuple[Shape, Chunks], seed: int) -> None:
    (shape, chunks), rng = stream, np.random.default_rng(seed)
    for keyframes in chunks.keyframes.values():
        for keyframe in keyframes:
            assert try_keyframe(shape, keyframe)
            for wrong in mutants(keyframe, rng, 10):
                try_keyframe(shape, wrong)


def test_mutants_are_taken_and_refused() -> None:
    """Both outcomes occur, so that the tests above cover both."""
    shape, rng = make_shape(), np.random.default_rng(0)
    chunks = chunks_of(shape, 3)
    both = BothReaders(shape)
    for keyframe in chunks.keyframes[0]:
        both.load(keyframe)
    skip_maps = [both.try_skip_map(1, wrong) for wrong in mutants(chunks.skip_maps[1], rng, 200)]
    slices = [
        both.try_slice(1, chunks.skip_maps[1], [wrong, None])
        for wrong in mutants(chunks.changes[1][0], rng, 200)
    ]
    keyframes = [try_keyframe(shape, wrong) for wrong in mutants(chunks.keyframes[0][0], rng, 200)]
    for taken in (skip_maps, slices, keyframes):
        assert 20 < sum(taken) < 280


def test_counts_and_escapes_that_both_refuse() -> None:
    """Every count of a change is set one higher, one lower and huge, the others unchanged."""
    shape = make_shape(swin_size=1, slots=(12,))
    for seed in range(6):
        chunks = spelled_out(shape, chunks_of(shape, seed))
        both = BothReaders(shape)
        both.load(chunks.keyframes[0][0])
        for birth in (1, 2):
            skip_map, change = chunks.skip_maps[birth], chunks.changes[birth][0]
            counts = struct.unpack_from("<5I", change, 12)
            for at, count in enumerate(counts):
                for other in (count + 1, max(count - 1, 0), 0, 1 << 31, (1 << 32) - 1):
                    wrong = [*counts[:at], other, *counts[at + 1 :]]
                    data = change[:12] + struct.pack("<5I", *wrong) + change[32:]
                    assert both.try_slice(birth, skip_map, [data]) == (other == count)
            both.apply(birth, skip_map, [change])
