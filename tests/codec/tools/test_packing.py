"""A stream as one file and back, with real files and the commands."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from zipfile import ZipFile

import pytest

import codec
from codec.errors import CodecError, CorruptError, InvalidError
from codec.interop.exporting import export_stream
from codec.stream import StreamReader, StreamWriter
from codec.stream.captions import Captions
from codec.stream.packedstorage import PackedStorage, open_place
from codec.tools.audit import summarise, verify_stream
from codec.tools.packing import pack_stream, unpack_stream, verify_packed
from codec.tools.streamcaptions import add_captions
from tests.support.commands import run_ok
from tests.support.drawn import same_splats
from tests.support.sounding import add_clicks
from tests.support.stores.s3_server import BUCKET, s3_server
from tests.support.tiny_stream import files_of, tiny_manifest, tiny_slice, write_tiny

VTT = b"WEBVTT\n\n00:00.000 --> 00:01.000\nHere\n"
PNG = b"\x89PNG\r\n\x1a\n" + bytes(range(200))


@pytest.fixture
def stream(tmp_path: Path) -> Path:
    """A stream of three segments with pictures, one in a folder whose name is not ASCII."""
    path = tmp_path / "s"
    write_tiny(path, 10)
    manifest = replace(StreamReader(path).manifest, poster="bild/größe.png", storyboard="t.png")
    (path / "manifest.json").write_bytes(manifest.to_json())
    (path / "bild").mkdir()
    (path / "bild" / "größe.png").write_bytes(PNG)
    (path / "t.png").write_bytes(PNG + b"more")
    return path


def test_packing_and_unpacking_loses_nothing(stream: Path, tmp_path: Path) -> None:
    packed = tmp_path / "one.swings"
    made = pack_stream(stream, packed)
    assert (made.num_frames, made.size_bytes) == (10, packed.stat().st_size)
    unpack_stream(packed, tmp_path / "again")
    assert files_of(tmp_path / "again") == files_of(stream)
    pack_stream(tmp_path / "again", tmp_path / "two.swings")
    pack_stream(packed, tmp_path / "three.swings")
    for other in ("two", "three"):
        assert (tmp_path / f"{other}.swings").read_bytes() == packed.read_bytes()
    # ZIP programs accept it as an archive.
    with ZipFile(packed) as archive:
        assert archive.testzip() is None
        archive.extractall(tmp_path / "unzipped")
    assert files_of(tmp_path / "unzipped") == files_of(stream)
    if shutil.which("unzip"):
        tested = subprocess.run(["unzip", "-t", str(packed)], capture_output=True, text=True)
        assert "No errors detected" in tested.stdout, tested.stdout + tested.stderr


def test_sound_and_captions_are_packed_and_unpacked(stream: Path, tmp_path: Path) -> None:
    add_clicks(stream, (0, 4, 9))
    add_clicks(stream, (3,), "voice", ((0.0, 1.0, 2.0, 3.0),))
    for language in ("en", "pt-BR"):
        (tmp_path / "in.vtt").write_bytes(VTT + language.encode())
        add_captions(stream, tmp_path / "in.vtt", Captions(language, language))
    packed = tmp_path / "one.swings"
    made = pack_stream(stream, packed)
    assert (made.num_files, made.size_bytes) == (len(files_of(stream)), packed.stat().st_size)
    verify_stream(packed)
    unpack_stream(packed, tmp_path / "again")
    assert files_of(tmp_path / "again") == files_of(stream)
    pack_stream(tmp_path / "again", tmp_path / "two.swings")
    assert (tmp_path / "two.swings").read_bytes() == packed.read_bytes()
    storage = open_place(packed)
    assert isinstance(storage, PackedStorage)
    with ZipFile(packed) as archive:
        assert archive.testzip() is None
        assert {*archive.namelist()} == {*files_of(stream), ".tracks"}
        for name in archive.namelist():
            assert storage.read(name, 1 << 20) == archive.read(name)
    # A wrong size in the table is found: by the size of the file, or by the headers.
    at, size = storage.layout.find(".tracks") or (0, 0)
    assert size == 4 * (2 + 2 * 3)
    whole = packed.read_bytes()
    for lie in range(at, at + size, 4):
        for by in (1, 255):
            packed.write_bytes(whole[:lie] + bytes([whole[lie] ^ by]) + whole[lie + 1 :])
            with pytest.raises(CorruptError):
                verify_stream(packed)
    (stream / "segments" / "1" / "audio-voice").unlink()
    with pytest.raises(CorruptError, match="audio-voice is missing"):
        pack_stream(stream, packed)


def test_all_that_reads_a_folder_reads_the_file(stream: Path, tmp_path: Path) -> None:
    packed = tmp_path / "one.swings"
    pack_stream(stream, packed)
    assert verify_stream(packed) == verify_stream(stream)
    assert summarise(str(packed)) == summarise(stream)
    for source, name in ((packed, "a.ply"), (stream, "b.ply")):
        export_stream(source, tmp_path / name, 7, None, None, 2)
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()
    with codec.open_stream(packed) as one, codec.open_stream(stream) as other:
        for frame in (0, 9, 4):
            assert same_splats(one.frame(frame, 1), other.frame(frame, 1))
    link = tmp_path / "elsewhere" / "link.swings"
    link.parent.mkdir()
    link.symlink_to(packed)
    assert StreamReader(link).num_frames == 10


def test_a_packed_stream_in_an_object_store(stream: Path, tmp_path: Path) -> None:
    with s3_server() as server:
        pack_stream(stream, tmp_path / "one.swings")
        server.put("place/one.swings", (tmp_path / "one.swings").read_bytes())
        url = f"s3://{BUCKET}/place/one.swings"
        assert verify_stream(url) == verify_stream(stream)
        unpack_stream(url, tmp_path / "again")
        assert files_of(tmp_path / "again") == files_of(stream)


def verify_whole(packed: Path) -> None:
    """Like `verify_stream`, without the contents of chunks: their hashes are enough here."""
    reader = StreamReader(packed)
    for record in reader.records:
        for part in reader.manifest.parts:
            reader.read_object(record.segment, part)
    verify_packed(reader.storage)


def test_every_byte_is_checked(stream: Path, tmp_path: Path) -> None:
    packed = tmp_path / "one.swings"
    pack_stream(stream, packed)
    whole = packed.read_bytes()
    begin = whole.index(b"segments/2/snapshot-1") - 30
    places = [*range(0, 64, 3), *range(begin, begin + 60, 4), *range(64, len(whole), 4999)]
    places += range(len(whole) - 100, len(whole), 7)
    for at in places:
        packed.write_bytes(whole[:at] + bytes([whole[at] ^ 4]) + whole[at + 1 :])
        with pytest.raises(CodecError) as caught:
            verify_whole(packed)
        assert str(caught.value).startswith(str(packed)), at
    for length in (0, 1, 40, 63, 5000, len(whole) - 1):
        packed.write_bytes(whole[:length])
        with pytest.raises(CodecError):
            StreamReader(packed)
    packed.write_bytes(whole)
    verify_whole(packed)


def test_what_cannot_be_packed_is_said_and_leaves_nothing(stream: Path, tmp_path: Path) -> None:
    out = tmp_path / "out" / "one.swings"
    out.parent.mkdir()
    with StreamWriter.create(tmp_path / "live", tiny_manifest()) as writer:
        for birth in range(tiny_manifest().first_birth, 5):
            writer.append(tiny_slice(birth))
        with pytest.raises(InvalidError, match="live is live; pack it when it is finished"):
            pack_stream(tmp_path / "live", out)
    for name in ("one.zip", "one"):
        with pytest.raises(InvalidError, match=r"ends with \.swings"):
            pack_stream(stream, out.with_name(name))
    with pytest.raises(InvalidError, match="is not a packed stream"):
        unpack_stream(stream, tmp_path / "again")
    data = (stream / "segments" / "1" / "1").read_bytes()
    (stream / "segments" / "1" / "1").write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    with pytest.raises(CodecError, match="segments/1/1: object: was altered"):
        pack_stream(stream, out)
    with pytest.raises(CodecError, match=r"none\.swings does not exist"):
        StreamReader(tmp_path / "none.swings")
    assert list(out.parent.iterdir()) == []


def test_the_commands(stream: Path, tmp_path: Path) -> None:
    packed, again = tmp_path / "one.swings", tmp_path / "again"
    told = run_ok("swings-stream", "pack", stream, packed)
    assert told == f"{packed}: 10 frames in one file, {packed.stat().st_size} bytes\n"
    told = run_ok("swings-stream", "unpack", packed, again)
    assert f"{again}: 10 frames in 19 files, " in told
