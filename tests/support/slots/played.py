"""The state of a player that receives the objects and packets of a play in some order."""

from __future__ import annotations

from codec.coders.coder import compress
from codec.errors import CodecError
from codec.stream.manifest import Part
from player.playout.assembler import Assembler
from player.source.source import Packets, SlicePackets, SnapshotPackets
from tests.support.slots.arrivals import Arrivals, Change, Item, Mask, Show, Snapshot
from tests.support.slots.plain import Held, held
from tests.support.slots.slot_streams import slot_manifest


def _blame(error: CodecError, part: Part) -> CodecError:
    return error


def _packets_of(item: Item) -> Packets:
    packet = compress(item.chunk) if item.chunk else b""
    if isinstance(item, Snapshot):
        return SnapshotPackets(item.frame, item.layer, (packet,), _blame)
    if isinstance(item, Mask):
        return SlicePackets(item.birth, 0, (), packet, _blame)
    return SlicePackets(item.birth, item.layer, (packet,), None, _blame)


def played(arrivals: Arrivals) -> list[Held]:
    """The state of the player after each segment."""
    manifest = slot_manifest(arrivals.layout)
    assembler = Assembler(manifest, manifest.num_layers, arrivals.join_frame)
    waiting: list[Packets] = []
    found, frame = [], -1
    for event in arrivals.events:
        if isinstance(event, Mask | Change | Snapshot):
            waiting.append(_packets_of(event))
            continue
        if isinstance(event, Show):
            frame = event.frame
        assembler.assemble(frame, [one for one in waiting if one.first_frame <= frame])
        waiting = [one for one in waiting if one.first_frame > frame]
        if not isinstance(event, Show):
            found.append(held(assembler._decoder))
    return found
