"""Sources: the same slices from a folder, a static host and a server, whatever networks do."""

from __future__ import annotations

import re
import shutil
import threading
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

from codec.errors import CorruptError, InvalidError, SwingsError
from codec.framerange import FrameRange
from codec.stream import StreamReader, StreamWriter
from player.link.linkprocess import LinkProcess
from player.link.linktext import read_link
from player.network.fetch import BrokenError, Fetcher, FetchError
from player.network.retry import RetryConfig
from player.source.opener import opened
from player.source.served import ServedSource
from tests.support.delivery.assembled import assembled, checked, read_all, slices_of
from tests.support.hosted_streams import (
    SWIN_SIZE,
    ServerProcess,
    random_slice,
    served,
    small_manifest,
    static_host,
    write_stream,
)

QUICK = RetryConfig(patience_s=0.1, first_delay_s=0.01, max_delay_s=0.01)


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("library")
    write_stream(root / "one", 13)
    return root


@pytest.fixture(scope="module")
def endless(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A library of one stream, longer than the server sends ahead: it can die in the middle."""
    root = tmp_path_factory.mktemp("endless")
    write_stream(root / "long", 300, sh_degree=0, slice_size=8, fps=40.0, segment_frames=50)
    return root


@pytest.fixture(scope="module")
def server(library: Path) -> Iterator[ServerProcess]:
    with served(library) as server:
        yield server


@pytest.mark.parametrize("layers", [1, 2, 3, None])
@pytest.mark.parametrize(
    "frames", [FrameRange(), FrameRange(3, 9), FrameRange(12), FrameRange(0, 1)]
)
def test_every_source_gives_the_slices_of_the_reader(
    library: Path, server: ServerProcess, layers: int | None, frames: FrameRange
) -> None:
    reader = StreamReader(library / "one")
    count = layers or 3
    births = range(frames.first - SWIN_SIZE + 1, frames.end or 13)
    with static_host(library) as host:
        sources = [str(library / "one"), f"{host}/one", f"{host}/one/manifest.json"]
        if layers is not None:
            sources.append(f"{server.url}/v1/streams/one")
        for source in sources:
            got = read_all(source, frames, layers)
            assert [slice.birth for slice in slices_of(got)] == list(births)
            assert list(checked(reader, got, count))
            assert {one.layers for one in got} == {count}
            assert all(one.wire_bytes > 0 for one in got)


def test_all_forms_of_a_server_s_url(server: ServerProcess) -> None:
    for form in ("", "/", "/watch/one", "/watch/one/", "/v1/streams/one"):
        got = read_all(server.url + form)
        assert sorted({slice.birth for slice in slices_of(got)}) == list(range(1 - SWIN_SIZE, 13))
        assert all(1 <= one.layers <= 3 for one in got)
    # The server's objects are also a static stream.
    assert len(read_all(f"{server.url}/v1/streams/one/manifest.json")) == 13


def test_the_addresses_on_the_server_s_pages_can_be_played(server: ServerProcess) -> None:
    with urllib.request.urlopen(f"{server.url}/watch/one", timeout=10) as response:
        page = response.read().decode()
    (address,) = set(re.findall(r"swings-play ([^\s<]+)", page))
    assert address == f"{server.url}/watch/one"
    assert len(read_all(address)) == 13


def test_what_a_source_says_before_its_slices(library: Path, server: ServerProcess) -> None:
    manifest = StreamReader(library / "one").manifest
    for name in (str(library / "one"), server.url):
        with opened(name, FrameRange(2)) as source:
            assert source.name == name
            assert source.frames == FrameRange(2, 13)
            assert source.manifest.to_json() == manifest.to_json()


@pytest.mark.parametrize(
    ("frames", "layers", "message"),
    [
        (FrameRange(13), None, "there is no frame 13|has 13 frames"),
        (FrameRange(0, 14), None, "there is no frame 13"),
        (FrameRange(), 4, "layers"),
    ],
)
def test_what_a_stream_does_not_have(
    library: Path, server: ServerProcess, frames: FrameRange, layers: int | None, message: str
) -> None:
    with static_host(library) as host:
        for source in (str(library / "one"), f"{host}/one", f"{server.url}/watch/one"):
            with pytest.raises(SwingsError, match=message):
                read_all(source, frames, layers)


def test_a_server_of_many_streams_names_them(library: Path, tmp_path: Path) -> None:
    shutil.copytree(library / "one", tmp_path / "first")
    shutil.copytree(library / "one", tmp_path / "second")
    with served(tmp_path) as server:
        with pytest.raises(FetchError, match="2 streams: first, second; choose one"):
            read_all(server.url)
        with pytest.raises(FetchError, match="is not a stream: HTTP 404, no stream is named"):
            read_all(f"{server.url}/watch/third")


def test_what_is_not_a_stream(tmp_path: Path, server: ServerProcess) -> None:
    (tmp_path / "manifest.json").write_text("<html>")
    (tmp_path / "empty").mkdir()
    with static_host(tmp_path) as host:
        for url in (host, f"{host}/nothing", f"{host}/empty", f"{server.url}/elsewhere"):
            with pytest.raises(FetchError, match="is not a stream"):
                read_all(url)
    with pytest.raises(BrokenError, match="cannot connect: Connection refused"):
        read_all(host)
    for nonsense in ("ftp://host/x", "http:///x", "http://host:port/x"):
        with pytest.raises(SwingsError):
            read_all(nonsense)
    with pytest.raises(CorruptError, match="is not a folder"):
        read_all(str(tmp_path / "absent"))


@pytest.mark.parametrize("damage", ["altered", "short", "missing"])
def test_a_damaged_object_is_named(library: Path, tmp_path: Path, damage: str) -> None:
    shutil.copytree(library / "one", tmp_path / "s")
    path = tmp_path / "s" / "segments" / "1" / "0"
    data = path.read_bytes()
    if damage == "altered":
        path.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    elif damage == "short":
        path.write_bytes(data[:-1])
    else:
        path.unlink()
    with static_host(tmp_path) as host:
        for source in (str(tmp_path / "s"), f"{host}/s"):
            with pytest.raises(SwingsError, match="segments/1/0"):
                read_all(source)


def test_through_a_link_the_slices_are_the_same(library: Path, server: ServerProcess) -> None:
    with LinkProcess(read_link("2M,5ms"), "127.0.0.1", server.port) as relay:
        with opened(server.url, FrameRange(), 3, relay.address) as source:
            got = list(assembled(source))
        assert relay.down_bytes > sum(one.wire_bytes for one in got)
    assert len(list(checked(StreamReader(library / "one"), got, 3))) == 13


def test_a_live_stream_is_followed_to_its_end(tmp_path: Path) -> None:
    root = tmp_path / "library"
    with (
        StreamWriter.create(root / "live", small_manifest()) as writer,
        served(root) as server,
        # Nothing stands yet: the source waits for the first segment.
        opened(server.url, layers=2) as source,
    ):
        assert source.frames.end is None

        def write() -> None:
            for birth in range(1 - SWIN_SIZE, 23):
                writer.append(random_slice(birth))
                time.sleep(0.01)
            writer.close()

        thread = threading.Thread(target=write)
        thread.start()
        got = list(assembled(source))
        thread.join()
    assert len(list(checked(StreamReader(root / "live"), got, 2))) == 23


def test_a_server_that_stays_away_ends_in_one_line(endless: Path) -> None:
    server = ServerProcess(endless)
    source = ServedSource(
        "the stream", f"{server.url}/v1/streams/long", Fetcher(), FrameRange(), None, QUICK
    )
    packets = source.packets()
    next(packets)
    server.kill()
    said = r"^\S+: cannot connect: Connection refused \(tried for 0\.\d+ s, \d+ times\)$"
    with pytest.raises(BrokenError, match=said):
        list(packets)
    source.close()


def test_layers_and_frames_are_checked_before_anything_is_sent(library: Path) -> None:
    with pytest.raises(InvalidError, match="--layers 9"):
        read_all(str(library / "one"), layers=9)
