"""A player reports its status to its server: over real sockets, with any response of a server."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from codec.errors import CorruptError
from codec.framerange import FrameRange
from codec.stream.index import record_bytes
from player.config import PlayConfig
from player.network.fetch import Fetcher
from player.playout.clock import Clock
from player.playout.queues import Events
from player.playout.threads import Threads
from player.playout.timeline import Playout
from player.render.renderer import RendererKind
from player.run.playback import play
from player.source.served import ServedSource
from player.source.source import LastPlay
from player.view.path import Size
from server.abr.clientstatus import FRAME_HEADER, PLAY_HEADER, RATE_HEADER, ClientStatus
from tests.player.network.webhosts import HOLD, ScriptedHost, script
from tests.player.source.test_served import ALL, HEAD, MANIFEST, PATIENT, answer, start
from tests.support.server.running_server import (
    SWIN_SIZE,
    Running,
    make_stream,
    quick_config,
    running,
)
from tests.support.waiting import wait_until

FPS, LEAD_S = 20, 0.6

NAMED = HEAD.replace(b"\r\n\r\n", f"\r\n{PLAY_HEADER}: abc-_1\r\n\r\n".encode())


@contextmanager
def in_thread(root: Path) -> Iterator[Running]:
    """A server on an event loop in a thread."""
    found: list[Running] = []
    ready, stop = threading.Event(), threading.Event()

    async def serve() -> None:
        async with running(root, quick_config(max_lead_s=LEAD_S)) as server:
            found.append(server)
            ready.set()
            await asyncio.to_thread(stop.wait)

    thread = threading.Thread(target=lambda: asyncio.run(serve()))
    thread.start()
    try:
        assert ready.wait(30)
        yield found[0]
    finally:
        stop.set()
        thread.join()


@pytest.mark.realtime
def test_a_server_does_not_count_a_pause_as_shown(tmp_path: Path) -> None:
    make_stream(tmp_path / "long", 160, fps=FPS)
    with in_thread(tmp_path) as server:
        metrics = server.state.metrics

        def births() -> int:
            """Number of sent slices without those of the first window."""
            return round(metrics.packets.value("0")) - (SWIN_SIZE - 1)

        def num_reports() -> int:
            return round(
                metrics.status_reports.value("taken") + metrics.status_reports.value("replaced")
            )

        url = f"{server.url}/v1/streams/long"
        source = ServedSource("S", url, Fetcher(), FrameRange(), None)
        clock = Clock(real=True)
        events = Events(Playout(source.manifest, 0, 160), clock)
        with Threads(source, events):
            for _ in range(5):
                due = events.wait_for_frame()
                assert due is not None
            clock.stop()
            events.time_changed()
            before = num_reports()
            # The first may have been on its way, the last may not have been read.
            wait_until(lambda: num_reports() > before + 2)
            status = events.client_status(0, 0)
            assert status is not None
            assert status.paused
            assert status.frame is not None
            most = max(births(), status.frame + round(LEAD_S * FPS))
            before = num_reports()
            wait_until(lambda: num_reports() > before + 2)  # a second or more
            assert births() <= most
            clock.start()
            events.time_changed()
            wait_until(lambda: births() > most + FPS)
        source.close()
        assert metrics.status_reports.value("refused") == 0


NO_INDEX = b"HTTP/1.1 404 No\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
"""Response to clients that want more of the stream than its manifest."""


@contextmanager
def played(*answers: bytes) -> Iterator[tuple[ScriptedHost, ServedSource]]:
    """A host that gives `answers`, and a play of its stream."""
    with script(*answers) as host:
        url = f"{host.url}/v1/streams/s"
        with closing(ServedSource("S", url, Fetcher(), FrameRange(), None, PATIENT)) as source:
            yield host, source


def test_a_server_that_names_no_play_is_told_nothing() -> None:
    with played(answer(start(), *ALL)) as (host, source):
        assert not source.send_status(ClientStatus(1))
        assert len(host.asked) == 1


@pytest.mark.parametrize(
    ("status", "listens", "asked"),
    [(b"405 No", False, 1), (b"404 No", True, 1), (b"500 No", True, 2)],
)
def test_what_a_server_answers_decides_who_is_told_more(
    status: bytes, listens: bool, asked: int
) -> None:
    told = b"HTTP/1.1 %s\r\nContent-Length: 0\r\nConnection: close\r\n\r\n" % status
    with played(answer(start()).replace(HEAD, NAMED) + HOLD, told, told) as (host, source):
        assert source.send_status(ClientStatus(1)) == listens
        if listens:
            assert source.send_status(ClientStatus(2))
        assert host.asked[1:] == ["/v1/streams/s/play/abc-_1"] * asked
        assert host.requests[1].startswith(b"POST ")


def test_a_lost_status_report_is_not_repeated() -> None:
    with played(answer(start()).replace(HEAD, NAMED) + HOLD, b"", b"junk\r\n\r") as (_, source):
        assert source.send_status(ClientStatus(1))
        assert source.send_status(ClientStatus(2))
        source.interrupt()
        assert not source.send_status(ClientStatus(3))


def test_a_new_connection_is_told_at_once_how_the_playback_stands(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Otherwise the server would assume that the player waits for its first picture, although it
    has seconds of media, and send it few layers."""
    monkeypatch.setattr("player.playout.threads.STATUS_MOST_S", 1e6)  # no report but that one
    cut = answer(start(), *ALL[:4]).replace(HEAD, NAMED)
    again = answer(start(), *ALL).replace(HEAD, NAMED.replace(b"abc-_1", b"abc-_2")) + HOLD
    heard = b"HTTP/1.1 204 Heard\r\nConnection: close\r\n\r\n"
    with played(cut, again, heard, NO_INDEX) as (host, source):
        events = Events(Playout(source.manifest, 0, 5), Clock(real=True))
        with Threads(source, events):
            wait_until(lambda: len(host.asked) >= 3)
        assert host.asked[2] == "/v1/streams/s/play/abc-_2"


def test_a_stream_with_the_same_manifest_is_told_by_its_first_record() -> None:
    cut = answer(start(), *ALL[:3]).replace(HEAD, NAMED)
    heard = b"HTTP/1.1 204 Heard\r\nConnection: close\r\n\r\n"
    size = record_bytes(MANIFEST.num_layers)
    index = [b"HTTP/1.0 200 OK\r\n\r\n" + letter * 2 * size for letter in (b"a", b"b")]
    with played(cut, heard, *index, answer(start(), *ALL)) as (_, source):
        assert source.send_status(ClientStatus(2))
        with pytest.raises(CorruptError, match="the stream was replaced by another one"):
            list(source.packets())


@pytest.mark.parametrize(
    ("said", "sent"), [(b"5000000", "5000000"), (b"nan", ""), (b"-1", ""), (b"0", "")]
)
def test_a_new_connection_names_the_last_play_the_next_frame_and_the_rate(
    said: bytes, sent: str
) -> None:
    cut = answer(start(), *ALL[:3]).replace(HEAD, NAMED)
    heard = b"HTTP/1.1 204 Heard\r\n%s: %s\r\nConnection: close\r\n\r\n"
    heard %= RATE_HEADER.encode(), said
    with played(cut, heard, NO_INDEX, answer(start(), *ALL)) as (host, source):
        assert source.send_status(ClientStatus(2))
        packets = source.packets()
        for _ in range(4):
            next(packets)
        first, again = host.requests[0].decode(), host.requests[3].decode()
        assert not any(name in first for name in (PLAY_HEADER, FRAME_HEADER, RATE_HEADER))
        assert f"\r\n{PLAY_HEADER}: abc-_1\r\n" in again
        assert f"\r\n{FRAME_HEADER}: 2\r\n" in again
        assert (f"\r\n{RATE_HEADER}: {sent}\r\n" in again) == bool(sent)
        assert (RATE_HEADER in again) == bool(sent)
        assert source.play == LastPlay("", float(sent) if sent else None)


def test_a_server_that_was_started_again_goes_by_what_the_last_one_said(tmp_path: Path) -> None:
    make_stream(tmp_path / "long", 160, fps=FPS)
    with in_thread(tmp_path) as server:
        url = f"{server.url}/v1/streams/long"
        # This server does not know the name of that play.
        last = LastPlay("0-" + "a" * 22, 7e6)
        source = ServedSource("S", url, Fetcher(), FrameRange(), None, last_play=last)
        assert source.play.token != last.token
        assert source.play.rate_bps == 7e6
        source.close()


def test_a_loop_names_the_play_before(tmp_path: Path) -> None:
    whole = answer(start(), *ALL).replace(HEAD, NAMED)
    with script(whole, whole) as host:
        config = PlayConfig(
            f"{host.url}/v1/streams/s",
            loop=2,
            capture=tmp_path / "out",
            size=Size(32, 24),
            renderer=RendererKind.CPU,
        )
        assert play(config).totals.frames == 10
        first, second = (request for request in host.requests if request.startswith(b"GET "))
        assert PLAY_HEADER.encode() not in first
        assert f"{PLAY_HEADER}: abc-_1".encode() in second
