"""The order in which objects and packets arrive does not matter: what a player holds in the end is
what a plain reader holds that was given the same in the order of births."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.coders.coder import compress
from codec.errors import CodecError
from codec.stream.manifest import Part
from player.playout.slotassembler import SlotAssembler
from player.source.source import Packets, SlicePackets, SnapshotPackets
from tests.goldens.slots_cases import make_shape
from tests.goldens.slots_decoder import Shape
from tests.support.slots.arrivals import (
    TABLE,
    Arrivals,
    Change,
    Item,
    Mask,
    Show,
    Snapshot,
    make_arrivals,
)
from tests.support.slots.plain import Held, held
from tests.support.slots.slot_streams import slot_manifest


def blame(error: CodecError, part: Part) -> CodecError:
    return error


def packets_of(item: Item) -> Packets:
    packet = compress(item.chunk) if item.chunk else b""
    if isinstance(item, Snapshot):
        return SnapshotPackets(item.frame, item.layer, (packet,), blame)
    if isinstance(item, Mask):
        return SlicePackets(item.birth, 0, (), packet, blame)
    return SlicePackets(item.birth, item.layer, (packet,), None, blame)


def played(arrivals: Arrivals) -> list[Held]:
    """What the player holds each time that a segment has been shown."""
    manifest = slot_manifest(arrivals.layout)
    assembler = SlotAssembler(manifest, manifest.num_layers, arrivals.join_frame)
    waiting: list[Packets] = []
    found, frame = [], -1
    for event in arrivals.events:
        if isinstance(event, Mask | Change | Snapshot):
            waiting.append(packets_of(event))
            continue
        if isinstance(event, Show):
            frame = event.frame
        assembler.take(frame, [one for one in waiting if one.first_frame <= frame])
        waiting = [one for one in waiting if one.first_frame > frame]
        if not isinstance(event, Show):
            found.append(held(assembler._decoder))
    return found


@pytest.mark.parametrize("arrivals", TABLE, ids=range(len(TABLE)))
def test_a_case_of_the_table(arrivals: Arrivals) -> None:
    assert played(arrivals) == arrivals.expected()


@given(
    st.builds(
        make_shape,
        swin_size=st.sampled_from([1, 2, 3]),
        segment_frames=st.sampled_from([3, 5, 9, 14]),
        k=st.sampled_from([1, 4]),
        slots=st.sampled_from([(9,), (6, 5), (1, 4, 3)]),
    ),
    st.integers(0, 1 << 32),
)
@settings(max_examples=60)
def test_any_order_ends_in_the_same_slots(shape: Shape, seed: int) -> None:
    arrivals = make_arrivals(shape, seed)
    assert played(arrivals) == arrivals.expected()
