"""swings-stream export --static: a stream that any plain web server plays, with equal pictures."""

from __future__ import annotations

import math
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from codec.coders.coder import Coder, coder_of
from codec.errors import CorruptError, InvalidError
from codec.files import write_atomic
from codec.interop.formats import SplatFormat
from codec.slots.passing import passing_elsewhere
from codec.slots.slotchange import encoded_elsewhere
from codec.slots.slotchunk import Kind
from codec.slots.slotencoder import SlotEncoder
from codec.slots.slotlayout import SlotLayout
from codec.stream import StreamReader, StreamWriter
from codec.stream.manifest import Manifest
from codec.stream.object import HEAD
from codec.tools.audit import verify_stream
from codec.tools.commands import Export, export_files
from codec.tools.static import export_static
from tests.support.commands import run_ok
from tests.support.hosted_streams import write_stream
from tests.support.objects import object_packets
from tests.support.slots.folder import write_slots
from tests.support.slots.updates import patternless_updates, small_layout
from tests.support.tiny_stream import append_tiny, files_of, tiny_manifest, write_tiny

PARTS = ("manifest.json", "index.bin", "segments")
LAYOUTS = [
    small_layout(3, (9, 6), 0, 4),
    small_layout(1, (4,), 2, 3),
    small_layout(2, (5, 4, 3), 1, 8),
    small_layout(1, (5, 3), 0, 4, 2),
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
def test_every_chunk_is_that_of_the_original(tmp_path: Path, layout: SlotLayout) -> None:
    write_slots(tmp_path / "a", 11, layout)
    made = export_static(tmp_path / "a", tmp_path / "b")
    before, after = StreamReader(tmp_path / "a"), StreamReader(tmp_path / "b")
    assert after.manifest.to_json() == before.manifest.to_json()
    for record in before.records:
        for part in before.manifest.parts:
            old, new = (r.read_object(record.segment, part) for r in (before, after))
            assert HEAD.unpack_from(new.data)[3:5] == (2, Coder.GZIP)
            assert [e.birth for e in old.entries] == [e.birth for e in new.entries]
            for birth, packet in object_packets(new.data):
                assert coder_of(packet) is Coder.GZIP
                assert new.content(birth) == old.content(birth)
    assert verify_stream(tmp_path / "b").num_frames == 11
    for name, told in (("a", made.source_bytes), ("b", made.size_bytes)):
        assert told == sum(map(len, files_of(tmp_path / name).values()))


@pytest.mark.parametrize("layout", LAYOUTS)
def test_an_entropy_coder_is_told_the_same_edges_as_at_first(layout: SlotLayout) -> None:
    encoder = SlotEncoder(layout)
    for update in patternless_updates(layout, 13):
        encoded = encoder.append(update)
        if encoded is None:
            continue
        *changes, last = encoded.changes
        is_passing = layout.is_passing(max(update.birth, 0))
        chunks = [(Kind.MASK, encoded.mask), *((Kind.CHANGE, one) for one in changes)]
        chunks.append((Kind.PASSING if is_passing else Kind.CHANGE, last))
        if update.birth % layout.segment_frames == 0:
            chunks += [(Kind.SNAPSHOT, chunk) for chunk in encoder.snapshots()]
        for kind, chunk in chunks:
            if not chunk.data:  # without changes there is no packet
                continue
            if kind is Kind.PASSING:
                again = passing_elsewhere(layout, chunk.data, chunk.birth)
            else:
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


def test_the_quality_that_the_index_knows_stays(tmp_path: Path) -> None:
    with StreamWriter.create(
        tmp_path / "a",
        tiny_manifest(),
        quality=lambda frame, slices: (20.5, 30.25) if frame else None,
    ) as writer:
        append_tiny(writer, 6)
    export_static(tmp_path / "a", tmp_path / "b")
    found = [record.psnr_db for record in StreamReader(tmp_path / "b").records]
    assert found == [record.psnr_db for record in StreamReader(tmp_path / "a").records]
    assert not math.isnan(found[0][0])


def set_manifest(stream: Path, **changes: object) -> None:
    path = stream / "manifest.json"
    manifest = Manifest.from_json(path.read_bytes())
    write_atomic(path, replace(manifest, **changes).to_json())  # type: ignore[arg-type]


def test_a_live_stream_is_exported_as_far_as_it_has_come(tmp_path: Path) -> None:
    writer = StreamWriter.create(tmp_path / "a", tiny_manifest())
    with pytest.raises(InvalidError, match="has no frames yet"):
        export_static(tmp_path / "a", tmp_path / "b")
    append_tiny(writer, 6)
    writer.abort()
    export_static(tmp_path / "a", tmp_path / "b")
    after = StreamReader(tmp_path / "b")
    assert (after.num_frames, after.manifest.live) == (4, False)


ELSEWHERE = ("../secret", "https://cdn/poster.png", "", ".", "none.png", "loop/poster.png")


@pytest.mark.parametrize("poster", [*ELSEWHERE, *PARTS[:2], "segments/1/0", "art/poster.png"])
def test_only_a_poster_in_the_folder_comes_along(poster: str, tmp_path: Path) -> None:
    write_tiny(tmp_path / "a", 6)
    (tmp_path / "secret").write_bytes(b"not of the stream")
    (tmp_path / "a" / "art").mkdir()
    (tmp_path / "a" / "art" / "poster.png").write_bytes(b"picture")
    (tmp_path / "a" / "loop").symlink_to("loop")
    set_manifest(tmp_path / "a", poster=poster, object_url="https://cdn/{layer}/{segment}")
    export_static(tmp_path / "a", tmp_path / "b")
    after = StreamReader(tmp_path / "b").manifest
    assert (tmp_path / "b" / after.object_path(1, 1)).is_file()
    assert verify_stream(tmp_path / "b").num_frames == 6
    assert after.poster == poster
    names = [*PARTS, "art"] if poster.startswith("art") else PARTS
    assert sorted(path.name for path in (tmp_path / "b").iterdir()) == sorted(names)
    if poster.startswith("art"):
        assert (tmp_path / "b" / poster).read_bytes() == b"picture"


def test_a_wrong_chunk_is_named_and_nothing_is_left(tmp_path: Path) -> None:
    write_tiny(tmp_path / "a", 6)
    path = tmp_path / "a" / "segments" / "1" / "snapshot-1"
    data = path.read_bytes()
    path.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    with pytest.raises(CorruptError, match="segments/1/snapshot-1"):
        export_static(tmp_path / "a", tmp_path / "b")
    assert [entry.name for entry in tmp_path.iterdir()] == ["a"]


def test_what_a_killed_export_left_is_replaced_and_no_folder_in_use(tmp_path: Path) -> None:
    write_tiny(tmp_path / "a", 6)
    (tmp_path / ".b.tmp" / "segments" / "99").mkdir(parents=True)
    (tmp_path / "b").mkdir()
    export_static(tmp_path / "a", tmp_path / "b")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b"]
    assert sorted(path.name for path in (tmp_path / "b" / "segments").iterdir()) == ["0", "1"]
    for taken in (tmp_path / "b", tmp_path / "a", tmp_path / "b" / "index.bin"):
        with pytest.raises(InvalidError, match="is not empty"):
            export_static(tmp_path / "a", taken)


def test_the_command(folder: Path, tmp_path: Path) -> None:
    stream, out = tmp_path / "stream", tmp_path / "web"
    shutil.copytree(folder / "original", stream)
    told = run_ok("swings-stream", "export", stream, out, "--static")
    assert told.startswith(f"{out}: 13 frames in 3 segments for any web server, ")
    source, made = (sum(map(len, files_of(path).values())) for path in (stream, out))
    assert f"{made} bytes, {100 * made / source:.1f} % of the {source} of {stream}\n" in told
    for options in ({"frame": 0}, {"frames": "0:2"}, {"format": SplatFormat.PLY}, {"layers": 1}):
        with pytest.raises(InvalidError, match="--static writes the whole stream"):
            export_files(Export(str(stream), tmp_path / "x", static=True, **options))
    assert not (tmp_path / "x").exists()
