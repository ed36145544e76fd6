"""swings-stream export: frames of a stream as files; nothing hidden is exported."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from codec.errors import InvalidError
from codec.files import write_atomic
from codec.interop.exporting import export_stream, numbered
from codec.interop.formats import SplatFormat, read_splats, write_splats
from codec.sequence.numberedfiles import find_files
from codec.splats import Splats
from codec.stream import StreamReader
from codec.tools.plot import draw_stream
from codec.tools.static import export_static
from tests.goldens.decoder import Gaussian, to_floats
from tests.goldens.folder import StreamFolder, state_at
from tests.support.drawn import same_splats
from tests.support.slots.folder import write_slots
from tests.support.slots.updates import small_layout
from tests.support.tiny_stream import write_tiny
from tests.support.trained_like import trained_like_splats

LAYOUT = small_layout(3, (9, 6), 1, 4)


@pytest.fixture(scope="module")
def stream(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six frames, three slices of forty Gaussians in each, two layers."""
    path = tmp_path_factory.mktemp("export") / "stream"
    write_tiny(path, 6)
    return path


def by_position(splats: Splats) -> Splats:
    return splats.take(np.lexsort(splats.means.T))


@pytest.mark.parametrize("layers", [1, 2])
def test_what_shows_is_exported_and_nothing_else(layers: int, tmp_path: Path) -> None:
    """Compared with the plain decoder: Gaussians that have started, and no empty slot."""
    write_slots(tmp_path / "s", 10, LAYOUT)
    hidden = 0
    for frame in range(10):
        shape = StreamFolder(tmp_path / "s").shape
        held = [
            (slot, lattice)
            for lane in state_at(tmp_path / "s", frame, layers)
            for row, lattice in zip(lane[:layers], shape.lattice[:layers], strict=True)
            for slot in row
        ]
        shown = [
            to_floats(slot, lattice)
            for slot, lattice in held
            if isinstance(slot, Gaussian) and slot.start <= frame
        ]
        hidden += len(held) - len(shown)
        means = np.array([floats.mean for floats in shown], np.float32).reshape(-1, 3)
        for format in SplatFormat if frame % 5 == 0 else (SplatFormat.PLY,):
            out = tmp_path / f"o.{format}"
            export_stream(tmp_path / "s", out, frame, None, None, layers)
            found = read_splats(out)
            assert len(found) == len(shown)
            if format is SplatFormat.PLY:
                assert (by_position(found).means == means[np.lexsort(means.T)]).all()
                assert np.isfinite(found.logit_opacities).all()
    assert hidden > 20


def test_a_range_becomes_a_numbered_sequence(stream: Path, tmp_path: Path) -> None:
    written = export_stream(stream, tmp_path / "seq" / "tiny.ply", None, "2:5", None, None)
    assert [path.name for path in written] == ["tiny_0002.ply", "tiny_0003.ply", "tiny_0004.ply"]
    for frame, path in zip(range(2, 5), written, strict=True):
        assert same_splats(read_splats(path), StreamReader(stream).active_splats(frame, 2))
    assert find_files(tmp_path / "seq") == written  # import accepts exactly these files
    assert numbered(Path("a/b.v1"), 7, SplatFormat.SPZ) == Path("a/b.v1_0007.spz")
    assert numbered(Path("a/b.SPZ"), 12345, SplatFormat.SPZ) == Path("a/b_12345.spz")


def test_a_format_may_be_given_and_layers_left_out(stream: Path, tmp_path: Path) -> None:
    for format in SplatFormat:
        assert export_stream(stream, tmp_path / "f", 5, None, format, 1) == [tmp_path / "f"]
        (tmp_path / f"f.{format}").write_bytes((tmp_path / "f").read_bytes())
        shown = StreamReader(stream).active_splats(5, 1)
        assert len(read_splats(tmp_path / f"f.{format}")) == len(shown)
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
        (0, None, "file/a.ply", None, r"file/a\.ply cannot be written: "),
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
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(InvalidError, match=says):
        export_stream(stream, tmp_path / name, frame, frames, None, layers)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


NAMELESS: dict[str, Callable[[Path, Path], object]] = {
    "static": export_static,
    "frame": lambda stream, out: export_stream(stream, out, 0, None, SplatFormat.PLY, None),
    "frames": lambda stream, out: export_stream(stream, out, None, ":2", SplatFormat.PLY, None),
    "numbered": lambda stream, out: numbered(out, 1, SplatFormat.PLY),
    "splats": lambda stream, out: write_splats(out, trained_like_splats(2), SplatFormat.PLY),
    "atomic": lambda stream, out: write_atomic(out, b"data"),
    "plot": draw_stream,
}


@pytest.mark.parametrize("call", NAMELESS)
def test_a_place_without_a_name(
    call: str, stream: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InvalidError, match=r"^\. names no file") as caught:
        NAMELESS[call](stream, Path("."))
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())
