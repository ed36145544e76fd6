"""Streams from every source: for every joining frame, and despite breaks and missing data, the
player shows the content of the stream."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.framerange import FrameRange
from codec.slice import window_births
from codec.slots.slotlayout import SlotLayout, Update
from codec.stream import StreamReader, StreamWriter
from codec.stream.manifest import SKIP_MAPS, keyframe_part
from codec.tools.audit import count_slots, summarise_slots, verify_stream
from player.network.fetch import RetryConfig
from player.source.opener import SourceConfig, opened
from tests.support.delivery.assembled import Assembled, assembled, checked, read_all, slices_of
from tests.support.hosted_streams import ServerProcess, static_host, wait_for_stream
from tests.support.slots.slot_streams import slot_manifest, write_slot_stream
from tests.support.slots.updates import patternless_updates, small_layout

NUM_FRAMES = 14


def check_play(reader: StreamReader, got: list[Assembled], frames: FrameRange, layers: int) -> None:
    """Asserts: each birth once, the first window complete, every frame as from the reader."""
    manifest = reader.manifest
    swin_size, end = manifest.swin_size, frames.end or reader.num_frames
    births = range(window_births(frames.first, swin_size).start, end)
    slices = slices_of(got)
    assert [slice.birth for slice in slices] == list(births)
    assert all(slice.rows is None for slice in slices[:swin_size])
    assert all(slice.rows is not None for slice in slices[swin_size:])
    assert {one.layers for one in got} == {layers}
    assert [one.frame for one in checked(reader, got, layers)] == list(range(frames.first, end))


def packet_bytes(reader: StreamReader, first: int, end: int, layers: int) -> int:
    """Bytes of the slices born after the first frame of the segment of `first` and before `end`,
    and of the keyframes that they follow."""
    manifest = reader.manifest
    segment = manifest.segment_of(first)
    start = segment * manifest.segment_frames
    keyframes = [reader.read_object(segment, keyframe_part(n)).packet(start) for n in range(layers)]
    slices = [
        reader.read_object(manifest.segment_of(birth), part).packet(birth)
        for birth in range(start + 1, end)
        for part in (SKIP_MAPS, *range(layers))
    ]
    return sum(map(len, keyframes + slices))


layouts = st.builds(
    small_layout,
    swin_size=st.sampled_from([1, 2, 5]),
    slots=st.sampled_from([(1,), (5, 3), (2, 9, 4)]),
    sh_degree=st.sampled_from([0, 1]),
    segment_frames=st.sampled_from([1, 3, 4, 20]),
)


@given(layouts, st.integers(0, 1 << 32))
@settings(max_examples=6, deadline=None)
def test_a_folder_joined_at_any_frame(layout: SlotLayout, seed: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = write_slot_stream(Path(folder) / "s", NUM_FRAMES, layout, seed)
        reader = StreamReader(path)
        num_layers = reader.manifest.num_layers
        for first in range(NUM_FRAMES):
            layers = 1 + first % num_layers
            frames = FrameRange(first, min(first + 8, NUM_FRAMES))
            got = read_all(str(path), frames, layers)
            check_play(reader, got, frames, layers)
            fetched = sum(received.wire_bytes for received in got)
            assert fetched == packet_bytes(reader, first, frames.end or 0, layers)
        check_play(reader, read_all(str(path), FrameRange()), FrameRange(), num_layers)


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("library")
    write_slot_stream(root / "one", NUM_FRAMES, small_layout(3, (6, 4, 5), 1, 5), fps=300.0)
    return root


def test_a_model_that_stands_still_takes_nothing_after_its_first_frame(
    library: Path, server: ServerProcess, tmp_path: Path
) -> None:
    path, layout = library / "still", small_layout(2, (40, 30), 0, 10)
    first, *_ = patternless_updates(layout, 1)
    with StreamWriter.create(path, slot_manifest(layout, fps=300.0)) as writer:
        writer.append(first)
        for birth in range(30):
            writer.append(Update.keeping(birth, layout))
            assert writer.slice_bytes == 0
    reader = StreamReader(path)
    assert all(record.side_bytes[0] == 20 for record in reader.records)
    assert all(size == 20 for record in reader.records for size in record.object_bytes)
    assert verify_stream(path).num_frames == 30
    assert summarise_slots(reader, count_slots(reader)).kept == (40, 30)
    wait_for_stream(server, "still")
    with static_host(library) as host:
        urls = f"{host}/still", f"{server.url}/watch/still"
        for source in (str(path), *urls):
            got = read_all(source, FrameRange(), 2)
            check_play(reader, got, FrameRange(), 2)
            assert not any(one.wire_bytes for one in got[1:])


def test_a_host_and_a_server_joined_at_any_frame(library: Path, server: ServerProcess) -> None:
    reader = StreamReader(library / "one")
    with static_host(library) as host:
        for first in range(NUM_FRAMES):
            layers = 1 + first % 3
            for end in (None, first + 1):
                frames = FrameRange(first, end)
                local = read_all(str(library / "one"), frames, layers)
                check_play(reader, local, frames, layers)
                for url in (f"{host}/one", f"{server.url}/watch/one"):
                    got = read_all(url, frames, layers)
                    check_play(reader, got, frames, layers)
                    told = [received.wire_bytes for received in got]
                    assert told == [received.wire_bytes for received in local]


def test_the_first_frame_carries_what_came_before_it(library: Path) -> None:
    reader = StreamReader(library / "one")
    told = [one.wire_bytes for one in read_all(str(library / "one"), FrameRange(8, 11), 2)]
    takes = [packet_bytes(reader, 8, frame, 2) for frame in (9, 10, 11)]
    assert told == [takes[0], takes[1] - takes[0], takes[2] - takes[1]]
    # At a segment's first frame there is only the keyframe.
    told = [one.wire_bytes for one in read_all(str(library / "one"), FrameRange(5, 6), 2)]
    assert told == [packet_bytes(reader, 5, 6, 2)]


def test_a_killed_server_that_comes_back_is_not_noticed(tmp_path: Path) -> None:
    root = tmp_path / "library"
    write_slot_stream(root / "long", 250, small_layout(3, (4, 3), 0, 40), fps=100.0)
    reader = StreamReader(root / "long")
    config = SourceConfig(RetryConfig(20, first_delay_s=0.05, max_delay_s=0.05))
    server, got = ServerProcess(root), list[Assembled]()
    try:
        with opened(f"{server.url}/watch/long", layers=2, config=config) as source:
            for one in checked(reader, assembled(source), 2):
                got.append(one)
                if one.frame == 20:
                    server.kill()
                    server = ServerProcess(root, server.port)
    finally:
        server.kill()
    # At a segment's first frame the new connection starts over, and the window is sent again.
    assert [one.layers for one in got] == [2] * 250
