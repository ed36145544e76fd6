"""What a player makes of a source, frame by frame, without a clock."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from codec.framerange import FrameRange
from codec.slice import Slice
from player.playout.assembler import open_assembler
from player.playout.timeline import PlayedMedia
from player.source.opener import opened
from player.source.source import Packets, Source
from server.abr.slotholding import open_holding


@dataclass(frozen=True)
class Assembled:
    """A frame, and what it takes in."""

    frame: int
    slices: list[Slice]
    layers: float
    """That show."""
    wire_bytes: int


def assembled(source: Source) -> Iterator[Assembled]:
    """Every frame of `source`, as soon as layer 0 of it has come."""
    media, frame = PlayedMedia(source.manifest), source.frames.first
    here = open_holding(media, frame, 1 if source.adaptive else source.num_layers)
    assembler = open_assembler(source.manifest, source.num_layers, frame)
    waiting: list[Packets] = []
    for one in source.packets():
        waiting.append(one)
        one.add_to(here)
        while frame < here.end_frame:
            used = [p for p in waiting if p.first_frame <= frame]
            waiting = [p for p in waiting if p.first_frame > frame]
            slices = assembler.take(frame, used)
            yield Assembled(frame, slices, here.layers(frame), sum(p.wire_bytes for p in used))
            frame += 1


def read_all(
    source: str, frames: FrameRange | None = None, layers: int | None = None
) -> list[Assembled]:
    """Every frame of what `source` names."""
    with opened(source, frames, layers) as found:
        return list(assembled(found))


def slices_of(frames: list[Assembled]) -> list[Slice]:
    """All their slices, in order."""
    return [slice for one in frames for slice in one.slices]
