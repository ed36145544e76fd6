"""swings-stream edit as a process: its output, its files and its failures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from codec.stream import StreamReader
from codec.tools.audit import verify_stream
from tests.support.commands import run, run_ok
from tests.support.slots.edited import (
    NUM_FRAMES,
    SEGMENT_FRAMES,
    objects_bytes,
    segment_files,
    write_trained_like,
)


@pytest.fixture(scope="module")
def stream(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_trained_like(tmp_path_factory.mktemp("edit") / "s", 1, 200)


def test_one_edit_after_another(stream: Path, tmp_path: Path) -> None:
    def edit(kind: str, source: Path, out: str, *options: object) -> list[str]:
        return run_ok("swings-stream", "edit", kind, source, tmp_path / out, *options).splitlines()

    box = ["--box", -0.6, 0, -0.6, 0.6, 1.4, 0.6]
    told = edit("crop", stream, "crop", *box)
    size, whole = objects_bytes(tmp_path / "crop"), objects_bytes(stream)
    assert told == [
        f"{tmp_path / 'crop'}: {NUM_FRAMES} frames in 3 segments, 0 copied byte for byte",
        f"size         {size} bytes, {100 * size / whole:.1f} % of {whole}",
    ]
    told = edit("transform", tmp_path / "crop", "moved", "--scale", 2, "--move", 1, 0, 0.5)
    assert told[2].startswith("moved        ")
    assert told[2].endswith(" m beside what was asked: whole steps")
    before, made = (StreamReader(path).manifest for path in (stream, tmp_path / "moved"))
    apart = made.camera().position - 2 * before.camera().position
    np.testing.assert_allclose(apart, (1, 0, 0.5), atol=2 * before.lattice[0].position_m)
    told = edit("trim", tmp_path / "moved", "part", "--frames", f"{SEGMENT_FRAMES}:")
    assert told[0].endswith("2 segments, 0 copied byte for byte, 2 with new frame numbers")
    told = edit("join", tmp_path / "moved", "both", "--then", tmp_path / "part")
    count = 2 * NUM_FRAMES - SEGMENT_FRAMES
    assert told[0].endswith(f": {count} frames in 4 segments, 2 copied byte for byte")
    assert verify_stream(tmp_path / "both").num_frames == count
    for name, file in (("poster", "poster.jpg"), ("storyboard", "storyboard.webp")):
        assert getattr(StreamReader(tmp_path / "both").manifest, name) == file
        assert (tmp_path / "both" / file).is_file()


def test_what_goes_wrong_is_one_line_and_leaves_nothing(stream: Path, tmp_path: Path) -> None:
    before, out = segment_files(stream), tmp_path / "out"
    for arguments, word in (
        (["crop", stream, out, "--keyframes", tmp_path / "none.json"], "none.json is missing"),
        (["trim", stream, out, "--frames", "90:"], "has frames 0:14"),
        (["crop", stream, stream, "--sphere", 0, 0, 0, 1], "is not empty"),
        (["join", stream, out, "--then", tmp_path], "manifest.json"),
    ):
        done = run("swings-stream", "edit", *arguments)
        assert (done.returncode, done.stdout, done.stderr.count("\n")) == (1, "", 1)
        assert word in done.stderr
    for misused in (["polish"], ["floaters", stream, out, "--cameras", 0], ["trim", stream, out]):
        assert run("swings-stream", "edit", *misused).returncode == 2
    assert list(tmp_path.iterdir()) == []
    assert segment_files(stream) == before
