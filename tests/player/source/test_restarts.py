"""Real servers that die, stop, fail or change: the play continues, or fails with one line."""

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
from codec.stream import StreamReader
from player.link.linkprocess import LinkProcess
from player.network.fetch import BrokenError
from player.network.retry import RetryConfig
from player.source.opener import Opener, SourceConfig, opened
from server.abr.clientstatus import ClientStatus
from server.abr.link.link import Link, LinkStep
from tests.support.delivery.assembled import Assembled, assembled, checked
from tests.support.hosted_streams import ServerProcess, served, static_host, write_stream

pytestmark = pytest.mark.realtime

NUM_FRAMES, FPS = 300, 40.0
"""A stream longer than a server's lead."""


@pytest.fixture
def root(tmp_path: Path) -> Path:
    path = tmp_path / "root"
    write_stream(path / "s", NUM_FRAMES, 8, 0, fps=FPS, segment_frames=50)
    return path


@pytest.fixture
def server(root: Path) -> Iterator[ServerProcess]:
    with served(root) as server:
        yield server


def played_through(
    reader: StreamReader, source: str, at_frame: int, act: Callable[[], None]
) -> None:
    """Plays all of `source`, and calls `act` once at `at_frame`. Asserts that every frame equals
    that on disk."""
    with opened(source, layers=3) as found:
        token = found.play.token
        for one in checked(reader, assembled(found), 3):
            if one.frame == at_frame:
                act()
        assert found.play.token != token
    assert one.frame == NUM_FRAMES - 1


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


@pytest.mark.parametrize(
    ("patience_s", "message"),
    [
        (0.0, "^((?!tried).)*$"),  # the first failure ends it
        (0.1, r"^\S+: cannot connect: Connection refused \(tried for 0\.\d+ s, \d+ times\)$"),
    ],
)
def test_a_server_that_stays_away_ends_in_one_line(
    root: Path, server: ServerProcess, patience_s: float, message: str
) -> None:
    config = SourceConfig(RetryConfig(patience_s, first_delay_s=0.01, max_delay_s=0.01))
    with opened(f"{server.url}/watch/s", layers=3, config=config) as source:
        packets = source.packets()
        next(packets)
        server.kill()
        with pytest.raises(BrokenError, match=message):
            list(packets)


def test_a_network_that_dies_again_and_again_is_played_over(
    root: Path, server: ServerProcess
) -> None:
    link = Link([LinkStep(0.5, 3e6, 0.005), LinkStep(0.5, 0.0, 0.005)])
    reader = StreamReader(root / "s")
    with LinkProcess(link, "127.0.0.1", server.port) as relay:
        url = f"{server.url}/watch/s"
        with opened(url, layers=3, via=relay.address) as source:
            got = list(checked(reader, assembled(source), 3))
        assert len(got) == NUM_FRAMES
        assert relay.down_bytes > sum(one.wire_bytes for one in got)


@pytest.mark.parametrize("fps", [FPS, 30.0])
def test_a_stream_that_was_replaced_is_not_mixed_with_the_old_one(
    root: Path, server: ServerProcess, tmp_path: Path, fps: float
) -> None:
    shutil.copytree(root / "s", tmp_path / "old")
    write_stream(tmp_path / "new", NUM_FRAMES, 8, 0, fps=fps, seed=10_000, segment_frames=50)
    reader, shown = StreamReader(tmp_path / "old"), 0
    with opened(f"{server.url}/watch/s", layers=3) as source:
        source.send_status(ClientStatus(0))

        def show() -> None:
            nonlocal shown
            for one in checked(reader, assembled(source), 3):
                shown = one.frame
                if one.frame == 20:
                    shutil.rmtree(root / "s")
                    (tmp_path / "new").rename(root / "s")

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
                    shown.extend(checked(reader, assembled(source), 3))
                assert 0 < len(shown) <= 100
