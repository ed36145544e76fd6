"""Sources: a folder, a static host and a server, by all their names, and what they do not have."""

from __future__ import annotations

import re
import shutil
import urllib.request
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from codec.errors import CorruptError, InvalidError, SwingsError
from codec.framerange import FrameRange
from codec.stream import StreamReader
from player.network.fetch import BrokenError, FetchError
from player.source.opener import opened
from tests.support.delivery.assembled import read_all, slices_of
from tests.support.hosted_streams import SWIN_SIZE, ServerProcess, served, static_host, write_stream
from tests.support.hostile import put_object


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("library")
    write_stream(root / "one", 13)
    return root


@pytest.fixture(scope="module")
def server(library: Path) -> Iterator[ServerProcess]:
    with served(library) as server:
        yield server


def test_all_forms_of_a_server_s_url(server: ServerProcess) -> None:
    for form in ("", "/", "/watch/one", "/watch/one/", "/v1/streams/one"):
        got = read_all(server.url + form)
        assert sorted({slice.birth for slice in slices_of(got)}) == list(range(1 - SWIN_SIZE, 13))
        assert all(1 <= one.layers <= 3 for one in got)
    # The server's objects are also a static stream.
    assert len(read_all(f"{server.url}/v1/streams/one/manifest.json")) == 13


def test_a_static_stream_by_its_folder_or_its_manifest(library: Path) -> None:
    with static_host(library) as host:
        for form in ("one", "one/manifest.json"):
            got = read_all(f"{host}/{form}", FrameRange(3, 9), 2)
            births = [slice.birth for slice in slices_of(got)]
            assert births == list(range(3 - SWIN_SIZE + 1, 9))
            assert {one.layers for one in got} == {2}


def test_layers_are_checked_before_anything_is_sent(library: Path) -> None:
    with pytest.raises(InvalidError, match="--layers 9"):
        read_all(str(library / "one"), layers=9)


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
        for url in (f"{host}/nothing", f"{host}/empty", f"{server.url}/elsewhere"):
            with pytest.raises(FetchError, match="is not a stream"):
                read_all(url)
        with pytest.raises(FetchError, match=r"manifest\.json: byte 0: .*; this is not a stream$"):
            read_all(host)
    with pytest.raises(BrokenError, match="cannot connect: Connection refused"):
        read_all(host)
    with pytest.raises(InvalidError, match="only http:// and https:// URLs"):
        read_all("ftp://host/x")
    with pytest.raises(CorruptError, match="is not a folder"):
        read_all(str(tmp_path / "absent"))


@pytest.mark.parametrize(
    ("part", "damage"),
    [
        ("0", "altered"),
        ("0", "short"),
        ("0", "missing"),
        ("masks", "altered"),
        ("snapshot-0", "altered"),
    ],
)
def test_a_damaged_object_is_named(library: Path, tmp_path: Path, part: str, damage: str) -> None:
    shutil.copytree(library / "one", tmp_path / "s")
    path = tmp_path / "s" / "segments" / "1" / part
    data = path.read_bytes()
    if damage == "altered":
        path.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    elif damage == "short":
        path.write_bytes(data[:-1])
    else:
        path.unlink()
    with static_host(tmp_path) as host:
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
