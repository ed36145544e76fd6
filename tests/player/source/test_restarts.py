"""Real servers that die, stop, fail or change under a play: it goes on, or says in one line why."""

from __future__ import annotations

import shutil
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from codec.errors import CorruptError
from codec.framerange import FrameRange
from codec.stream import StreamReader, StreamWriter
from player.link.linkprocess import LinkProcess
from player.network.fetch import BrokenError
from player.network.retry import RetryConfig
from player.source.opener import Opener, SourceConfig, opened
from server.abr.link.link import Link, LinkStep
from server.abr.standing import Standing
from tests.player.source.test_source import same
from tests.support.delivery.assembled import Assembled, assembled
from tests.support.hosted_streams import (
    SWIN_SIZE,
    ServerProcess,
    random_slice,
    small_manifest,
    static_host,
    write_stream,
)

pytestmark = pytest.mark.realtime

NUM_FRAMES, FPS = 300, 40.0
"""Longer than a server sends ahead."""


@pytest.fixture
def root(tmp_path: Path) -> Path:
    path = tmp_path / "root"
    write_stream(path / "s", NUM_FRAMES, 8, 0, fps=FPS, segment_frames=50)
    return path


@pytest.fixture
def server(root: Path) -> Iterator[ServerProcess]:
    server = ServerProcess(root)
    yield server
    server.kill()


def played_through(
    reader: StreamReader, source: str, at_frame: int, act: Callable[[], None]
) -> None:
    """Plays all of `source`, acts once when `at_frame` is there; each slice comes once, as it is on
    disk."""
    births = []
    with opened(source, layers=3) as found:
        token = found.play.token
        for one in assembled(found):
            for slice in one.slices:
                births.append(slice.birth)
                assert same(slice, reader.slice(slice.birth, 3))
            if one.frame == at_frame:
                act()
        assert found.play.token != token
    assert births == list(range(1 - SWIN_SIZE, NUM_FRAMES))


@pytest.mark.parametrize(
    ("how", "away_s"),
    [
        (signal.SIGKILL, 0.0),
        (signal.SIGTERM, 0.0),
        (signal.SIGKILL, 3.0),
        (signal.SIGTERM, 3.0),
        pytest.param(signal.SIGKILL, 30.0, marks=pytest.mark.slow),
    ],
)
def test_a_server_that_is_started_again_is_played_on(
    root: Path, server: ServerProcess, how: signal.Signals, away_s: float
) -> None:
    threads: list[threading.Thread] = []

    def restart() -> None:
        server.process.send_signal(how)
        server.process.wait()
        time.sleep(away_s)
        assert server.process.stdout is not None
        server.process.stdout.close()
        server.process = ServerProcess(root, server.port).process

    def act() -> None:
        threads.append(threading.Thread(target=restart))
        threads[0].start()

    try:
        played_through(StreamReader(root / "s"), f"{server.url}/watch/s", 20, act)
    finally:
        threads[0].join()


def test_a_seek_while_the_server_is_away_waits_for_it(root: Path, server: ServerProcess) -> None:
    with closing(Opener(f"{server.url}/watch/s")) as opener:
        opener.open(FrameRange(), 3).close()
        server.kill()
        threading.Timer(1.0, lambda: restarted.append(ServerProcess(root, server.port))).start()
        restarted: list[ServerProcess] = []
        with closing(opener.open(FrameRange(100), 3)) as source:
            assert next(assembled(source)).frame == 100
        restarted[0].kill()


def test_nobody_waits_for_a_server_that_was_never_there(root: Path, server: ServerProcess) -> None:
    server.kill()
    began_s = time.monotonic()
    with pytest.raises(BrokenError, match="cannot connect"), opened(f"{server.url}/watch/s"):
        pass
    assert time.monotonic() - began_s < 5


def test_without_patience_the_first_failure_ends_it(root: Path, server: ServerProcess) -> None:
    config = SourceConfig(RetryConfig(0))
    with opened(f"{server.url}/watch/s", layers=3, config=config) as source:
        packets = source.packets()
        next(packets)
        server.kill()
        with pytest.raises(BrokenError) as caught:
            list(packets)
        assert "tried" not in str(caught.value)


def test_a_network_that_dies_again_and_again_is_played_over(
    root: Path, server: ServerProcess
) -> None:
    link = Link([LinkStep(0.5, 3e6, 0.005), LinkStep(0.5, 0.0, 0.005)])
    reader = StreamReader(root / "s")
    with LinkProcess(link, "127.0.0.1", server.port) as relay:
        url = f"{server.url}/watch/s"
        with opened(url, layers=3, via=relay.address) as source:
            births = []
            for one in assembled(source):
                births += [slice.birth for slice in one.slices]
                assert all(same(slice, reader.slice(slice.birth, 3)) for slice in one.slices)
    assert births == list(range(1 - SWIN_SIZE, NUM_FRAMES))


def replace(path: Path, fps: float = FPS) -> None:
    """Another stream in the place of the one at `path`, made alike, with other Gaussians."""
    manifest = small_manifest(8, 0, fps, segment_frames=50)
    with StreamWriter.create(path.with_name("new"), manifest) as writer:
        for birth in range(1 - SWIN_SIZE, NUM_FRAMES):
            made = random_slice(birth + 10_000, 8, 0)
            writer.append(type(made)(birth, made.splats, made.start_offsets))
    shutil.rmtree(path)
    path.with_name("new").rename(path)


@pytest.mark.parametrize("fps", [FPS, 30.0])
def test_a_stream_that_was_replaced_is_not_mixed_with_the_old_one(
    root: Path, server: ServerProcess, tmp_path: Path, fps: float
) -> None:
    shutil.copytree(root / "s", tmp_path / "old")
    reader, shown = StreamReader(tmp_path / "old"), 0
    with opened(f"{server.url}/watch/s", layers=3) as source:
        source.tell(Standing(0))

        def show() -> None:
            nonlocal shown
            for one in assembled(source):
                assert all(same(slice, reader.slice(slice.birth, 3)) for slice in one.slices)
                shown = one.frame
                if one.frame == 20:
                    replace(root / "s", fps)

        with pytest.raises(CorruptError, match=r"/watch/s: the stream was replaced by another one"):
            show()
        assert shown >= 20


def test_a_corrupted_object_is_named_and_never_shown(root: Path) -> None:
    reader = StreamReader(root / "s")
    path = root / "s" / "segments" / "2" / "1"
    good = path.read_bytes()
    for at in np.random.default_rng(1).integers(len(good), size=5):
        damaged = bytearray(good)
        damaged[at] ^= 1 << (at % 8)
        path.write_bytes(damaged)
        with static_host(root) as host:
            for name in (f"{host}/s", str(root / "s")):
                shown: list[Assembled] = []
                with (
                    opened(name) as source,
                    pytest.raises(CorruptError, match=r"segments/2/1: .*was altered"),
                ):
                    shown.extend(assembled(source))
                assert shown
                assert all(
                    one.frame < 100 and all(same(s, reader.slice(s.birth, 3)) for s in one.slices)
                    for one in shown
                )
