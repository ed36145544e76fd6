"""Limits of an untrusted server: time, names, text for a terminal, and memory: no more than the
manifest declares."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from itertools import count
from pathlib import Path
from socketserver import BaseRequestHandler, ThreadingTCPServer
from types import SimpleNamespace
from urllib.parse import urlsplit

import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from codec.errors import CorruptError, SwingsError
from codec.framerange import FrameRange
from codec.stream import StreamReader
from codec.stream.manifest import Manifest
from codec.stream.playrecord import LENGTH, KeyframeRecord, Record, SliceRecord, encode_record
from codec.stream.segment import pack_record
from player.network.fetch import FetchConfig, Fetcher, FetchError, Response
from player.network.target import BrokenError, joined
from player.source.opener import SourceConfig, opened
from player.source.served import KEPT_BIRTHS, PlayReceiver
from server.abr.clientstatus import ClientStatus
from tests.player.network.webhosts import HOLD, script
from tests.player.source.test_served import (
    ALL,
    HEAD,
    KEYFRAME,
    MANIFEST,
    QUICK,
    SLICES,
    answer,
    open_play,
    start,
)
from tests.support.commands import run
from tests.support.delivery.assembled import assembled
from tests.support.hosted_streams import answering, small_manifest, static_host, write_stream
from tests.support.hostile import within_bytes


@contextmanager
def endless(first: bytes, again: Callable[[int], bytes], every_s: float = 0.0) -> Iterator[str]:
    """The URL of a host that answers each request with `first`, and then with `again` for ever."""
    over = threading.Event()

    class Handler(BaseRequestHandler):
        def handle(self) -> None:
            with suppress(OSError):
                self.request.recv(65536)
                self.request.sendall(first)
                for number in count():
                    if over.wait(every_s):
                        return
                    self.request.sendall(again(number))

    server = ThreadingTCPServer(("127.0.0.1", 0), Handler)
    with answering(server):
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}"
        finally:
            over.set()


def records(*some: Record) -> bytes:
    return b"".join(map(encode_record, some))


BEGUN = answer(start(), *ALL[:2])
NAMED = HEAD.replace(b"Connection", b"Swings-Play: abc\r\nConnection")
IDLE = FetchConfig(idle_s=0.4)
"""For hosts that are silent; every other limit below ends by what is sent."""


@pytest.fixture
def looks(monkeypatch: pytest.MonkeyPatch) -> count[int]:
    """Makes each look at the clock of an answer take a second; the number of the next look."""
    seconds = count()
    clock = SimpleNamespace(monotonic=lambda: float(next(seconds)), time=time.time)
    for module in ("player.network.fetch", "player.source.served"):
        monkeypatch.setattr(f"{module}.time", clock)
    return seconds


@pytest.mark.usefixtures("looks")
def test_bytes_of_no_use_do_not_keep_a_play_waiting() -> None:
    no_use = r"\d+ bytes arrived in \d+ s, but no usable data$"
    for begun, again in (
        (BEGUN, records(*ALL[:2])),  # what is known already
        (BEGUN + LENGTH.pack(1_000_000), b"\0"),  # a record, byte by byte
    ):
        with (
            endless(begun, lambda n, again=again: again) as url,  # type: ignore[misc]
            closing(open_play(url)) as source,
            pytest.raises(FetchError, match=no_use) as error,
        ):
            list(source.packets())
        assert not isinstance(error.value, BrokenError)
    head = b"HTTP/1.1 200 OK\r\nContent-Length: 9000000\r\n\r\n"
    with (
        endless(head, lambda n: b"{") as url,
        closing(Fetcher()) as fetcher,
        pytest.raises(BrokenError, match=no_use),
    ):
        fetcher.get(url, 9_000_000)


@pytest.mark.parametrize(
    ("first", "again", "every_s", "message"),
    [
        (b"", lambda n: b"HTTP/1.1 100 Continue\r\n\r\n", 0.01, "did not answer in time"),
        (b"HTTP/1.1 200 OK\r\n", lambda n: b"X-%d: 1\r\n" % n, 0.05, "did not answer in time"),
        (BEGUN, lambda n: b"", 0.05, r"no bytes arrived for \d+ s|did not answer in time"),
        (BEGUN, lambda n: records(SLICES[min(n + 1, 6)]), 0.0, "born at 5 .* ends before frame 5"),
        (BEGUN, lambda n: b"\x02\0\0\0\x80\xc0", 0.0, "play: "),
        (b"", lambda n: b"junk" * 1000, 0.0, "the connection broke"),
    ],
    ids=["continue", "head", "frozen", "more", "kinds", "junk"],
)
def test_junk_does_not_keep_a_play_waiting(
    first: bytes, again: Callable[[int], bytes], every_s: float, message: str
) -> None:
    config = IDLE if every_s else None
    with (
        endless(first, again, every_s) as url,
        pytest.raises(SwingsError, match=message) as caught,
        closing(open_play(url, QUICK, config)) as source,
    ):
        list(source.packets())
    assert len(str(caught.value).splitlines()) == 1


def test_who_pauses_is_owed_nothing(looks: count[int], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("player.source.served.LOOK_S", 0.001)
    heard = b"HTTP/1.1 204 Heard\r\nConnection: close\r\n\r\n"
    first = answer(start(), *ALL[:4]).replace(HEAD, NAMED)
    with script(first + HOLD, heard, heard) as host, closing(open_play(host.url)) as source:
        packets = source.packets()
        for _ in range(4):
            next(packets)
        assert source.send_status(ClientStatus(1, paused=True))
        end = next(looks) + 10 * FetchConfig().idle_s
        read = Response.read

        def reading(response: Response, timeout_s: float) -> bytes | None:
            if next(looks) > end:
                source.interrupt()
            return read(response, timeout_s)

        monkeypatch.setattr(Response, "read", reading)
        with pytest.raises(SwingsError, match=r"stopped$"):
            next(packets)
        assert len(host.asked) == 3


# --- where a stream may lead


AWAY = r"leads to another host, .*; allow it with --other-hosts"
WRONG = r"^http://a/s/m leads to .*, which is not"


@pytest.mark.parametrize(
    ("reference", "here", "anywhere"),
    [
        ("segments/1/2", "http://a/s/segments/1/2", None),
        ("/x", "http://a/x", None),
        ("http://a:80/x", "http://a:80/x", None),
        ("http://A/x", "http://A/x", None),
        ("//a/x", "http://a/x", None),
        ("https://a/x", "https://a/x", None),
        ("http://b/x", None, "http://b/x"),
        ("//b/x", None, "http://b/x"),
        ("http://a:81/x", None, "http://a:81/x"),
        ("http://a@b/x", None, "http://a@b/x"),
        ("https://b/x", None, "https://b/x"),
        *((wrong, None, None) for wrong in ("http://[", "http://[/x", "http://a:99999/")),
        *((wrong, None, None) for wrong in ("file:///x", "javascript:1", "ftp:/x")),
    ],
)
def test_another_host_is_followed_when_told(
    reference: str, here: str | None, anywhere: str | None
) -> None:
    for other_hosts, url in ((False, here), (True, here or anywhere)):
        if url is not None:
            assert joined("http://a/s/m", reference, other_hosts) == url
            continue
        with pytest.raises(FetchError, match=AWAY if anywhere else WRONG):
            joined("http://a/s/m", reference, other_hosts)
    with pytest.raises(FetchError, match="not encrypted"):
        joined("https://a/", "http://a/", other_hosts=True)


@given(st.text() | st.from_regex(r"\A(https?:)?//[\[\]:@0-9a-z./%-]{0,12}\Z"), st.booleans())
def test_any_reference_is_a_url_or_an_error(reference: str, other_hosts: bool) -> None:
    try:
        url = joined("http://a/s/manifest.json", reference, other_hosts)
    except FetchError:
        return
    host = urlsplit(url).hostname
    assert host
    assert other_hosts or host == "a"


def test_manifests_and_redirects_stay_on_their_host(tmp_path: Path) -> None:
    write_stream(tmp_path / "s", 13)
    write_stream(tmp_path / "away", 13, object_url="//elsewhere/{segment}/{layer}")
    to = b"HTTP/1.1 302 Found\r\nLocation: %s\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
    with (
        static_host(tmp_path) as host,
        script(*[to % f"{host}/s/manifest.json".encode()] * 2) as first,
        script(*[to % b"/s/manifest.json"] * 9) as circles,
    ):
        for url, message in (
            (f"{host}/away", r"away/manifest\.json leads to another host"),
            (f"{first.url}/s", "leads to another host"),
            (f"{circles.url}/s", "more than 5 redirects"),
        ):
            with pytest.raises(FetchError, match=message), opened(url) as source:
                list(source.packets())
        assert len(circles.asked) == 5
        config = SourceConfig(QUICK, other_hosts=True)
        with opened(f"{first.url}/elsewhere", config=config) as source:
            assert len(list(source.packets())) == 13
        assert first.asked == ["/s/manifest.json", "/elsewhere/manifest.json"]


# --- what reaches a terminal

EVIL = "\x1b]0;owned\x07\x1b[2J\x9b31m\u202eevil"


def test_no_escape_sequence_of_a_server_reaches_the_terminal(tmp_path: Path) -> None:
    refusal = json.dumps({"error": EVIL}).encode()
    head = b"HTTP/1.1 400 No\r\nConnection: close\r\nContent-Length: %d\r\n\r\n"
    with script(head % len(refusal) + refusal) as host:
        done = run("swings-play", f"{host.url}/v1/streams/s", "--capture", tmp_path / "a")
    # The names of a stream and of its cameras, in what is shown, in a warning and in an error.
    camera = small_manifest().cameras[0]
    wide = type(camera)(EVIL, 16384, 64, 60.0, 60.0, 8192.0, 32.0, camera.w2c)
    stream = write_stream(tmp_path / "s", 1, cameras=(wide,), default_camera=EVIL, title=EVIL)
    words = (stream, "--renderer", "cpu", "--capture")
    found = [
        done,
        run("swings-play", *words, tmp_path / "b", "--camera", "camera:x"),
        run("swings-play", *words, tmp_path / "c"),
        run("swings-stream", "info", stream),
    ]
    assert [done.returncode for done in found] == [1, 1, 0, 0]
    for done in found[:2]:
        assert "evil" in done.stderr
    assert "evil" in found[3].stdout
    text = "".join(done.stdout + done.stderr for done in found)
    assert not any(not one.isprintable() and one != "\n" for one in text)
    # An enormous camera is drawn at a sane size.
    assert "has 16384x64 pixels; drawing 4096x16 (--size sets another size)" in found[2].stderr
    with Image.open(next((tmp_path / "c").iterdir())) as picture:
        assert picture.size == (4096, 16)


# --- how much memory it may take


def claiming(size: int) -> bytes:
    """The first part of a packet that claims `size` bytes."""
    compressor = zstandard.ZstdCompressor(write_checksum=True).compressobj(size)
    packet = compressor.compress(bytes(1 << 20))
    return packet + compressor.flush(zstandard.COMPRESSOBJ_FLUSH_BLOCK)


HUGE = claiming(64 << 20)


@pytest.mark.parametrize(
    ("records", "place"),
    [
        ([KeyframeRecord(0, 0, (HUGE,))], "layer 0 of the keyframe of frame 0"),
        ([KEYFRAME, SliceRecord(1, (HUGE,), SLICES[0].skip_map)], "layer 0 of the slice born at 1"),
        (
            [KEYFRAME, SliceRecord(1, SLICES[0].packets, HUGE)],
            "the skip map of the slice born at 1",
        ),
    ],
)
def test_a_packet_that_claims_more_than_its_part_can_hold_is_not_inflated(
    records: list[Record], place: str
) -> None:
    with (
        within_bytes(8 << 20),
        script(answer(start(), *records)) as host,
        closing(open_play(host.url)) as source,
        pytest.raises(CorruptError, match=f"^S: {place}: packet"),
    ):
        list(assembled(source))


def receiver_of(manifest: Manifest = MANIFEST, frames: FrameRange | None = None) -> PlayReceiver:
    """A receiver with the keyframe of frame 0."""
    receiver = PlayReceiver("S", manifest, 3, frames or FrameRange())
    assert receiver.ingest(KEYFRAME) is not None
    return receiver


def test_what_comes_again_counts_once_and_is_not_held() -> None:
    receiver, whole = receiver_of(), SLICES[0]
    first = SliceRecord(1, whole.packets[:1], whole.skip_map)
    assert receiver.ingest(first) is not None
    with within_bytes(100_000):
        for _ in range(1000):
            assert receiver.ingest(first) is None
            assert receiver.ingest(KEYFRAME) is None
    both = receiver.ingest(SliceRecord(1, whole.packets[:2], whole.skip_map))
    assert both is not None
    assert both.first_layer == 1
    assert both.packets == whole.packets[1:2]


def test_a_record_that_no_slice_fills_is_not_waited_for() -> None:
    begun = answer(start()) + LENGTH.pack(60 << 20)
    with (
        endless(begun, lambda n: bytes(1 << 16)) as url,
        within_bytes(6 << 20),
        closing(open_play(url)) as source,
        pytest.raises(CorruptError, match=r"a record of 62914560 bytes, at most 1\d{6}$"),
    ):
        list(source.packets())


def test_slices_that_nobody_asked_for_and_slices_that_came_are_not_held() -> None:
    receiver = receiver_of(MANIFEST.with_live(True))
    with pytest.raises(CorruptError, match=r"born at 1: packet: 1000000 bytes; the manifest"):
        receiver.ingest(SliceRecord(1, (bytes(1_000_000),), b""))
    with within_bytes(100_000):
        for birth in range(100, 10_000):
            assert receiver.ingest(SliceRecord(birth, (b"zz",), None, 1)) is None
            assert receiver.ingest(SliceRecord(-birth, (b"zz",), b"zz")) is None
    with within_bytes(6 << 20):
        for birth in range(1, 4 * KEPT_BIRTHS):
            assert receiver.ingest(SliceRecord(birth, (b"zz",), b"zz")) is not None
    assert receiver.ingest(SliceRecord(0, (b"zz",), None, 1)) is None
    receiver = receiver_of(frames=FrameRange(0, 3))
    with pytest.raises(
        CorruptError, match=r"^S: the slice born at 3 arrived, but the play ends before frame 3"
    ):
        receiver.ingest(SliceRecord(3, (b"zz",), None, 1))


def test_an_object_that_no_manifest_allows_is_not_fetched(tmp_path: Path) -> None:
    path = write_stream(tmp_path / "s", 13)
    records = StreamReader(path).records
    first = records[0]
    sizes = (1 << 30, *first.object_bytes[1:])
    false = replace(first, object_bytes=sizes)
    (path / "index.bin").write_bytes(pack_record(false) + pack_record(records[1]))
    with static_host(tmp_path) as host:
        for name in (f"{host}/s", str(path)):
            with (
                within_bytes(8 << 20),
                pytest.raises(CorruptError, match="segment 0 names an object of 1073741824 bytes"),
                opened(name) as source,
            ):
                list(source.packets())
