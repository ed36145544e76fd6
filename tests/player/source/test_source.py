"""Sources: a folder, a static host and a server, by all their names, what they do not have, and
opened again and again, as for seeks."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from itertools import islice
from pathlib import Path

import pytest

from codec.errors import CorruptError, SwingsError
from codec.framerange import FrameRange
from codec.stream import StreamReader
from player.network.fetch import Fetcher, StoppedError
from player.source.opener import Opener
from tests.player.network.webhosts import NO_ANSWER, script
from tests.player.source.test_served import answer, start
from tests.support.delivery.assembled import assembled, read_all, slices_of
from tests.support.hosted_streams import SWIN_SIZE, ServerProcess, served, static_host, write_stream
from tests.support.hostile import put_object
from tests.support.ports import kept_port


def test_all_forms_of_a_stream_s_url(library: Path, server: ServerProcess) -> None:
    for form in ("", "/", "/watch/one", "/watch/one/", "/v1/streams/one"):
        got = read_all(server.url + form)
        assert sorted({slice.birth for slice in slices_of(got)}) == list(range(1 - SWIN_SIZE, 13))
        assert all(1 <= one.layers <= 3 for one in got)
    # The server's objects are also a static stream.
    assert len(read_all(f"{server.url}/v1/streams/one/manifest.json")) == 13
    with static_host(library) as host:
        for form in ("one", "one/manifest.json"):
            got = read_all(f"{host}/{form}", FrameRange(3, 9), 2)
            births = [slice.birth for slice in slices_of(got)]
            assert births == list(range(3 - SWIN_SIZE + 1, 9))
            assert {one.layers for one in got} == {2}


def test_what_is_not_there(
    library: Path, server: ServerProcess, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("empty", "page"):
        (tmp_path / name).mkdir()
    (tmp_path / "page" / "manifest.json").write_text("<html>")
    for name in ("first", "second"):
        shutil.copytree(library / "one", tmp_path / name)
    monkeypatch.delattr(Fetcher, "pause")  # what was never there is not waited for
    with static_host(library) as host, static_host(tmp_path) as other, served(tmp_path) as many:
        away = f"http://127.0.0.1:{kept_port()}"
        rows = [
            (f"{other}/nothing", "is not a stream"),
            (f"{other}/empty", "is not a stream"),
            (f"{server.url}/elsewhere", "is not a stream"),
            (f"{other}/page", r"manifest\.json: byte 0: .*; this is not a stream$"),
            (many.url, "2 streams: first, second; choose one"),
            (f"{many.url}/watch/third", "is not a stream: HTTP 404, no stream is named"),
            (away, "cannot connect: Connection refused"),
            (f"{away}/watch/s", "cannot connect: Connection refused"),
            ("ftp://host/x", "only http:// and https:// URLs"),
            (str(tmp_path / "absent"), "is not a folder"),
        ]
        for source, message in rows:
            with pytest.raises(SwingsError, match=message):
                read_all(source)
        for source in (str(library / "one"), f"{host}/one", f"{server.url}/watch/one"):
            for frames, layers, message in (
                (FrameRange(13), None, "there is no frame 13|has 13 frames"),
                (FrameRange(0, 14), None, "there is no frame 13"),
                (FrameRange(), 4, "layers"),
            ):
                with pytest.raises(SwingsError, match=message):
                    read_all(source, frames, layers)


def test_a_damaged_object_is_named(library: Path, tmp_path: Path) -> None:
    with static_host(tmp_path) as host:
        for part in ("0", "skipmaps", "keyframe-0"):
            for damage in ("altered", "short", "missing"):
                shutil.copytree(library / "one", tmp_path / "s", dirs_exist_ok=True)
                path = tmp_path / "s" / "segments" / "1" / part
                data = path.read_bytes()
                path.unlink()
                if damage != "missing":
                    last = bytes([data[-1] ^ 1]) if damage == "altered" else b""
                    path.write_bytes(data[:-1] + last)
                for source in (str(tmp_path / "s"), f"{host}/s"):
                    with pytest.raises(SwingsError, match=f"segments/1/{part}"):
                        read_all(source, FrameRange(5))


@pytest.fixture
def stream(tmp_path: Path) -> Path:
    return write_stream(tmp_path / "s", 13)


def told(stream: Path) -> tuple[str, int | None]:
    """Message, from the folder on, and place of the error when playing `stream` from a host."""
    with static_host(stream.parent) as host, pytest.raises(CorruptError) as caught:
        read_all(f"{host}/s")
    message = str(caught.value)
    assert message.startswith(f"{host}/s/")
    return message.removeprefix(f"{host}/s/"), caught.value.at


def test_a_wrong_record_of_the_index(stream: Path) -> None:
    index = bytearray((stream / "index.bin").read_bytes())
    size = len(index) // 3
    index[size + 20] ^= 1
    (stream / "index.bin").write_bytes(index)
    message, at = told(stream)
    assert at == size
    assert message.startswith(f"index.bin: byte {size}: index: the record of segment 1")


def test_a_wrong_table_and_a_wrong_chunk(stream: Path) -> None:
    # Another segment's table has other births; another layer's chunks are behind a right one.
    manifest = StreamReader(stream).manifest
    elsewhere = replace(manifest, object_url="https://cdn.example/{layer}/{segment}")
    for other, place, what in (("0/0", 20, "object"), ("1/1", 20 + 5 * 12, "change")):
        put_object(stream, 1, 0, (stream / "segments" / other).read_bytes())
        message, at = told(stream)
        assert at == place
        assert message.startswith(f"segments/1/0: byte {place}: {what}: ")
        # From the folder, whose objects have other URLs.
        (stream / "manifest.json").write_bytes(elsewhere.to_json())
        with pytest.raises(CorruptError) as caught:
            read_all(str(stream))
        assert str(caught.value) == f"{stream}/{message}"
        assert caught.value.at == place
        (stream / "manifest.json").write_bytes(manifest.to_json())


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
            restarted.append(ServerProcess(root, first.port))

    with served(root) as first, closing(Opener(f"{first.url}/watch/s")) as opener:
        opener.open(FrameRange(), 3).close()
        first.kill()
        monkeypatch.setattr(Fetcher, "pause", pause)
        with closing(opener.open(FrameRange(35), 3)) as source:
            assert next(assembled(source)).frame == 35
        restarted[0].kill()
