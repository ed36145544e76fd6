"""Real servers that die or change: the play continues, or fails with one line. test_joining.py has
a killed server that comes back at once."""

from __future__ import annotations

import shutil
import signal
import threading
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from codec.errors import CorruptError
from codec.framerange import FrameRange
from codec.stream import StreamReader
from player.link.linkprocess import LinkProcess
from player.network.fetch import BrokenError, Fetcher
from player.source.opener import Opener, opened
from server.abr.clientstatus import ClientStatus
from server.abr.link.link import Link, LinkStep
from tests.support.delivery.assembled import assembled, checked
from tests.support.hosted_streams import ServerProcess, served, write_stream

NUM_FRAMES, FPS = 300, 40.0
"""A stream longer than a server's lead, which is sent as it is played."""


@pytest.fixture
def root(tmp_path: Path) -> Path:
    path = tmp_path / "root"
    write_stream(path / "s", NUM_FRAMES, 8, 0, fps=FPS, segment_frames=50)
    return path


@pytest.fixture
def server(root: Path) -> Iterator[ServerProcess]:
    with served(root) as server:
        yield server


def test_a_seek_while_the_server_is_away_waits_for_it(
    root: Path, server: ServerProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    restarted: list[ServerProcess] = []

    def pause(fetcher: Fetcher, seconds: float) -> None:
        assert seconds > 0
        if not restarted:
            restarted.append(ServerProcess(root, server.port))

    with closing(Opener(f"{server.url}/watch/s")) as opener:
        opener.open(FrameRange(), 3).close()
        server.kill()
        monkeypatch.setattr(Fetcher, "pause", pause)
        with closing(opener.open(FrameRange(100), 3)) as source:
            assert next(assembled(source)).frame == 100
        restarted[0].kill()


def test_nobody_waits_for_a_server_that_was_never_there(
    server: ServerProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    server.kill()
    monkeypatch.delattr(Fetcher, "pause")
    with pytest.raises(BrokenError, match="cannot connect"), opened(f"{server.url}/watch/s"):
        pass


@pytest.mark.realtime
@pytest.mark.parametrize(("how", "away_s"), [(signal.SIGTERM, 0.0), (signal.SIGKILL, 3.0)])
def test_a_server_that_is_started_again_is_played_on(
    root: Path, server: ServerProcess, how: signal.Signals, away_s: float
) -> None:
    def restart() -> None:
        server.process.send_signal(how)
        server.process.wait()
        threading.Event().wait(away_s)
        assert server.process.stdout is not None
        server.process.stdout.close()
        server.process = ServerProcess(root, server.port).process

    thread = threading.Thread(target=restart)
    with opened(f"{server.url}/watch/s", layers=3) as found:
        token = found.play.token
        for one in checked(StreamReader(root / "s"), assembled(found), 3):
            if one.frame == 20:
                thread.start()
        assert found.play.token != token
    thread.join()
    assert one.frame == NUM_FRAMES - 1


@pytest.mark.realtime
def test_a_network_that_dies_again_and_again_is_played_over(
    root: Path, server: ServerProcess
) -> None:
    link = Link([LinkStep(0.5, 3e6, 0.005), LinkStep(0.5, 0.0, 0.005)])
    with LinkProcess(link, "127.0.0.1", server.port) as relay:
        with opened(f"{server.url}/watch/s", layers=3, via=relay.address) as source:
            got = list(checked(StreamReader(root / "s"), assembled(source), 3))
        assert len(got) == NUM_FRAMES
        assert relay.down_bytes > sum(one.wire_bytes for one in got)


@pytest.mark.realtime
def test_a_stream_that_was_replaced_is_not_mixed_with_the_old_one(
    root: Path, server: ServerProcess, tmp_path: Path
) -> None:
    shutil.copytree(root / "s", tmp_path / "old")
    write_stream(tmp_path / "new", NUM_FRAMES, 8, 0, fps=FPS, seed=10_000, segment_frames=50)
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
