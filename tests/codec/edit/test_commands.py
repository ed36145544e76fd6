"""swings-stream edit as a process: its output, its files and its failures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from codec.stream import StreamReader
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
    edit("colour", tmp_path / "moved", "bright", "--exposure", 0.5, "--white", 0.9, 0.8, 0.7)
    assert edit("floaters", tmp_path / "bright", "clean", "--cameras", 1)[2].startswith("floaters ")
    told = edit("trim", tmp_path / "clean", "part", "--frames", f"{SEGMENT_FRAMES}:")
    assert told[0].endswith("2 segments, 0 copied byte for byte, 2 with new frame numbers")
    told = edit("join", tmp_path / "clean", "both", "--then", tmp_path / "part")
    count = 2 * NUM_FRAMES - SEGMENT_FRAMES
    assert told[0].endswith(f": {count} frames in 4 segments, 2 copied byte for byte")
    told = run_ok("swings-stream", "verify", tmp_path / "both").splitlines()
    assert told == [f"{tmp_path / 'both'}: {count} frames in 4 segments are intact"]
    made = StreamReader(tmp_path / "both").manifest
    assert (made.poster, made.storyboard) == ("poster.jpg", "storyboard.webp")
    assert (tmp_path / "both" / "poster.jpg").is_file()
    assert (tmp_path / "both" / "storyboard.webp").is_file()
    before = StreamReader(stream).manifest
    apart = made.camera().position - 2 * before.camera().position
    np.testing.assert_allclose(apart, (1, 0, 0.5), atol=2 * before.lattice[0].position_m)


def test_what_goes_wrong_is_one_line_and_leaves_nothing(stream: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    for arguments, word in (
        (["crop", stream, out], "exactly one"),
        (["crop", stream, out, "--keyframes", tmp_path / "none.json"], "none.json is missing"),
        (["trim", stream, out, "--frames", "90:"], "has frames 0:14"),
        (["transform", stream, out, "--scale", 0], "above 0"),
        (["crop", tmp_path / "none", out, "--sphere", 0, 0, 0, 1], "none"),
        (["crop", stream, stream, "--sphere", 0, 0, 0, 1], "is not empty"),
        (["join", stream, out, "--then", tmp_path], "manifest.json"),
    ):
        done = run("swings-stream", "edit", *arguments)
        assert (done.returncode, done.stdout) == (1, "")
        assert word in done.stderr
        assert done.stderr.count("\n") == 1
    before = segment_files(stream)
    done = run("swings-stream", "edit", "trim", stream, stream, "--frames", ":3")
    assert done.returncode == 1
    assert segment_files(stream) == before
    no_cameras = ["floaters", stream, out, "--cameras", 0]
    for misused in (["polish"], no_cameras, ["trim", stream, out]):
        assert run("swings-stream", "edit", *misused).returncode == 2
    assert list(tmp_path.iterdir()) == []
