"""One stream opened repeatedly, as for seeks, also while its server is away."""

from __future__ import annotations

import shutil
import socket
import threading
from collections.abc import Iterator
from contextlib import closing
from itertools import islice
from pathlib import Path

import pytest

from codec.errors import CorruptError
from codec.framerange import FrameRange
from player.network.fetch import BrokenError, Fetcher, StoppedError
from player.source.opener import Opener, opened
from tests.player.network.webhosts import NO_ANSWER, script
from tests.player.source.test_served import answer, start
from tests.support.delivery.assembled import assembled
from tests.support.hosted_streams import ServerProcess, served, static_host, write_stream


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("root")
    write_stream(path / "s", 40)
    return path


@pytest.fixture(scope="module")
def names(root: Path) -> Iterator[list[str]]:
    with served(root) as server, static_host(root) as host:
        yield [str(root / "s"), server.url, f"{host}/s"]


def test_every_seek_gives_what_shows_from_there_on(names: list[str]) -> None:
    for name in names:
        with closing(Opener(name)) as opener:
            assert opener.manifest is None
            for first, layers in ((0, None), (30, 3), (7, 1), (0, 3)):
                with closing(opener.open(FrameRange(first), layers)) as source:
                    assert source.manifest is opener.manifest
                    # A seek comes in the middle of things as well.
                    frames = [one.frame for one in islice(assembled(source), 5)]
                    assert frames == list(range(first, first + 5))
                    if not name.startswith("/"):
                        assert 0 < source.received_bytes < 1 << 20


def test_who_was_interrupted_can_be_followed_by_another(names: list[str]) -> None:
    for name in names[1:]:
        with closing(Opener(name)) as opener:
            with closing(opener.open(FrameRange(), None)) as source:
                source.interrupt()
                with pytest.raises(StoppedError):
                    list(source.packets())
            with closing(opener.open(FrameRange(35), None)) as source:
                assert [one.frame for one in assembled(source)] == list(range(35, 40))
            opener.interrupt()
            with pytest.raises(StoppedError):
                opener.open(FrameRange(), None)


def test_opening_can_be_interrupted() -> None:
    with script(NO_ANSWER) as host, closing(Opener(f"{host.url}/watch/s")) as opener:
        threading.Timer(0.1, opener.interrupt).start()
        with pytest.raises(StoppedError):
            opener.open(FrameRange(), None)


def test_a_stream_that_was_replaced_between_two_seeks_is_not_gone_on_with(tmp_path: Path) -> None:
    write_stream(tmp_path / "s", 40)
    with closing(Opener(str(tmp_path / "s"))) as opener:
        opener.open(FrameRange(), None).close()
        shutil.rmtree(tmp_path / "s")
        write_stream(tmp_path / "s", 40, fps=12.0)
        with pytest.raises(CorruptError, match="was replaced by another one"):
            opener.open(FrameRange(), None)


def test_where_a_server_is_is_asked_once() -> None:
    listed = b'{"streams": [{"name": "s"}]}'
    head = f"HTTP/1.1 200 OK\r\nConnection: close\r\nContent-Length: {len(listed)}\r\n\r\n"
    with (
        script(head.encode() + listed, answer(start()), answer(start())) as host,
        closing(Opener(host.url)) as opener,
    ):
        for _ in range(2):
            opener.open(FrameRange(), None).close()
        assert [asked.partition("?")[0] for asked in host.asked] == [
            "/v1/streams",
            "/v1/streams/s/play",
            "/v1/streams/s/play",
        ]


def test_a_seek_while_the_server_is_away_waits_for_it(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    restarted: list[ServerProcess] = []

    def pause(fetcher: Fetcher, seconds: float) -> None:
        assert seconds > 0
        if not restarted:
            restarted.append(ServerProcess(root, server.port))

    with served(root) as server, closing(Opener(f"{server.url}/watch/s")) as opener:
        opener.open(FrameRange(), 3).close()
        server.kill()
        monkeypatch.setattr(Fetcher, "pause", pause)
        with closing(opener.open(FrameRange(35), 3)) as source:
            assert next(assembled(source)).frame == 35
        restarted[0].kill()


def test_nobody_waits_for_a_server_that_was_never_there(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as unused:
        url = f"http://127.0.0.1:{unused.getsockname()[1]}"
    monkeypatch.delattr(Fetcher, "pause")
    with pytest.raises(BrokenError, match="cannot connect"), opened(f"{url}/watch/s"):
        pass
