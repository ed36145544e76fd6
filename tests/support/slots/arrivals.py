"""Orders in which the objects and packets of a play arrive, some never, and the resulting slots.

A case is a list of events. An item arrives at any time before its segment has been shown, or never.
Only items that a frame needs to be shown are always in time: its skip map, its change of layer 0,
and, in the segment where the play joins, the keyframe of layer 0."""

from __future__ import annotations

import random
from dataclasses import dataclass, replace

import numpy as np

from codec.coders.zstd import compress
from codec.errors import CodecError
from codec.slots.slotlayout import SlotLayout
from codec.slots.state import decode_keyframe
from codec.stream.manifest import Part
from player.playout.assembler import Assembler
from player.source.source import KeyframePackets, Packets, SlicePackets
from tests.goldens.decoder import Shape
from tests.goldens.reader import Reader
from tests.support.slots.hostile_slots import altered
from tests.support.slots.plain import Chunks, Held, encoded_chunks, held, layout_of, plainly_held
from tests.support.slots.slot_streams import slot_manifest
from tests.support.slots.updates import patternless_updates

NUM_FRAMES = 14


@dataclass(frozen=True)
class SkipMap:
    birth: int
    chunk: bytes


@dataclass(frozen=True)
class Change:
    birth: int
    layer: int
    chunk: bytes


@dataclass(frozen=True)
class Keyframe:
    frame: int
    layer: int
    chunk: bytes


@dataclass(frozen=True)
class Show:
    """The play shows `frame`; its first one is the frame at which it joins."""

    frame: int


@dataclass(frozen=True)
class Look:
    """The end of a segment, after its last arrival: the slots are compared."""


Item = SkipMap | Change | Keyframe
Event = Item | Show | Look


@dataclass(frozen=True)
class Arrivals:
    """A case: a stream, and the events of a play."""

    shape: Shape
    join_frame: int
    events: list[Event]

    @property
    def layout(self) -> SlotLayout:
        return layout_of(self.shape)

    def expected(self) -> list[Held]:
        """The slots at each Look of a plain reader that gets the items so far in order of birth."""
        arrived: list[Item] = []
        found, frame = [], 0
        for event in self.events:
            if isinstance(event, Show):
                frame = event.frame
            elif isinstance(event, Look):
                found.append(self._in_order(arrived, frame))
            else:
                arrived.append(event)
        return found

    def _in_order(self, arrived: list[Item], frame: int) -> Held:
        reader, shape = Reader(self.shape), self.shape
        first = self.join_frame - self.join_frame % shape.segment_frames
        skip_maps = {item.birth: item.chunk for item in arrived if isinstance(item, SkipMap)}
        changes = [item for item in arrived if isinstance(item, Change)]
        keyframes = [item for item in arrived if isinstance(item, Keyframe)]
        for birth in range(first, frame + 1):
            if birth > first:
                mine = {item.layer: item.chunk for item in changes if item.birth == birth}
                reader.apply(birth, skip_maps[birth], mine)
            for keyframe in keyframes:
                if keyframe.frame == birth:
                    reader.load(keyframe.chunk)
        return plainly_held(reader, frame, len(shape.slots))


def make_arrivals(shape: Shape, seed: int) -> Arrivals:
    """A case with a stream of random updates."""
    layout = layout_of(shape)
    updates = patternless_updates(layout, NUM_FRAMES, seed, wild=True, calm=5)
    return arrivals_of(shape, encoded_chunks(layout, updates), seed)


def arrivals_of(shape: Shape, chunks: Chunks, seed: int, altered_share: float = 0.0) -> Arrivals:
    """A case in which each item of `chunks` is lost or arrives at a random time. A share of the
    items that no frame needs arrives with altered bytes."""
    rng, random_bytes = np.random.default_rng(seed), random.Random(seed)
    num_frames = len(chunks.skip_maps)
    join = int(rng.integers(0, num_frames))
    lost = float(rng.choice([0.0, 0.1, 0.4]))
    timed: list[tuple[float, Event]] = []
    for first in range(join - join % shape.segment_frames, num_frames, shape.segment_frames):
        end = min(first + shape.segment_frames, num_frames)
        timed.append((end - 0.5, Look()))
        timed += [(frame, Show(frame)) for frame in range(max(first, join), end)]
        for item, due_s in _items(chunks, first, end, first <= join):
            if due_s is not None:
                timed.append((float(rng.uniform(first - 2, max(due_s, join))), item))
            elif rng.random() >= lost:
                if rng.random() < altered_share:
                    other = replace(item, chunk=altered(item.chunk, random_bytes))
                    # A readable one contradicts a complete layer, so that a reader may skip it.
                    if first <= join or not _is_keyframe(shape, other):
                        item = other
                timed.append((float(rng.uniform(first - 2, end - 0.5)), item))
    return Arrivals(shape, join, [event for _, event in sorted(timed, key=lambda one: one[0])])


def _is_keyframe(shape: Shape, item: Item) -> bool:
    """Whether `item` is a readable keyframe."""
    if not isinstance(item, Keyframe):
        return False
    try:
        decode_keyframe(layout_of(shape), item.chunk)
    except CodecError:
        return False
    return True


def _items(
    chunks: Chunks, first: int, end: int, is_joined: bool
) -> list[tuple[Item, float | None]]:
    """All items of a segment, each with the frame that cannot be shown without it, if any."""
    items: list[tuple[Item, float | None]] = []
    for layer, chunk in enumerate(chunks.keyframes[first]):
        items.append((Keyframe(first, layer, chunk), first if is_joined and not layer else None))
    for birth in range(first + 1 if is_joined else first, end):
        items.append((SkipMap(birth, chunks.skip_maps[birth]), birth))
        for layer, chunk in enumerate(chunks.changes[birth]):
            items.append((Change(birth, layer, chunk), None if layer else birth))
    return items


def _blame(error: CodecError, part: Part) -> CodecError:
    return error


def _packets_of(item: Item) -> Packets:
    packet = compress(item.chunk) if item.chunk else b""
    if isinstance(item, Keyframe):
        return KeyframePackets(item.frame, item.layer, (packet,), _blame)
    if isinstance(item, SkipMap):
        return SlicePackets(item.birth, 0, (), packet, _blame)
    return SlicePackets(item.birth, item.layer, (packet,), None, _blame)


def played(arrivals: Arrivals) -> list[Held]:
    """The state of the player after each segment."""
    manifest = slot_manifest(arrivals.layout)
    assembler = Assembler(manifest, manifest.num_layers, arrivals.join_frame)
    waiting: list[Packets] = []
    found, frame = [], -1
    for event in arrivals.events:
        if isinstance(event, SkipMap | Change | Keyframe):
            waiting.append(_packets_of(event))
            continue
        if isinstance(event, Show):
            frame = event.frame
        assembler.assemble(frame, [one for one in waiting if one.first_frame <= frame])
        waiting = [one for one in waiting if one.first_frame > frame]
        if not isinstance(event, Show):
            found.append(held(assembler._decoder))
    return found
