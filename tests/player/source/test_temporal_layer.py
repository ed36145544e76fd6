"""A stream with a temporal layer: it is the first to be left out, and without it Gaussians that go
on are interpolated."""

from __future__ import annotations

from pathlib import Path

import pytest

from codec.framerange import FrameRange
from codec.stream import StreamReader, StreamWriter
from player.playout.assembler import Assembler
from player.playout.timeline import Playout
from player.source.hostedplay import HostedPlay
from player.source.opener import opened
from player.source.source import SlicePackets
from tests.player.source.test_hosted_play import MadeLink, need_bps
from tests.support.drawn import same_splats
from tests.support.slots.slot_streams import Shown, busy_updates, slot_manifest
from tests.support.slots.updates import small_layout

NUM_FRAMES, FPS, TEMPORAL = 80, 30.0, 2
"""Number of frames, frames per second, and number of the temporal layer."""

QUALITY_DB = 30.0, 33.0, 33.5
"""Quality in the index; the temporal layer adds half a decibel, as in the demo."""


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("root")
    layout = small_layout(1, (60, 60), 0, 20, 2)
    manifest = slot_manifest(layout, fps=FPS)
    with StreamWriter.create(path / "s", manifest, quality=lambda *_: QUALITY_DB) as writer:
        for update in busy_updates(layout, NUM_FRAMES):
            writer.append(update)
    return path


@pytest.fixture(scope="module")
def reader(root: Path) -> StreamReader:
    return StreamReader(root / "s")


def played(playout: Playout, assembler: Assembler, reader: StreamReader, layers: int) -> int:
    """Plays everything in `playout`; returns the number of frames."""
    shown, count = Shown(reader.manifest), 0
    while (due := playout.pop_due()) is not None:
        frame = due.record.frame
        slices = assembler.assemble(frame, due.packets, ahead=due.ahead)
        assert same_splats(shown.after(slices, frame), reader.active_splats(frame, layers))
        count += 1
    return count


@pytest.mark.parametrize(("layers", "first"), [(1, 0), (2, 0), (2, 27), (3, 0)])
def test_a_play_without_it_shows_what_a_reader_does(
    root: Path, reader: StreamReader, layers: int, first: int
) -> None:
    with opened(str(root / "s"), FrameRange(first, NUM_FRAMES), layers) as source:
        playout = Playout(reader.manifest, first, NUM_FRAMES, needed=layers)
        for packets in source.packets():
            playout.push(packets, 0.0)
        playout.finish(0.0)
        assembler = Assembler(reader.manifest, layers, first)
        assert played(playout, assembler, reader, layers) == NUM_FRAMES - first


def shares_of(reader: StreamReader, rate_share: float) -> list[float]:
    """Share of each layer's bytes that arrives in time, without a stall, over a link with this
    share of the stream's rate."""
    play = HostedPlay(reader.manifest, reader.records, FrameRange(0, NUM_FRAMES), 0.0)
    link = MadeLink(reader, play)
    come, clock = [0.0] * (TEMPORAL + 1), play.session.clock

    def in_time(birth: int) -> bool:
        return clock.started_s is None or link.now_s <= clock.due_s(birth)

    while True:
        for one in link.packets(rate_share * need_bps(reader)):
            if isinstance(one, SlicePackets) and in_time(one.birth):
                come[one.first_layer] += sum(map(len, one.packets))
        if link.over:
            break
    assert clock.stalls == 0
    sizes = [sum(record.object_bytes[n] for record in reader.records) for n in range(TEMPORAL + 1)]
    return [num_bytes / size for num_bytes, size in zip(come, sizes, strict=True)]


def test_on_a_thin_link_it_stays_behind_first(reader: StreamReader) -> None:
    base, upper, temporal = shares_of(reader, 0.7)
    assert temporal < 0.1 < 0.4 < upper < base
    assert min(shares_of(reader, 3.0)) > 0.75  # it starts after the others
