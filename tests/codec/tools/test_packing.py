"""A stream as one file, or as a folder for any web server."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from zipfile import ZipFile

import pytest

import codec
from codec.errors import CodecError, CorruptError, InvalidError
from codec.interop.formats import SplatFormat, export_stream
from codec.slots.change import encoded_elsewhere
from codec.slots.encoder import SlotEncoder
from codec.slots.slotlayout import Kind, SlotLayout
from codec.stream import StreamReader, StreamWriter
from codec.stream.captions import Captions
from codec.stream.manifest import Manifest
from codec.stream.packedstorage import PackedStorage, open_place
from codec.stream.streampacker import pack_stream, unpack_stream, verify_packed
from codec.tools.audit import summarise, verify_stream
from codec.tools.commands import Export, export_files
from codec.tools.static import export_static
from codec.tracks.streamtracks import add_captions
from tests.support.commands import run_ok
from tests.support.drawn import same_splats
from tests.support.hosted_streams import write_stream
from tests.support.hostile import refused
from tests.support.slots.folder import write_slots
from tests.support.slots.updates import patternless_updates, small_layout
from tests.support.sounding import add_clicks
from tests.support.tiny_stream import append_tiny, files_of, tiny_manifest, write_tiny

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
    add_clicks(stream, (0, 4, 9))
    add_clicks(stream, (3,), "voice", ((0.0, 1.0, 2.0, 3.0),))
    for language in ("en", "pt-BR"):
        (tmp_path / "in.vtt").write_bytes(VTT + language.encode())
        add_captions(stream, tmp_path / "in.vtt", Captions(language, language))
    packed, wanted = tmp_path / "one.swings", files_of(stream)
    made = pack_stream(stream, packed)
    size_bytes = packed.stat().st_size
    assert (made.num_frames, made.num_files, made.size_bytes) == (10, len(wanted), size_bytes)
    verify_stream(packed)
    unpack_stream(packed, tmp_path / "again")
    assert files_of(tmp_path / "again") == wanted
    for source in (tmp_path / "again", packed):
        pack_stream(source, tmp_path / "two.swings")
        assert (tmp_path / "two.swings").read_bytes() == packed.read_bytes()
    storage = open_place(packed)
    assert isinstance(storage, PackedStorage)
    with ZipFile(packed) as archive:
        assert archive.testzip() is None
        assert {*archive.namelist()} == {*wanted, ".tracks"}
        for name in archive.namelist():
            assert storage.read(name, 1 << 20) == archive.read(name)
    # A wrong size in the table is found: by the size of the file, or by the headers.
    at, size = storage.layout.find(".tracks") or (0, 0)
    assert size == 4 * (2 + 2 * 3)
    whole = packed.read_bytes()
    for lie in range(at, at + size, 4):
        for by in (1, 255):
            packed.write_bytes(whole[:lie] + bytes([whole[lie] ^ by]) + whole[lie + 1 :])
            refused(CorruptError, "", verify_stream, packed)
    (stream / "segments" / "1" / "audio-voice").unlink()
    refused(CorruptError, "audio-voice is missing", pack_stream, stream, packed)


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
    begin = whole.index(b"segments/2/keyframe-1") - 30
    places = [*range(0, 64, 3), *range(begin, begin + 60, 4), *range(64, len(whole), 4999)]
    places += range(len(whole) - 100, len(whole), 7)
    for at in places:
        packed.write_bytes(whole[:at] + bytes([whole[at] ^ 4]) + whole[at + 1 :])
        assert str(refused(CodecError, "", verify_whole, packed)).startswith(str(packed)), at
    for length in (0, 1, 40, 63, 5000, len(whole) - 1):
        packed.write_bytes(whole[:length])
        refused(CodecError, "", StreamReader, packed)
    packed.write_bytes(whole)
    verify_whole(packed)


def test_what_cannot_be_packed_is_said_and_leaves_nothing(stream: Path, tmp_path: Path) -> None:
    out = tmp_path / "out" / "one.swings"
    out.parent.mkdir()
    with StreamWriter.create(tmp_path / "live", tiny_manifest()) as writer:
        append_tiny(writer, 5)
        with pytest.raises(InvalidError, match="live is live; pack it when it is finished"):
            pack_stream(tmp_path / "live", out)
    for name in ("one.zip", "one"):
        refused(InvalidError, r"ends with \.swings", pack_stream, stream, out.with_name(name))
    refused(InvalidError, "is not a packed stream", unpack_stream, stream, tmp_path / "again")
    data = (stream / "segments" / "1" / "1").read_bytes()
    (stream / "segments" / "1" / "1").write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    refused(CodecError, "segments/1/1: object: was altered", pack_stream, stream, out)
    refused(CodecError, r"none\.swings does not exist", StreamReader, tmp_path / "none.swings")
    assert list(out.parent.iterdir()) == []


def test_the_commands(stream: Path, tmp_path: Path) -> None:
    packed, again = tmp_path / "one.swings", tmp_path / "again"
    told = run_ok("swings-stream", "pack", stream, packed)
    assert told == f"{packed}: 10 frames in one file, {packed.stat().st_size} bytes\n"
    told = run_ok("swings-stream", "unpack", packed, again)
    assert f"{again}: 10 frames in 19 files, " in told


PARTS = ("manifest.json", "index.bin", "segments")
LAYOUTS = [
    small_layout(3, (9, 6), 0, 4),
    small_layout(1, (4,), 2, 3),
    small_layout(2, (5, 4, 3), 1, 8),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A stream `original` and its export `exported`. That hosts of such files are played is tested
    in tests/player/source."""
    root = tmp_path_factory.mktemp("static")
    write_stream(root / "original", 13)
    export_static(root / "original", root / "exported")
    return root


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_file_is_that_of_the_original(tmp_path: Path, layout: SlotLayout) -> None:
    write_slots(tmp_path / "a", 11, layout)
    made = export_static(tmp_path / "a", tmp_path / "b")
    assert files_of(tmp_path / "b") == files_of(tmp_path / "a")
    assert (made.num_frames, made.num_segments) == (11, len(StreamReader(tmp_path / "b").records))


@pytest.mark.parametrize("layout", LAYOUTS[:3])
def test_an_entropy_coder_is_told_the_same_edges_as_at_first(layout: SlotLayout) -> None:
    encoder = SlotEncoder(layout)
    for update in patternless_updates(layout, 13):
        encoded = encoder.append(update)
        if encoded is None:
            continue
        chunks = [
            (Kind.SKIP_MAP, encoded.skip_map),
            *((Kind.CHANGE, one) for one in encoded.changes),
        ]
        if update.birth % layout.segment_frames == 0:
            chunks += [(Kind.KEYFRAME, chunk) for chunk in encoder.keyframes()]
        for kind, chunk in chunks:
            if chunk.data:  # without changes there is no packet
                again = encoded_elsewhere(layout, kind, chunk.data)
                assert (again.birth, again.data) == (chunk.birth, chunk.data)
                assert list(again.edges) == list(chunk.edges)


def test_only_what_a_plain_host_needs_is_there(folder: Path, tmp_path: Path) -> None:
    out = folder / "exported"
    assert sorted(path.name for path in out.iterdir()) == sorted(PARTS)
    parts = StreamReader(out).manifest.parts
    objects = {str(path.relative_to(out / "segments")) for path in out.glob("segments/*/*")}
    assert objects == {f"{segment}/{part}" for segment in range(3) for part in parts}
    # A web server can read it if the permissions of the source allow that.
    assert out.stat().st_mode == (folder / "original").stat().st_mode
    export_static(out, tmp_path / "again")
    assert files_of(tmp_path / "again") == files_of(out)


def test_a_live_stream_is_exported_as_far_as_it_has_come_with_its_scores(tmp_path: Path) -> None:
    writer = StreamWriter.create(
        tmp_path / "a", tiny_manifest(), quality=lambda frame, slices: (20.5, 30.25)
    )
    refused(InvalidError, "has no frames yet", export_static, tmp_path / "a", tmp_path / "b")
    append_tiny(writer, 6)
    writer.abort()
    export_static(tmp_path / "a", tmp_path / "b")
    after = StreamReader(tmp_path / "b")
    assert (after.num_frames, after.manifest.live) == (4, False)
    assert [record.psnr_db for record in after.records] == [(20.5, 30.25)]


ELSEWHERE = ("../secret", "https://cdn/poster.png", "", ".", "none.png", "loop/poster.png")


@pytest.mark.parametrize("poster", [*ELSEWHERE, *PARTS[:2], "segments/1/0", "art/poster.png"])
def test_only_a_poster_in_the_folder_comes_along(poster: str, tmp_path: Path) -> None:
    write_tiny(tmp_path / "a", 6)
    (tmp_path / "secret").write_bytes(b"not of the stream")
    (tmp_path / "a" / "art").mkdir()
    (tmp_path / "a" / "art" / "poster.png").write_bytes(PNG)
    (tmp_path / "a" / "loop").symlink_to("loop")
    path = tmp_path / "a" / "manifest.json"
    manifest = Manifest.from_json(path.read_bytes())
    changed = replace(manifest, poster=poster, object_url="https://cdn/{layer}/{segment}")
    path.write_bytes(changed.to_json())
    export_static(tmp_path / "a", tmp_path / "b")
    after = StreamReader(tmp_path / "b").manifest
    assert (tmp_path / "b" / after.object_path(1, 1)).is_file()
    assert verify_stream(tmp_path / "b").num_frames == 6
    assert after.poster == poster
    names = [*PARTS, "art"] if poster.startswith("art") else PARTS
    assert sorted(path.name for path in (tmp_path / "b").iterdir()) == sorted(names)
    if poster.startswith("art"):
        assert (tmp_path / "b" / poster).read_bytes() == PNG


def test_a_wrong_chunk_is_named_and_nothing_is_left(tmp_path: Path) -> None:
    write_tiny(tmp_path / "a", 6)
    path = tmp_path / "a" / "segments" / "1" / "keyframe-1"
    data = path.read_bytes()
    path.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    refused(CorruptError, "segments/1/keyframe-1", export_static, tmp_path / "a", tmp_path / "b")
    assert [entry.name for entry in tmp_path.iterdir()] == ["a"]


def test_what_a_killed_export_left_is_replaced_and_no_folder_in_use(tmp_path: Path) -> None:
    write_tiny(tmp_path / "a", 6)
    (tmp_path / ".b.tmp" / "segments" / "99").mkdir(parents=True)
    (tmp_path / "b").mkdir()
    export_static(tmp_path / "a", tmp_path / "b")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b"]
    assert sorted(path.name for path in (tmp_path / "b" / "segments").iterdir()) == ["0", "1"]
    for taken in (tmp_path / "b", tmp_path / "a", tmp_path / "b" / "index.bin"):
        refused(InvalidError, "is not empty", export_static, tmp_path / "a", taken)


def test_the_command(folder: Path, tmp_path: Path) -> None:
    stream, out = tmp_path / "stream", tmp_path / "web"
    shutil.copytree(folder / "original", stream)
    told = run_ok("swings-stream", "export", stream, out, "--static")
    assert told.startswith(f"{out}: 13 frames in 3 segments for any web server, ")
    objects = sum(path.stat().st_size for path in out.glob("segments/*/*"))
    assert told.endswith(f", {objects} bytes of objects\n")
    for options in ({"frame": 0}, {"frames": "0:2"}, {"format": SplatFormat.PLY}, {"layers": 1}):
        with pytest.raises(InvalidError, match="--static writes the whole stream"):
            export_files(Export(str(stream), tmp_path / "x", static=True, **options))
    assert not (tmp_path / "x").exists()
