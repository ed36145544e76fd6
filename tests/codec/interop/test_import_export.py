"""swings-stream export: frames of a stream as files, and how other readers decode them."""

from __future__ import annotations

from pathlib import Path

import pytest

from codec.errors import InvalidError
from codec.interop.exporting import export_stream, numbered
from codec.interop.formats import SplatFormat, read_splats
from codec.sequence.numberedfiles import find_files
from codec.stream import StreamReader
from tests.support.drawn import same_splats
from tests.support.tiny_stream import write_tiny


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
        assert same_splats(read_splats(path), reader.active_splats(frame, 2))
    # Import accepts exactly these files.
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
        (0, None, "a.obj", None, "no known suffix; give --format, one of ply, splat, spz, sog"),
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
