"""swings-stream import and export: files to a stream and back, as functions and as processes."""

from __future__ import annotations

import gzip
import struct
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from codec.errors import CodecError, InvalidError, UnsupportedError
from codec.interop.exporting import export_stream, numbered
from codec.interop.formats import SplatFormat, read_splats, write_splats
from codec.sequence.importing import (
    ImportOptions,
    Survey,
    find_files,
    import_stream,
    make_manifest,
)
from codec.profiles.profile import Profile
from codec.splats import Splats
from codec.stream import StreamReader
from codec.stream.layers import Rank
from tests.support.commands import run, run_ok
from tests.support.drawn import same
from tests.support.tiny_stream import write_tiny
from tests.support.trained_like import trained_like_splats

RAW = ImportOptions(profile=Profile.RAW)


def save(path: Path, splats: Splats) -> Path:
    write_splats(path, splats, SplatFormat.PLY)
    return path


def by_position(splats: Splats) -> Splats:
    return splats.take(np.lexsort(splats.means.T))


def test_a_still_model_goes_in_and_out_bit_by_bit(tmp_path: Path) -> None:
    splats = trained_like_splats(300, sh_degree=2)
    made = import_stream(save(tmp_path / "model.ply", splats), tmp_path / "stream", RAW)
    assert (made.swin_size, made.num_gs, made.sh_degree) == (1, 300, 2)
    assert (made.title, made.live) == ("model.ply", False)
    assert StreamReader(tmp_path / "stream").num_frames == 1
    out = tmp_path / "deep" / "out.ply"
    assert export_stream(tmp_path / "stream", out, 0, None, None, None) == [out]
    assert same(by_position(read_splats(out)), by_position(splats))


def test_the_default_camera_sees_the_whole_model_from_outside() -> None:
    splats = trained_like_splats(2000, 4)
    manifest = make_manifest(Survey.of(splats), ImportOptions(), "")
    camera = manifest.camera()
    lower, upper = np.array(manifest.bounds)
    corners = np.stack(np.meshgrid(*zip(lower, upper, strict=True)), -1).reshape(-1, 3)
    seen = corners @ camera.w2c[:3, :3].T + camera.w2c[:3, 3]
    assert (seen[:, 2] > manifest.near_m).all()
    for axis, (focal, centre, size) in enumerate(
        [
            (camera.fx_px, camera.cx_px, camera.width_px),
            (camera.fy_px, camera.cy_px, camera.height_px),
        ]
    ):
        pixels = focal * seen[:, axis] / seen[:, 2] + centre
        assert (pixels >= 0).all()
        assert (pixels <= size).all()
    middle = (lower + upper) / 2 - camera.position
    assert middle / np.linalg.norm(middle) == pytest.approx(camera.forward)
    inside = ((splats.means >= lower) & (splats.means <= upper)).all(axis=1)
    assert 0.9 < inside.mean() < 1  # floaters stay out


@pytest.mark.parametrize("count", [0, 1, 2])
def test_next_to_nothing_is_a_model_too(count: int, tmp_path: Path) -> None:
    splats = trained_like_splats(count)
    import_stream(save(tmp_path / "model.ply", splats), tmp_path / "stream", RAW)
    assert len(StreamReader(tmp_path / "stream").active_splats(0, 4)) == count


def test_a_folder_is_a_sequence_in_order_of_number(tmp_path: Path) -> None:
    folder = tmp_path / "take"
    folder.mkdir()
    # The text order of the names is 10, 2, 7; counts, degrees and kinds differ.
    parts = {2: trained_like_splats(30), 7: trained_like_splats(50, 1, 1)}
    for number, splats in parts.items():
        save(folder / f"v1_{number}.ply", splats)
    write_splats(folder / "v1_10.spz", trained_like_splats(40), SplatFormat.SPZ)
    for other in ("notes.txt", ".v1_3.ply.tmp", ".v1_3.ply"):
        (folder / other).write_text("no model")
    assert [path.name for path in find_files(folder)] == ["v1_2.ply", "v1_7.ply", "v1_10.spz"]
    made = import_stream(folder, tmp_path / "stream", ImportOptions(24, Profile.RAW, title="Take"))
    assert (made.fps, made.num_gs, made.sh_degree, made.title) == (24, 50, 1, "Take")
    reader = StreamReader(tmp_path / "stream")
    assert reader.num_frames == 3
    assert [len(reader.active_splats(frame, 4)) for frame in range(3)] == [30, 50, 40]
    assert same(by_position(reader.active_splats(1, 4)), by_position(parts[7]))
    assert not reader.active_splats(0, 4).sh[:, 1:].any()
    assert (np.array(made.bounds[0]) < np.array(made.bounds[1])).all()


def test_a_bad_folder_or_file_is_named_before_anything_is_written(tmp_path: Path) -> None:
    folder = tmp_path / "take"
    folder.mkdir()
    stream = tmp_path / "stream"
    with pytest.raises(InvalidError, match=r"no \.ply, \.spz or \.splat file"):
        import_stream(folder, stream, RAW)
    save(folder / "frame_1.ply", trained_like_splats(3))
    save(folder / "frame_01.ply", trained_like_splats(3))
    with pytest.raises(InvalidError, match=r"frame_01\.ply and frame_1\.ply have the same number"):
        import_stream(folder, stream, RAW)
    (folder / "frame_01.ply").rename(folder / "last.ply")
    with pytest.raises(InvalidError, match=r"last\.ply: its name has no number"):
        import_stream(folder, stream, RAW)
    (folder / "last.ply").rename(folder / "frame_2.ply")
    data = (folder / "frame_2.ply").read_bytes()
    (folder / "frame_2.ply").write_bytes(data[:-1])
    with pytest.raises(CodecError, match=r"frame_2\.ply: PLY: ends after"):
        import_stream(folder, stream, RAW)
    (folder / "frame_2.ply").write_bytes(data)
    with pytest.raises(InvalidError, match="fps 0"):
        import_stream(folder, stream, ImportOptions(fps=0))
    with pytest.raises(InvalidError, match="no rank is called"):
        import_stream(folder, stream, ImportOptions(rank="beauty"))  # type: ignore[arg-type]
    assert not stream.exists()
    save(stream, trained_like_splats(1))
    with pytest.raises(InvalidError, match="not empty"):
        import_stream(folder, stream, RAW)


def test_more_than_a_frame_holds_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("codec.sequence.importing.MAX_SPLATS_PER_CHUNK", 9)
    model = save(tmp_path / "model.ply", trained_like_splats(10))
    with pytest.raises(
        UnsupportedError, match=r"model\.ply: PLY: 10 Gaussians in a frame, at most 9"
    ):
        import_stream(model, tmp_path / "stream", RAW)
    assert not (tmp_path / "stream").exists()


SPLAT_RECORD_BYTES = 32


@pytest.mark.parametrize(
    ("name", "head"),
    [
        ("a.spz", gzip.compress(struct.pack("<4sIIBBBB", b"NGSP", 3, 10, 0, 12, 0, 0))),
        ("b.spz", struct.pack("<4sIIBBBBI12x", b"NGSP", 4, 10, 0, 12, 0, 5, 32)),
        ("c.splat", bytes(10 * SPLAT_RECORD_BYTES)),
    ],
)
def test_too_many_are_refused_by_the_header_alone(
    tmp_path: Path, name: str, head: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing follows the header: whoever went on would say so."""
    monkeypatch.setattr("codec.sequence.importing.MAX_SPLATS_PER_CHUNK", 9)
    (tmp_path / name).write_bytes(head)
    with pytest.raises(UnsupportedError, match=r"10 Gaussians in a frame, at most 9"):
        import_stream(tmp_path / name, tmp_path / "stream", RAW)


@pytest.fixture(scope="module")
def stream(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six frames, three slices of forty Gaussians in each, two layers."""
    path = tmp_path_factory.mktemp("export") / "stream"
    write_tiny(path, 6)
    return path


def test_a_range_becomes_a_numbered_sequence(stream: Path, tmp_path: Path) -> None:
    written = export_stream(stream, tmp_path / "seq" / "tiny.ply", None, "2:5", None, None)
    assert [path.name for path in written] == ["tiny_0002.ply", "tiny_0003.ply", "tiny_0004.ply"]
    reader = StreamReader(stream)
    for frame, path in zip(range(2, 5), written, strict=True):
        assert same(read_splats(path), reader.active_splats(frame, 2))
    # Which is what import takes.
    assert find_files(tmp_path / "seq") == written


def test_layers_and_formats_of_a_frame(stream: Path, tmp_path: Path) -> None:
    for format in SplatFormat:
        [path] = export_stream(stream, tmp_path / "frame", 5, None, format, 1)
        assert path == tmp_path / "frame"
        data = path.read_bytes()
        (tmp_path / f"frame.{format}").write_bytes(data)
        shown = StreamReader(stream).active_splats(5, 1)
        assert len(read_splats(tmp_path / f"frame.{format}")) == len(shown)
        assert len(shown) < len(StreamReader(stream).active_splats(5, 2))


@pytest.mark.parametrize(
    ("frame", "frames", "name", "layers", "says"),
    [
        (None, None, "a.ply", None, "either --frame F or --frames A:B"),
        (1, "1:2", "a.ply", None, "either --frame F or --frames A:B"),
        (6, None, "a.ply", None, "no frame 6; it has 6 frames"),
        (-1, None, "a.ply", None, "no frame -1"),
        (None, "4:7", "a.ply", None, "has frames 0:6"),
        (None, "4:4", "a.ply", None, "hold no frame"),
        (None, "6:", "a.ply", None, "has frames 0:6"),
        (None, "4", "a.ply", None, "not FIRST:END"),
        (0, None, "a.glb", None, "say --format, one of ply, splat, spz"),
        (0, None, "a.ply", 3, "3 layers of 2"),
        (0, None, "a.ply", 0, "0 layers of 2"),
    ],
)
def test_a_bad_export_is_refused_with_the_reason(
    stream: Path,
    tmp_path: Path,
    frame: int | None,
    frames: str | None,
    name: str,
    layers: int | None,
    says: str,
) -> None:
    with pytest.raises(InvalidError, match=says):
        export_stream(stream, tmp_path / name, frame, frames, None, layers)
    assert not list(tmp_path.iterdir())


def test_a_place_that_cannot_be_written_is_named(stream: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(InvalidError, match=r"file/a\.ply cannot be written: "):
        export_stream(stream, tmp_path / "file" / "a.ply", 0, None, None, None)


def test_names_of_a_sequence() -> None:
    assert numbered(Path("a/b.v1"), 7, SplatFormat.SPZ) == Path("a/b.v1_0007.spz")
    assert numbered(Path("a/b.SPZ"), 12345, SplatFormat.SPZ) == Path("a/b_12345.spz")


def test_the_commands(tmp_path: Path) -> None:
    model = save(tmp_path / "model.ply", trained_like_splats(60))
    told = run_ok("swings-stream", "import", model, tmp_path / "stream", "--profile", "raw")
    assert told == f"{tmp_path}/stream: model.ply, up to 60 Gaussians a frame, SH degree 0, raw\n"
    run_ok("swings-stream", "verify", tmp_path / "stream")
    poster = Image.open(tmp_path / "stream" / "poster.jpg")
    assert (poster.format, poster.size) == ("JPEG", (640, 360))
    assert np.asarray(poster).max() > 60
    out = tmp_path / "out.spz"
    told = run_ok("swings-stream", "export", tmp_path / "stream", out, "--frame", 0)
    assert told == f"{out}: 1 file, {out.stat().st_size} bytes\n"
    assert len(read_splats(out)) == 60
    done = run("swings-stream", "import", tmp_path / "none.ply", tmp_path / "other")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == f"swings-stream: {tmp_path}/none.ply is missing\n"


def test_a_rank_that_there_is_not_is_bad_usage_and_no_file_is_opened(tmp_path: Path) -> None:
    done = run("swings-stream", "import", tmp_path / "none.ply", tmp_path / "out", "--rank", "typo")
    assert (done.returncode, done.stdout) == (2, "")
    assert "none.ply" not in done.stderr
    for name in Rank:
        assert name in done.stderr
