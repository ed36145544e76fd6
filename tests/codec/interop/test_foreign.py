"""The codec raises no exception of Python's own for an odd path or number."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from codec.errors import CorruptError, InvalidError
from codec.files import write_atomic
from codec.framerange import FrameRange
from codec.interop.exporting import export_stream, numbered
from codec.interop.formats import SplatFormat, write_splats
from codec.stream import StreamReader
from codec.tools.audit import verify_stream
from codec.tools.plot import draw_stream
from codec.tools.static import export_static
from tests.support.commands import run
from tests.support.tiny_stream import write_tiny
from tests.support.trained_like import trained_like_splats

MANY_DIGITS = "9" * 5000


@pytest.fixture(scope="module")
def stream(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("foreign") / "stream"
    write_tiny(path, 6)
    return path


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


@pytest.mark.parametrize("frames", [f"0:{MANY_DIGITS}", f"{MANY_DIGITS}:", f":{'0' * 4301}"])
def test_a_number_of_thousands_of_digits(frames: str, stream: Path, tmp_path: Path) -> None:
    with pytest.raises(InvalidError, match="a number of more than 18 digits") as caught:
        export_stream(stream, tmp_path / "a.ply", None, frames, None, None)
    assert len(str(caught.value)) < 200
    with pytest.raises(InvalidError):
        FrameRange.parse("x" * 5000)


def test_the_command_in_a_line(
    stream: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for arguments in (
        [".", "--static"],
        [".", "--frames", "0:2", "--format", "ply"],
        ["a.ply", "--frames", f"0:{MANY_DIGITS}"],
    ):
        done = run("swings-stream", "export", stream, *arguments)
        assert (done.returncode, done.stdout) == (1, "")
        assert done.stderr.startswith("swings-stream: ")
        assert done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("poster", ["a\0b", "x" * 300])
def test_a_poster_that_cannot_be_a_file(poster: str, tmp_path: Path) -> None:
    write_tiny(tmp_path / "a", 4)
    path = tmp_path / "a" / "manifest.json"
    path.write_text(json.dumps(json.loads(path.read_bytes()) | {"poster": poster}))
    uses: list[Callable[[], object]] = [
        lambda: StreamReader(tmp_path / "a"),
        lambda: verify_stream(tmp_path / "a"),
        lambda: export_static(tmp_path / "a", tmp_path / "b"),
    ]
    for use in uses:
        with pytest.raises(CorruptError, match=r"manifest\.json: manifest: poster"):
            use()
    assert not (tmp_path / "b").exists()


def test_a_poster_behind_links_in_a_circle_is_left_there(tmp_path: Path) -> None:
    write_tiny(tmp_path / "a", 4)
    os.symlink(tmp_path / "a" / "loop", tmp_path / "a" / "loop")
    path = tmp_path / "a" / "manifest.json"
    path.write_text(json.dumps(json.loads(path.read_bytes()) | {"poster": "loop/poster.png"}))
    export_static(tmp_path / "a", tmp_path / "b")
    assert verify_stream(tmp_path / "b").num_frames == 4
