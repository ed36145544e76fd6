"""Frames that a player assembles from a source, one by one, without a clock."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from codec.framerange import FrameRange
from codec.slice import Slice
from codec.stream import StreamReader
from codec.stream.manifest import SKIP_MAPS, Part, keyframe_part
from player.playout.assembler import Assembler
from player.playout.timeline import PlayedMedia
from player.source.opener import opened
from player.source.source import Packets, SlicePackets, Source
from server.abr.holding import Holding
from tests.support.drawn import same_splats
from tests.support.slots.slot_streams import Shown


@dataclass(frozen=True)
class Assembled:
    """A frame, and the data that it uses."""

    frame: int
    slices: list[Slice]
    layers: int
    """Number of complete layers."""
    wire_bytes: int


def assembled(source: Source) -> Iterator[Assembled]:
    """Every frame of `source`, as soon as its layer 0 has arrived."""
    media, frame = PlayedMedia(source.manifest), source.frames.first
    here = Holding(media, frame, 1 if source.adaptive else source.num_layers)
    assembler = Assembler(source.manifest, source.num_layers, frame)
    waiting: list[Packets] = []
    for one in source.packets():
        waiting.append(one)
        one.add_to(here)
        while frame < here.end_frame:
            used = [p for p in waiting if p.first_frame <= frame]
            waiting = [p for p in waiting if p.first_frame > frame]
            slices = assembler.assemble(frame, used)
            yield Assembled(
                frame, slices, here.whole_layers(frame), sum(p.wire_bytes for p in used)
            )
            frame += 1


def checked(reader: StreamReader, frames: Iterable[Assembled], layers: int) -> Iterator[Assembled]:
    """Yields `frames`; checks that they are consecutive, and that each shows the first `layers`
    layers of the stream."""
    shown, last = Shown(reader.manifest), None
    for one in frames:
        assert last is None or one.frame == last + 1
        last = one.frame
        splats = shown.after(one.slices, last)
        assert same_splats(splats, reader.active_splats(last, layers))
        yield one


def check_packets(reader: StreamReader, one: Packets) -> None:
    """Each packet of `one` has to be that of the stream."""
    birth, is_slice = one.first_frame, isinstance(one, SlicePackets)
    segment = reader.manifest.segment_of(birth)
    for layer, packet in enumerate(one.packets, one.first_layer):
        part: Part = layer if is_slice else keyframe_part(layer)
        assert packet == reader.read_object(segment, part).packet(birth)
    if isinstance(one, SlicePackets):
        skip_map = None if one.first_layer else reader.read_object(segment, SKIP_MAPS).packet(birth)
        assert one.skip_map == skip_map


def read_all(
    source: str, frames: FrameRange | None = None, layers: int | None = None
) -> list[Assembled]:
    """Every frame of the stream that `source` names."""
    with opened(source, frames, layers) as found:
        return list(assembled(found))


def slices_of(frames: list[Assembled]) -> list[Slice]:
    """All slices of `frames`, in order."""
    return [slice for one in frames for slice in one.slices]
