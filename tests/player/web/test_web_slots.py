"""The browser decodes slots to the same integers and bits as the package."""

from __future__ import annotations

import random
from itertools import product
from typing import Any

import numpy as np
import pytest

from codec.errors import CodecError
from codec.foreign.ply import encode_ply
from codec.slots.decoder import SlotDecoder
from codec.stream.reader import StreamReader
from tests.goldens.folder import StreamFolder
from tests.goldens.statehash import state_sha256
from tests.goldens.suite import FOLDER, read_order, read_table
from tests.support.slots.hostile_slots import altered
from tests.support.slots.plain import encoded_chunks, held, layout_of
from tests.support.slots.updates import patternless_updates, small_layout
from tests.support.web.browsercode import BrowserCode, BrowserSlots

STREAMS, ORDERS = map(read_table, ("streams.json", "orders.json"))
NUM_FRAMES = 14


@pytest.mark.parametrize("row", STREAMS, ids=lambda row: row["stream"])
def test_a_stream_of_the_conformance_suite(browser: BrowserCode, row: dict[str, Any]) -> None:
    """The stream is joined at every segment and played to its end, with each number of layers."""
    stream = StreamFolder(FOLDER / row["stream"])
    layout = layout_of(stream.shape)
    for num_layers, segment in product(range(1, len(layout.slots) + 1), range(len(stream.index))):
        slots, layers = BrowserSlots(browser, layout, num_layers), range(num_layers)
        first = segment * layout.segment_frames
        for layer in layers:
            assert slots.load(stream.chunks(segment, f"keyframe-{layer}")[first])
        for frame in range(first, stream.num_frames):
            at = frame // layout.segment_frames
            if frame > first:
                changes = [stream.chunks(at, f"{layer}")[frame] for layer in layers]
                slots.apply(frame, stream.chunks(at, "skipmaps")[frame], changes)
            assert row["state_sha256"][frame][num_layers - 1] == state_sha256(slots.held())
        shown = StreamReader(stream.folder).active_splats(frame, num_layers)
        assert bytes.fromhex(browser.ask("ply")) == encode_ply(shown)


@pytest.mark.parametrize("row", ORDERS)
def test_an_order_of_the_conformance_suite(browser: BrowserCode, row: dict[str, Any]) -> None:
    arrivals, wanted = read_order(row)
    found = BrowserSlots(browser, arrivals.layout).played(arrivals)
    assert list(map(state_sha256, found)) == wanted


@pytest.mark.parametrize("seed", range(24))
def test_who_lacks_something_holds_the_same(browser: BrowserCode, seed: int) -> None:
    """Packets that arrive late or never; skip maps that never arrive; keyframes of some layers,
    some of them late; altered bytes."""
    rng, random_bytes = np.random.default_rng(seed), random.Random(seed)
    slots_of_layers = ((1,), (9,), (6, 5), (1, 4, 3))[seed % 4]
    layout = small_layout(1 + seed % 3, slots_of_layers, seed % 2, (1, 3, 5, 9)[seed // 6])
    chunks = encoded_chunks(layout, patternless_updates(layout, NUM_FRAMES, seed, seed % 5 > 1))
    ours = SlotDecoder(layout)
    theirs = BrowserSlots(browser, layout)
    absent = {layer for layer in range(1, len(slots_of_layers)) if rng.random() < 0.3}
    for layer, keyframe in enumerate(chunks.keyframes[0]):
        if layer not in absent:
            assert theirs.load(keyframe) == ours.load(keyframe)
    waiting: list[tuple[int, int]] = []
    for birth in range(1, NUM_FRAMES):
        skip_map = None if rng.random() < 0.1 else chunks.skip_maps[birth]
        changes: list[bytes | None] = []
        for layer, change in enumerate(chunks.changes[birth]):
            lacks = layer in absent or rng.random() < 0.25
            changes.append(None if lacks else change)
            if lacks:
                waiting.append((birth, layer))
        offers = [(skip_map, changes), (None, changes)]
        if skip_map is not None:
            torn = [change and altered(change, random_bytes) for change in changes]
            offers.insert(0, (altered(skip_map, random_bytes), torn))
        # An altered chunk may fit, and then the correct one may not fit any more.
        assert any(both_apply(ours, theirs, birth, *offer) for offer in offers)
        assert theirs.held() == held(ours)
        for layer in [layer for layer in absent if rng.random() < 0.3]:
            absent.remove(layer)
            keyframe = chunks.keyframes[birth - birth % layout.segment_frames][layer]
            assert theirs.load(keyframe) == ours.load(keyframe)
            assert theirs.held() == held(ours)
        rng.shuffle(waiting)
        for late_birth, layer in waiting[: rng.integers(0, len(waiting) + 1)]:
            change = chunks.changes[late_birth][layer]
            assert taken(theirs, late_birth, layer, change) == taken(
                ours, late_birth, layer, change
            )
            assert theirs.held() == held(ours)


def taken(decoder: SlotDecoder | BrowserSlots, birth: int, layer: int, change: bytes) -> bool | str:
    try:
        return decoder.late(birth, layer, change)
    except CodecError:
        return "refused"


def both_apply(
    ours: SlotDecoder,
    theirs: BrowserSlots,
    birth: int,
    skip_map: bytes | None,
    changes: list[bytes | None],
) -> bool:
    """Whether the slice fits; both must agree."""
    try:
        rows = ours.apply(birth, skip_map, changes).rows
    except CodecError:
        with pytest.raises(CodecError):
            theirs.apply(birth, skip_map, changes)
        return False
    assert rows is not None
    assert theirs.apply(birth, skip_map, changes) == rows.tolist()
    return True


@pytest.mark.parametrize("seed", range(8))
def test_an_altered_keyframe(browser: BrowserCode, seed: int) -> None:
    rng = random.Random(seed)
    layout = small_layout(1 + seed % 3, (7, 4), seed % 2, 4)
    chunks = encoded_chunks(layout, patternless_updates(layout, 5, seed, True))
    num_taken = 0
    for _ in range(60):
        data = altered(chunks.keyframes[0][rng.randrange(2)], rng)
        ours, theirs = SlotDecoder(layout), BrowserSlots(browser, layout)
        try:
            ours.load(data)
        except CodecError:
            with pytest.raises(CodecError):
                theirs.load(data)
        else:
            theirs.load(data)
            assert theirs.held() == held(ours)
            num_taken += 1
    assert 5 < num_taken < 55
