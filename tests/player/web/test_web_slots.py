"""The browser decodes slots to the same integers and bits as the package."""

from __future__ import annotations

import random
from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
import pytest

from codec.errors import CodecError
from codec.foreign.ply import encode_ply
from codec.slots.slotdecoder import SlotDecoder
from codec.slots.slotlayout import SlotLayout
from codec.stream.reader import StreamReader
from tests.goldens.folder import StreamFolder
from tests.goldens.statehash import state_sha256
from tests.goldens.suite import FOLDER, read_order, read_table
from tests.support.slots.hostile_slots import altered
from tests.support.slots.plain import Chunks, encoded_chunks, held, layout_of
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
            assert slots.load(stream.chunks(segment, f"snapshot-{layer}")[first])
        for frame in range(first, stream.num_frames):
            at = frame // layout.segment_frames
            if frame > first:
                changes = [stream.chunks(at, f"{layer}")[frame] for layer in layers]
                slots.apply(frame, stream.chunks(at, "masks")[frame], changes)
            assert row["state_sha256"][frame][num_layers - 1] in (None, state_sha256(slots.held()))
        shown = StreamReader(stream.folder).active_splats(frame, num_layers)
        assert bytes.fromhex(browser.ask("ply")) == encode_ply(shown)


@pytest.mark.parametrize("row", ORDERS)
def test_an_order_of_the_conformance_suite(browser: BrowserCode, row: dict[str, Any]) -> None:
    arrivals, wanted = read_order(row)
    found = BrowserSlots(browser, arrivals.layout).played(arrivals)
    assert list(map(state_sha256, found)) == wanted


@pytest.mark.parametrize("seed", range(24))
def test_who_lacks_something_holds_the_same(browser: BrowserCode, seed: int) -> None:
    """Packets that arrive late or never; masks that never arrive; snapshots of some layers, some of
    them late; altered bytes."""
    rng, random_bytes = np.random.default_rng(seed), random.Random(seed)
    slots_of_layers = ((1,), (9,), (6, 5), (1, 4, 3))[seed % 4]
    layout = small_layout(1 + seed % 3, slots_of_layers, seed % 2, (1, 3, 5, 9)[seed // 6])
    chunks = encoded_chunks(layout, patternless_updates(layout, NUM_FRAMES, seed, seed % 5 > 1))
    ours = SlotDecoder(layout)
    theirs = BrowserSlots(browser, layout)
    absent = {layer for layer in range(1, len(slots_of_layers)) if rng.random() < 0.3}
    for layer, snapshot in enumerate(chunks.snapshots[0]):
        if layer not in absent:
            assert theirs.load(snapshot) == ours.load(snapshot)
    waiting: list[tuple[int, int]] = []
    for birth in range(1, NUM_FRAMES):
        mask = None if rng.random() < 0.1 else chunks.masks[birth]
        changes: list[bytes | None] = []
        for layer, change in enumerate(chunks.changes[birth]):
            lacks = layer in absent or rng.random() < 0.25
            changes.append(None if lacks else change)
            if lacks:
                waiting.append((birth, layer))
        offers = [(mask, changes), (None, changes)]
        if mask is not None:
            torn = [change and altered(change, random_bytes) for change in changes]
            offers.insert(0, (altered(mask, random_bytes), torn))
        # An altered chunk may fit, and then the correct one may not fit any more.
        assert any(both_apply(ours, theirs, birth, *offer) for offer in offers)
        assert theirs.held() == held(ours)
        for layer in [layer for layer in absent if rng.random() < 0.3]:
            absent.remove(layer)
            snapshot = chunks.snapshots[birth - birth % layout.segment_frames][layer]
            assert theirs.load(snapshot) == ours.load(snapshot)
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
    mask: bytes | None,
    changes: list[bytes | None],
) -> bool:
    """Whether the slice fits; both must agree."""
    try:
        rows = ours.apply(birth, mask, changes).rows
    except CodecError:
        with pytest.raises(CodecError):
            theirs.apply(birth, mask, changes)
        return False
    assert rows is not None
    assert theirs.apply(birth, mask, changes) == rows.tolist()
    return True


def begun(
    browser: BrowserCode, layout: SlotLayout, chunks: Chunks
) -> tuple[SlotDecoder, BrowserSlots]:
    """Decoders that have the first snapshots of `chunks`."""
    ours, theirs = SlotDecoder(layout), BrowserSlots(browser, layout)
    for snapshot in chunks.snapshots[0]:
        assert theirs.load(snapshot) == ours.load(snapshot)
    return ours, theirs


def passing_stream(seed: int) -> tuple[SlotLayout, Chunks]:
    period, slots_of_layers = 2 + seed % 3, ((7,), (6, 5), (1, 4, 3))[seed % 3]
    length = period * (1 + seed % 2)
    plain, layout = (small_layout(1, slots_of_layers, seed % 2, length, n) for n in (1, period))
    return layout, encoded_chunks(layout, patternless_updates(plain, NUM_FRAMES, seed, calm=3))


def refuses(decoder: SlotDecoder, birth: int, mask: bytes, changes: Sequence[bytes | None]) -> bool:
    try:
        decoder.copy().apply(birth, mask, changes)
    except CodecError:
        return True
    return False


@pytest.mark.parametrize("seed", range(12))
def test_passing_slices(browser: BrowserCode, seed: int) -> None:
    """Passing slices arrive, are missing or altered; with the next slice, and without."""
    rng, random_bytes = np.random.default_rng(seed), random.Random(seed)
    layout, chunks = passing_stream(seed)
    ours, theirs = begun(browser, layout, chunks)
    period = layout.temporal_period
    for birth in range(1, NUM_FRAMES):
        mask, changes = chunks.masks[birth], [*chunks.changes[birth]]
        come: list[bytes | None] = [
            None if rng.random() < 0.2 and (layer or birth % period) else change
            for layer, change in enumerate(changes)
        ]
        next_birth, ahead, wanted = layout.following(birth), None, None
        if birth % period and next_birth < NUM_FRAMES and rng.random() < 0.7:
            wanted = chunks.masks[next_birth], [*chunks.changes[next_birth]]
            ahead = next_birth, *wanted
        if come[-1] and rng.random() < 0.3:
            torn = [*come[:-1], altered(come[-1], random_bytes)]
            if refuses(ours, birth, mask, torn):
                with pytest.raises(CodecError):
                    theirs.apply(birth, mask, torn)
        rows = ours.apply(birth, mask, come, ahead=wanted).rows
        assert rows is not None
        assert sorted(theirs.apply(birth, mask, come, ahead)) == rows.tolist()
        assert theirs.held() == held(ours)


@pytest.mark.parametrize("seed", range(12))
def test_a_passing_slice_that_comes_late(browser: BrowserCode, seed: int) -> None:
    """While its frame shows, the slice completes the frame; later it has no effect."""
    rng, random_bytes = np.random.default_rng(seed), random.Random(seed)
    layout, chunks = passing_stream(seed)
    ours, theirs = begun(browser, layout, chunks)
    period, temporal = layout.temporal_period, layout.num_layers - 1
    was_late = False
    for birth in range(1, NUM_FRAMES):
        mask, changes = chunks.masks[birth], [*chunks.changes[birth]]
        next_birth, ahead = layout.following(birth), None
        if next_birth < NUM_FRAMES and rng.random() < 0.7:
            ahead = next_birth, chunks.masks[next_birth], [*chunks.changes[next_birth]]
        is_late = birth % period > 0 and rng.random() < 0.6
        come = [*changes[:-1], None] if is_late else changes
        torn = altered(changes[-1], random_bytes) if changes[-1] else b""
        is_torn = refuses(ours, birth, mask, [*changes[:-1], torn])
        found = theirs.apply(birth, mask, come, ahead)
        rows = ours.apply(birth, mask, changes).rows
        assert rows is not None
        if is_late:
            if is_torn:
                assert taken(theirs, birth, temporal, torn) == "refused"
            assert theirs.late(birth, temporal, changes[-1])
        else:  # the replacement of the previous one may have shown in other slots
            assert set(found) >= set(rows.tolist())
            assert was_late or set(found) == set(rows.tolist())
        assert theirs.held() == held(ours)
        assert not theirs.late(birth, temporal, changes[-1])
        assert not theirs.late(birth - 1, temporal, chunks.changes[birth - 1][-1])
        was_late = is_late


def test_a_damaged_slice_ahead_does_not_end_a_play(browser: BrowserCode) -> None:
    rng = random.Random(4)
    plain, layout = (small_layout(1, (6, 5), 0, 4, period) for period in (1, 2))
    chunks = encoded_chunks(layout, patternless_updates(plain, 5, 3, calm=1))
    come, moved = [*chunks.changes[1][:-1], None], []
    for _ in range(30):
        torn = [altered(change, rng) if change else change for change in chunks.changes[2]]
        found = []
        for ahead in (2, chunks.masks[2], torn), None:
            _, theirs = begun(browser, layout, chunks)
            theirs.apply(1, chunks.masks[1], come, ahead)
            found.append(theirs.held())
        moved.append(found[0] != found[1])
    assert not all(moved)


def test_a_paused_play_shows_a_passing_slice_that_comes_late(browser: BrowserCode) -> None:
    plain, layout = (small_layout(1, (6, 5), 0, 4, period) for period in (1, 2))
    chunks = encoded_chunks(layout, patternless_updates(plain, 5, 3, calm=1))
    ours, theirs = begun(browser, layout, chunks)
    ours.apply(1, chunks.masks[1], chunks.changes[1])
    events: list[list[object]] = [
        ["snapshot", 0, layer, snapshot.hex()] for layer, snapshot in enumerate(chunks.snapshots[0])
    ]
    events.append(["mask", 1, None, chunks.masks[1].hex()])
    changes = [["change", 1, layer, data.hex()] for layer, data in enumerate(chunks.changes[1])]
    events += [*changes[:-1], ["join", 1], ["look"], ["state"], changes[-1], ["look"], ["state"]]
    before, state, after, late_state = browser.ask("arrivals", events=events)
    assert state == [False, 2, 0]
    assert late_state == [True, 3, 0]
    assert before != after
    assert theirs.held() == held(ours)


@pytest.mark.parametrize("seed", range(8))
def test_an_altered_snapshot(browser: BrowserCode, seed: int) -> None:
    rng = random.Random(seed)
    layout = small_layout(1 + seed % 3, (7, 4), seed % 2, 4)
    chunks = encoded_chunks(layout, patternless_updates(layout, 5, seed, True))
    num_taken = 0
    for _ in range(60):
        data = altered(chunks.snapshots[0][rng.randrange(2)], rng)
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
