"""A served stream as a source, with any response of a host and any fault of a connection, and the
status that a player reports."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import Any

import pytest

from codec.errors import CorruptError, SwingsError
from codec.framerange import FrameRange
from codec.stream.manifest import Manifest
from codec.stream.playrecord import (
    EndRecord,
    ErrorRecord,
    Record,
    SliceRecord,
    StartRecord,
    encode_record,
)
from codec.stream.segment import record_bytes
from player.network.fetch import FetchConfig, Fetcher, FetchError, RetryConfig
from player.network.target import BrokenError
from player.playout.clock import Clock
from player.playout.queues import Events
from player.playout.threads import Threads
from player.playout.timeline import Playout
from player.source.opener import Opener
from player.source.served import ReceivedPoints, ServedSource
from player.source.source import LastPlay
from server.abr.clientstatus import (
    FRAME_HEADER,
    MAX_POINTS,
    NUM_FRAMES_HEADER,
    PLAY_HEADER,
    RATE_HEADER,
    REPORT_HEADER,
    ClientStatus,
)
from tests.player.network.webhosts import HOLD, NO_ANSWER, ScriptedHost, script
from tests.support.delivery.assembled import assembled
from tests.support.delivery.playrecords import records_from_0
from tests.support.hosted_streams import SWIN_SIZE, small_manifest
from tests.support.waiting import wait_until

PATIENT = RetryConfig(patience_s=86400, first_delay_s=0.001, max_delay_s=0.001)
QUICK = RetryConfig(patience_s=0.05, first_delay_s=0.01, max_delay_s=0.01)
"""For plays that cannot go on."""

HEAD = b"HTTP/1.1 200 OK\r\nContent-Type: application/x-swings-play\r\nConnection: close\r\n\r\n"


REFUSED = b'HTTP/1.1 400 No\r\nConnection: close\r\n\r\n{"error": "from=0: no"}'
NO_INDEX = b"HTTP/1.1 404 No\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
"""Response to clients that want more of the stream than its manifest."""


def answer(*records: Record) -> bytes:
    return HEAD + b"".join(map(encode_record, records))


MANIFEST = small_manifest()


def start(num_frames: int = 5, manifest: Manifest = MANIFEST) -> StartRecord:
    return StartRecord(0, num_frames, manifest.to_json())


KEYFRAME, SLICES = records_from_0(8)
ALL: list[Record] = [KEYFRAME, *SLICES[:4]]
"""Frames 0 to 4, a segment."""
CUT = answer(start(), *ALL[:2])
MISPLACED = SliceRecord(1, SLICES[1].packets, SLICES[0].skip_map)
"""A slice with the layers of the next slice."""


def open_play(
    url: str, retry: RetryConfig = PATIENT, config: FetchConfig | None = None
) -> ServedSource:
    fetcher = Fetcher(config=config)
    try:
        return ServedSource("S", f"{url}/v1/streams/s", fetcher, FrameRange(), None, retry)
    except BaseException:
        fetcher.close()
        raise


@contextmanager
def played(
    *answers: bytes, retry: RetryConfig = PATIENT, config: FetchConfig | None = None
) -> Iterator[tuple[ScriptedHost, ServedSource]]:
    """A host that gives `answers`, and a play of its stream."""
    with script(*answers) as host, closing(open_play(host.url, retry, config)) as source:
        yield host, source


def births_from(*answers: bytes, **options: Any) -> tuple[list[int], list[str]]:
    with played(*answers, **options) as (host, source):
        births = [slice.birth for one in assembled(source) for slice in one.slices]
        return births, host.asked


def test_a_response_cut_anywhere_is_taken_up_again() -> None:
    whole = answer(start(), *ALL, EndRecord(5))
    first = len(answer(start()))
    for cut in (first, first + 1, first + 200, len(whole) - 3):
        births, asked = births_from(whole[:cut], whole)
        assert births == [*range(1 - SWIN_SIZE, 5)]
        # After all data, a missing end record does not need another connection.
        assert len(asked) == (1 if cut == len(whole) - 3 else 2)


def test_a_new_connection_asks_for_what_is_missing_only() -> None:
    resumed = answer(StartRecord(3, 5, MANIFEST.to_json()), *ALL, EndRecord(5))
    live = MANIFEST.with_live(True)
    later = answer(StartRecord(4, 5, live.to_json()), KEYFRAME, *SLICES, EndRecord(8))
    stopping = answer(start(), *ALL[:4], ErrorRecord("the server is stopping"))
    unavailable = b"HTTP/1.1 503 Busy\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
    for answers, end, again in (
        ((answer(start(), *ALL[:3]), resumed), 5, 3),
        # At the edge of a live stream the missing frame 5 does not exist yet.
        ((answer(start(1, live), *ALL), later), 8, 4),
        ((stopping, unavailable, answer(start(), *ALL, EndRecord(5))), 5, 4),
    ):
        births, asked = births_from(*answers)
        assert births == [*range(1 - SWIN_SIZE, end)]
        froms = (0, *[again] * (len(answers) - 1))
        assert asked == [f"/v1/streams/s/play?from={n}&layers=auto&reports=1" for n in froms]


@pytest.mark.parametrize(
    ("answers", "error", "message"),
    [
        ([b"garbage"], BrokenError, "v1/streams/s/play.*broke"),
        ([HEAD + b"\xff\xff\xff\xff"], CorruptError, "record of 4294967295 bytes"),
        ([HEAD + b"\x01\0\0\0\xc0"], CorruptError, "S: play"),
        ([answer(EndRecord(3))], CorruptError, "does not begin with a start record"),
        ([answer(StartRecord(0, 3, b"{}"))], CorruptError, "S: manifest"),
        ([answer(StartRecord(0, 3, b'{"version"; 1}'))], CorruptError, "^S: byte 10: "),
        (
            [answer(start(), KEYFRAME, MISPLACED, *ALL[2:])],
            CorruptError,
            "^S: layer 0 of the slice born at 1: byte 8: ",
        ),
        ([answer(start(), start())], CorruptError, "second start"),
        ([answer(start(), *ALL[1:])], CorruptError, "born at 1 arrived before a keyframe"),
        ([answer(start(), *ALL[:3], EndRecord(5))], CorruptError, "ended before frame 3"),
        ([CUT, answer(start(5, small_manifest(4)))], CorruptError, "replaced by another"),
        ([CUT] * 30, BrokenError, r"early \(tried for \S+ s, \d+ times\)"),
        ([CUT, NO_ANSWER, NO_ANSWER, NO_ANSWER], BrokenError, "did not answer in time"),
        (
            [CUT, *[answer(ErrorRecord("it is damaged"))] * 30],
            BrokenError,
            "reports: it is damaged",
        ),
        ([HEAD.replace(b"x-swings-play", b"json") + b"{}"], FetchError, "S is not a stream"),
        ([REFUSED], FetchError, "S: HTTP 400, from=0: no"),
        ([NO_INDEX], FetchError, "S is not a stream: HTTP 404"),
    ],
)
def test_hostile_servers(answers: list[bytes], error: type[SwingsError], message: str) -> None:
    """An answer that does not come is waited for no longer than `idle_s`."""
    config = FetchConfig(idle_s=0.4) if NO_ANSWER in answers else None
    with pytest.raises(error, match=message) as caught:
        births_from(*answers, retry=QUICK, config=config)
    assert "\n" not in str(caught.value)
    if isinstance(caught.value, CorruptError) and caught.value.at is not None:
        assert f"byte {caught.value.at}: " in str(caught.value)


NAMED = HEAD.replace(b"\r\n\r\n", f"\r\n{PLAY_HEADER}: abc-_1\r\n\r\n".encode())


@pytest.mark.parametrize(
    ("status", "listens", "asked"),
    [(b"405 No", False, 1), (b"404 No", True, 1), (b"500 No", True, 2)],
)
def test_what_a_server_answers_decides_who_is_told_more(
    status: bytes, listens: bool, asked: int
) -> None:
    with played(answer(start(), *ALL)) as (host, source):  # it names no play
        assert not source.send_status(ClientStatus(1))
        assert len(host.asked) == 1
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
    monkeypatch.setattr("player.source.served.REPORT_S", 1e6)  # no report but that one
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
    heard = b"HTTP/1.1 204 Heard\r\n%s: %s\r\n%s: 300\r\n%s: 50\r\nConnection: close\r\n\r\n"
    names = RATE_HEADER, NUM_FRAMES_HEADER, REPORT_HEADER
    heard %= names[0].encode(), said, names[1].encode(), names[2].encode()
    with played(cut, heard, NO_INDEX, answer(start(), *ALL)) as (host, source):
        assert source.report_s == 1
        assert source.send_status(ClientStatus(2))
        assert (source.report_s, source.num_frames) == (0.05, 300)
        body = json.loads(host.requests[1].partition(b"\r\n\r\n")[2])
        (_, num_bytes) = body["received"][-1]
        assert num_bytes <= len(cut) - len(NAMED)
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


def test_a_loop_names_the_play_before() -> None:
    whole = answer(start(), *ALL).replace(HEAD, NAMED)
    with script(whole, whole) as host, closing(Opener(f"{host.url}/v1/streams/s")) as opener:
        for _ in range(2):
            with closing(opener.open(FrameRange(), None)) as source:
                assert len(list(source.packets())) == 5
        first, second = (request for request in host.requests if request.startswith(b"GET "))
        assert PLAY_HEADER.encode() not in first
        assert f"{PLAY_HEADER}: abc-_1".encode() in second


def test_points_are_thinned_out_and_the_newest_stays() -> None:
    points = ReceivedPoints()
    for number in range(1000):
        points.add(number / 1000, 10)
    taken = points.take()
    assert len(taken) <= MAX_POINTS
    assert taken[-1] == (999, 10_000)
    assert all(num_bytes == 10 * (at_ms + 1) for at_ms, num_bytes in taken)
    assert points.take() == ()
