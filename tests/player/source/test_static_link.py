"""Streams from static hosts and servers over links that are slow, drop, and recover."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, closing, contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest

from codec.errors import CorruptError
from codec.framerange import FrameRange
from codec.stream import StreamReader, StreamWriter
from player.link.linkprocess import LinkProcess
from player.network.fetch import BrokenError
from player.network.retry import RetryConfig
from player.playout.clock import Clock
from player.playout.conductor import Conductor
from player.render.cpu import CpuRenderer
from player.source.hostedplay import Ask, HostedPlay, Wait
from player.source.opener import Opener, SourceConfig, opened
from player.source.source import SlicePackets
from server.abr.link.link import Link, LinkStep
from tests.player.playout.test_conductor import Played, picture
from tests.player.source.test_hosted_play import need_bps
from tests.support.delivery.assembled import assembled, check_packets
from tests.support.delivery.rangehost import RangeHost, range_host
from tests.support.delivery.watched import Watched, watched
from tests.support.hosted_streams import (
    SWIN_SIZE,
    random_slice,
    served,
    small_manifest,
    static_host,
    write_stream,
)
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout
from tests.support.suite.starved import Watch

pytestmark = [pytest.mark.realtime, pytest.mark.quiet]

NUM_FRAMES, LAYERS, FPS = 120, 3, 30.0
NAMES = ("whole", "slots")
PATIENT = SourceConfig(RetryConfig(10, first_delay_s=0.01, max_delay_s=0.05))


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("root")
    write_stream(path / "whole", NUM_FRAMES, 80, fps=FPS, segment_frames=30)
    write_busy_stream(path / "slots", NUM_FRAMES, small_layout(4, (240, 240, 240), 0, 30), fps=FPS)
    return path


@contextmanager
def host_with_ranges(root: Path) -> Iterator[str]:
    with range_host(root) as host:
        yield host.url


@contextmanager
def swings_server(root: Path) -> Iterator[str]:
    with served(root) as server:
        yield f"{server.url}/watch"


Host = Callable[[Path], AbstractContextManager[str]]
STATIC: tuple[Host, ...] = (static_host, host_with_ranges)


@contextmanager
def over_link(url: str, steps: list[LinkStep]) -> Iterator[Opener]:
    """Opens the stream at `url`."""
    port = urlsplit(url).port
    assert port is not None
    with (
        LinkProcess(Link(steps), "127.0.0.1", port) as relay,
        closing(Opener(url, relay.address)) as opener,
    ):
        yield opener


def play(root: Path, name: str, host: Host, *steps: tuple[float, float]) -> Watched:
    """Plays a stream over a link. steps: seconds, and what it carries as a share of the stream."""
    all_bps = need_bps(StreamReader(root / name))
    made = [LinkStep(seconds, share * all_bps, 0.02) for seconds, share in steps]
    with host(root) as url, over_link(f"{url}/{name}", made) as opener:
        got = watched(opener.open(FrameRange(), None, adaptive=True))
    assert [one.frame for one in got.frames] == list(range(NUM_FRAMES))
    return got


def check_plays(
    root: Path,
    hosts: Sequence[Host],
    steps: Sequence[tuple[float, float]],
    check: Callable[[str, Watched], None],
) -> None:
    """Plays both streams from each of `hosts`, at the same time, over a link each. A failure is
    repeated if the machine was too busy."""
    cases = [(name, host) for name in NAMES for host in hosts]
    for _ in range(3):
        with Watch() as watch, ThreadPoolExecutor(len(cases)) as pool:
            running = [pool.submit(play, root, name, host, *steps) for name, host in cases]
            played = [one.result() for one in running]
        try:
            for (name, host), got in zip(cases, played, strict=True):
                check(f"{name} from {host.__name__}", got)
            return
        except AssertionError:
            if not watch.starved:
                raise
    pytest.skip("this machine is too busy to play in time")


@pytest.mark.parametrize("hosts", [STATIC, (swings_server,)])
def test_a_link_of_one_and_a_half_streams_shows_all_layers_without_a_stall(
    root: Path, hosts: Sequence[Host]
) -> None:
    def check(name: str, got: Watched) -> None:
        assert got.startup_s < 0.5, name
        assert got.totals.stalls == 0, name
        assert got.layers(2.0) > LAYERS - 0.1, name
        assert got.totals.mean_layers > LAYERS - 0.6, name

    check_plays(root, hosts, [(60.0, 1.5)], check)


def check_stalls(name: str, got: Watched) -> None:
    """A host without ranges finishes every begun object, even if the link has become slow."""
    assert got.totals.stalled_s <= (0.4 if static_host.__name__ in name else 0.0), name


def test_a_link_that_falls_to_half_of_it_goes_on_with_fewer_layers(root: Path) -> None:
    def check(name: str, got: Watched) -> None:
        check_stalls(name, got)
        assert got.layers(0.8, 1.4) > LAYERS - 0.8, name
        assert 1 <= got.layers(2.0) < LAYERS - 0.3, name

    check_plays(root, STATIC, [(1.5, 1.5), (60.0, 0.5)], check)


def test_a_link_that_comes_back_brings_the_layers_back(root: Path) -> None:
    def check(name: str, got: Watched) -> None:
        check_stalls(name, got)
        assert got.layers(1.6, 2.2) < LAYERS - 0.3, name
        assert got.layers(3.5) > LAYERS - 0.3, name

    check_plays(root, STATIC, [(1.0, 1.5), (1.2, 0.5), (60.0, 2.0)], check)


@pytest.mark.parametrize("name", NAMES)
def test_a_seek_shows_layer_0_of_that_frame_first(
    root: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Ask] = []  # not the host's: requests of the first play may still arrive
    next_step = HostedPlay.next

    def recorded(play: HostedPlay, now_s: float) -> Ask | Wait:
        step = next_step(play, now_s)
        asked.extend([step] if isinstance(step, Ask) else [])
        return step

    steps = [LinkStep(60.0, 3e6, 0.02)]
    with range_host(root) as host, over_link(f"{host.url}/{name}", steps) as opener:
        before = opener.open(FrameRange(), None, adaptive=True)
        watched(before, until_frame=10)
        monkeypatch.setattr(HostedPlay, "next", recorded)
        source = opener.open(FrameRange(75), None, adaptive=True)
        assert source.play.rate_bps is not None
        assert source.play.rate_bps == before.play.rate_bps
        assert 1e6 < source.play.rate_bps < 4e6
        got = watched(source, until_frame=100)
    assert got.frames[0].frame == 75
    assert got.startup_s < 0.3
    first = [one.first_layer for one in got.packets[:4]]
    assert first[0] == 0
    assert got.frames[0].layers < LAYERS
    assert got.layers(0.7) > LAYERS - 0.1
    assert asked
    assert all(ask.segment > 0 for ask in asked)


def test_a_link_is_not_asked_twice_for_the_same_bytes(root: Path) -> None:
    with range_host(root) as host, opened(f"{host.url}/whole", adaptive=True) as source:
        list(assembled(source))
    sizes = (sum(record.part_bytes) for record in StreamReader(root / "whole").records)
    index_and_manifest = sum(
        (root / "whole" / n).stat().st_size for n in ("index.bin", "manifest.json")
    )
    assert source.received_bytes <= sum(sizes) + index_and_manifest


def check_slices(reader: StreamReader, got: Watched) -> None:
    """Each slice came once in each layer, as it is on disk."""
    for one in got.packets:
        check_packets(reader, one)
        assert len(one.packets) == 1
    came = [one for one in got.packets if isinstance(one, SlicePackets)]
    assert len({(one.birth, one.first_layer) for one in came}) == len(came)


@pytest.mark.parametrize("name", NAMES)
def test_what_shows_is_what_the_stream_holds(root: Path, name: str) -> None:
    """The report counts exactly the data that arrived."""
    reader = StreamReader(root / name)
    for host in STATIC:
        with host(root) as url, opened(f"{url}/{name}", FrameRange(90), adaptive=True) as source:
            got = watched(source)
        check_slices(reader, got)
        assert got.totals.wire_bytes <= sum(one.wire_bytes for one in got.packets)
        assert got.frames[-1].layers == LAYERS


@contextmanager
def static_files(root: Path) -> Iterator[str]:
    """The files of a swings server."""
    with served(root) as server:
        yield f"{server.url}/v1/streams/s/manifest.json?"


@pytest.mark.parametrize("host", [*STATIC, static_files])
def test_a_live_stream_is_followed_as_it_grows(tmp_path: Path, host: Host) -> None:
    root, num_frames = tmp_path / "library", 40
    writer = StreamWriter.create(root / "s", small_manifest(segment_frames=5, live=True))

    def write() -> None:
        with writer:
            for birth in range(1 - SWIN_SIZE, num_frames):
                writer.append(random_slice(birth))
                time.sleep(0.03)

    thread = threading.Thread(target=write)
    with host(root) as url, opened(f"{url}/s", config=PATIENT, adaptive=True) as source:
        assert source.frames.end is None
        thread.start()
        got = watched(source)
        assert not source.manifest.live
        thread.join()
    reader = StreamReader(root / "s")
    check_slices(reader, got)
    births = [one.birth for one in got.packets if isinstance(one, SlicePackets)]
    assert sorted(set(births)) == list(range(1, num_frames))
    # The play followed the stream; it did not wait for its end.
    assert got.startup_s < 1.0


# --- hosts that fail


def check_whole(root: Path, got: Watched) -> None:
    assert [one.frame for one in got.frames] == list(range(NUM_FRAMES))
    check_slices(StreamReader(root / "whole"), got)


def test_when_a_host_vanishes_the_next_one_is_asked(root: Path) -> None:
    with range_host(root) as first, range_host(root) as second:
        name = f"{first.url}/whole,{second.url}/whole"
        with opened(name, config=PATIENT, adaptive=True) as source:
            leave(first, 6)
            got = watched(source)
        assert first.objects()
        assert second.objects()
    check_whole(root, got)
    assert got.layers(2.0) == LAYERS


def leave(host: RangeHost, after: int) -> None:
    """Makes `host` close the connection of every request after `after` requested objects."""
    answer = host.answer

    def counting(handler: object) -> None:
        host.gone = len(host.objects()) >= after
        answer(handler)  # type: ignore[arg-type]

    host.answer = counting  # type: ignore[method-assign]


def test_what_breaks_off_is_asked_for_from_there(root: Path) -> None:
    with range_host(root) as host:
        host.cut_bytes = 9_000
        with opened(f"{host.url}/whole", config=PATIENT, adaptive=True) as source:
            got = watched(source)
            received_bytes = source.received_bytes
    check_whole(root, got)
    size = sum(path.stat().st_size for path in (root / "whole").rglob("*") if path.is_file())
    assert received_bytes <= size


def test_a_host_that_is_gone_for_good_is_named(root: Path) -> None:
    config = SourceConfig(RetryConfig(0.3, first_delay_s=0.01, max_delay_s=0.05))
    with (
        range_host(root) as host,
        opened(f"{host.url}/whole", config=config, adaptive=True) as source,
    ):
        leave(host, 3)
        with pytest.raises(BrokenError, match=r"segments/\d/\S+: .*tried for"):
            list(source.packets())


def test_a_stream_that_was_replaced_is_not_mixed_with_the_old_one(
    root: Path, tmp_path: Path
) -> None:
    path = write_stream(tmp_path / "whole", NUM_FRAMES, 80, fps=FPS, segment_frames=30)
    other = write_stream(tmp_path / "other", NUM_FRAMES, 70, fps=FPS, segment_frames=30)
    (other / "manifest.json").write_bytes((path / "manifest.json").read_bytes())
    reader = StreamReader(root / "whole")
    with (
        range_host(tmp_path) as host,
        opened(f"{host.url}/whole", config=PATIENT, adaptive=True) as source,
    ):
        packets = source.packets()
        came = [next(packets)]
        path.rename(tmp_path / "old")
        other.rename(path)
        with pytest.raises(CorruptError, match="was replaced by another one; play it again"):
            came.extend(packets)
    for one in came:
        check_packets(reader, one)


def test_an_altered_object_is_named(root: Path, tmp_path: Path) -> None:
    path = write_stream(tmp_path / "whole", NUM_FRAMES, 80, fps=FPS, segment_frames=30)
    damaged = path / "segments" / "1" / "0"
    damaged.write_bytes(damaged.read_bytes()[:-1] + b"x")
    for host in STATIC:
        with (
            host(tmp_path) as url,
            opened(f"{url}/whole", adaptive=True) as source,
            pytest.raises(CorruptError, match=r"segments/1/0: .*was altered"),
        ):
            list(source.packets())


def test_the_second_time_objects_come_from_the_disk(root: Path, tmp_path: Path) -> None:
    config = SourceConfig(PATIENT.retry, cache=tmp_path / "cache")
    with range_host(root) as host:
        for _ in range(2):
            before = len(host.objects())
            frames = FrameRange(0, 60)
            with opened(f"{host.url}/whole", frames, None, None, config, True) as source:
                got = watched(source)
            check_slices(StreamReader(root / "whole"), got)
        assert len(host.objects()) == before
        assert got.totals.mean_layers > LAYERS - 0.1


@pytest.mark.parametrize("host", [swings_server, host_with_ranges])
@pytest.mark.parametrize("name", NAMES)
def test_a_picture_that_stands_gets_the_layers_that_it_lacks(
    root: Path, name: str, host: Host
) -> None:
    expected = picture(root / name, 57)
    steps = [LinkStep(60.0, need_bps(StreamReader(root / name)), 0.02)]
    with host(root) as url, over_link(f"{url}/{name}", steps) as opener:
        played = Played(root / name, Clock(real=True), 1, 57)
        conductor = played.conductor = Conductor(
            lambda frame: opener.open(FrameRange(frame), None, adaptive=True),
            played.make_events,
            played.clock,
            57,
            1,
            opener.interrupt,
            lambda frame: opener.open(FrameRange(frame), LAYERS),
        )
        with conductor:
            conductor.toggle_pause()
            renderer = CpuRenderer(conductor.source.manifest)
            conductor.attach(renderer)
            played.shows(57)
            camera = conductor.source.manifest.camera()
            assert played.records[0].layers < LAYERS

            def is_whole() -> bool:
                return np.array_equal(renderer.render_again(57, camera), expected)

            assert not is_whole()
            played.poll_until(is_whole)
            assert {one.frame for one in played.records} == {57}
            conductor.step(1)
            played.shows(58)
            played.poll_until(lambda: played.records[-1].layers == LAYERS)
            assert played.records[-1].frame == 58
            conductor.toggle_pause()
            played.shows(70)
            assert conductor.source.adaptive
