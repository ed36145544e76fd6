"""Paths in untrusted files never reach the file system.

The objects are in a folder beside the stream, and the manifest names them there in every possible
way. Code that followed the manifest would find them and succeed; so all code must fail.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from codec.errors import CodecError, SwingsError
from codec.interop.formats import SplatFormat, export_stream
from codec.storage.folder import FolderStorage
from codec.stream import StreamReader, StreamWriter
from codec.tools.audit import verify_stream
from player.network.fetch import Fetcher, FetchError
from player.source.opener import opened
from server.library import ServedStream
from server.library.streamview import view_of
from tests.support.delivery.assembled import assembled
from tests.support.hostile import refused
from tests.support.tiny_stream import append_tiny, write_tiny


@pytest.fixture(params=["../secret", "{root}/secret", "file://{root}/secret", "x/../../secret"])
def astray(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A stream whose manifest gives a path to objects in a folder outside the stream."""
    path = tmp_path / "stream"
    write_tiny(path, 6)
    shutil.move(path / "segments", tmp_path / "secret")
    (path / "segments").mkdir()
    way = request.param.replace("{root}", str(tmp_path))
    value = json.loads((path / "manifest.json").read_bytes())
    value["object_url"] = way + "/{segment}/{layer}"
    value["poster"] = value["title"] = way + "/0/0"
    value["default_camera"] = value["cameras"][0]["name"] = "../secret/0/0"
    (path / "manifest.json").write_text(json.dumps(value), encoding="utf-8")
    return path


def play(path: Path) -> None:
    with opened(str(path)) as source:
        list(assembled(source))


def read_served(path: Path) -> None:
    manifest_json, index = (path / "manifest.json").read_bytes(), (path / "index.bin").read_bytes()
    ServedStream("x", FolderStorage(path), view_of(manifest_json, index)).read_object(0, 0)


READERS: dict[str, Callable[[Path], object]] = {
    "verify": verify_stream,
    "reader": lambda path: StreamReader(path).slice(0, 1),
    "export": lambda p: export_stream(p, p.parent / "o.ply", 0, None, SplatFormat.PLY, None),
    "player": play,
    "server": read_served,
}


def test_nobody_follows_the_manifest_out_of_its_folder(astray: Path) -> None:
    for read in READERS.values():
        refused(CodecError, r"segments/0/(0|keyframe-0) is missing", read, astray)
    path = astray.parent / "written"
    before = sorted(astray.parent.iterdir())
    hostile = StreamReader(astray).manifest
    with StreamWriter.create(path, hostile) as writer:
        append_tiny(writer, 4)
    assert verify_stream(path).num_frames == 4
    assert sorted(astray.parent.iterdir()) == sorted([*before, path])
    assert sorted(p.name for p in path.iterdir()) == ["index.bin", "manifest.json", "segments"]


@pytest.mark.parametrize("via", [None, ("127.0.0.1", 9)])
def test_a_player_fetches_no_files(tmp_path: Path, via: tuple[str, int] | None) -> None:
    (tmp_path / "secret").write_text("secret", encoding="utf-8")
    fetcher = Fetcher(via)
    try:
        refused(FetchError, "", fetcher.get, f"file://{tmp_path}/secret", 100)
    finally:
        fetcher.close()
    with pytest.raises(SwingsError, match="only http"), opened(f"file://{tmp_path}/secret"):
        pass
