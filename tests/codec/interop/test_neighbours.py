"""Sequences and models exchanged with other programs: files of each are read by the other, with the
largest error of every attribute."""

from __future__ import annotations

import contextlib
import importlib
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from codec.errors import InvalidError
from codec.foreign.splat import RECORD, splat_rows
from codec.foreign.spz import SpzVersion
from codec.interop import splat4dexport
from codec.interop.containers import contained_frames
from codec.interop.exporting import export_stream
from codec.interop.formats import SplatFormat, read_splats, write_splats
from codec.interop.fourdgsexport import encode_fourdgs
from codec.interop.sequences import Precision, SequenceFormat
from codec.interop.splat4dexport import write_splat4d
from codec.interop.tracks import StreamTracks, TrackedFrame
from codec.pose import Doubles
from codec.sequence.importing import ImportOptions, import_stream
from codec.splats import SH_C0, Splats
from codec.stream import StreamReader
from codec.tools.audit import verify_stream
from codec.tools.commands import Export, export_files
from tests.support.alike import KINDS, largest_errors
from tests.support.commands import run_ok
from tests.support.slots.rotating import figure, turned
from tests.support.tiny_stream import write_tiny

fourdgs: Any = None
with contextlib.suppress(ImportError):
    fourdgs = importlib.import_module("fourdgs.keyframe_delta_file")
PROGRAM: str | None = None
with contextlib.suppress(InvalidError):
    PROGRAM = splat4dexport.find_program()

needs_fourdgs = pytest.mark.skipif(fourdgs is None, reason="fourdgs is missing: scripts/setup dev")
needs_splat4d = pytest.mark.skipif(PROGRAM is None, reason="splats4d is missing: scripts/setup dev")
precisions = pytest.mark.parametrize(
    "precision",
    [Precision.FINE, *(pytest.param(p, marks=pytest.mark.deep) for p in Precision if p != "fine")],
)

FPS = 25.0
COUNT, NUM_FRAMES, PER_FRAME = 400, 7, 6
"""The moving figure: Gaussians of a frame, frames, and Gaussians replaced per frame."""
LARGEST = {
    # Position as a share of the median size; of a quaternion in bytes, 1/128 in each component.
    Precision.FINE: (0.021, 0.0051, 0.02, 0.003, 0.003),
    Precision.DEFAULT: (0.051, 0.021, 0.02, 0.0062, 0.0062),
    Precision.COARSE: (0.201, 0.061, 0.06, 0.0142, 0.0142),
}


@dataclass(frozen=True)
class Moving:
    """A turning figure, the source of all round trips."""

    name: str = "moving"
    fps: float = FPS
    num_frames: int = NUM_FRAMES
    num_slots: int = COUNT + PER_FRAME * (NUM_FRAMES - 1)

    def __iter__(self) -> Iterator[TrackedFrame]:
        for number in range(self.num_frames):
            slots = np.arange(PER_FRAME * number, PER_FRAME * number + COUNT)
            yield TrackedFrame(slots, turned(FIGURE.take(slots), 0.03 * number))


FIGURE = figure(Moving().num_slots)
FRAMES = [frame.splats for frame in Moving()]


def assert_close(found: list[Splats], precision: Precision, what: str) -> None:
    """Asserts that `precision` allows the largest error of each kind."""
    assert len(found) == NUM_FRAMES
    errors = np.max([largest_errors(a, b) for a, b in zip(found, FRAMES, strict=True)], axis=0)
    size_mm = 1e3 * np.median([np.median(np.exp(splats.log_scales)) for splats in FRAMES])
    bounds = np.array(LARGEST[precision]) * (size_mm, 1, 1, 1, 1)
    assert (errors <= bounds).all(), (what, KINDS, errors, bounds)


def read_here(path: Path) -> list[Splats]:
    frames = contained_frames(path)
    assert frames is not None
    assert frames[0].reader.fps == FPS
    # Frames can be read in any order, because a reader goes back to the keyframe.
    backwards = [frame.read(COUNT * 2) for frame in reversed(frames)]
    forwards = [frame.read(COUNT * 2) for frame in frames]
    for a, b in zip(forwards, reversed(backwards), strict=True):
        assert all(x.tobytes() == y.tobytes() for x, y in zip(a.arrays, b.arrays, strict=True))
    return forwards


def of_fourdgs(data: bytes) -> list[Splats]:
    """The frames as decoded by the package of the format's authors."""
    decoded = fourdgs.decode_streamed(data)
    frames = []
    for number in range(len(decoded.chunks)):
        state = fourdgs.render_at(decoded, number / FPS)
        opacities: Doubles = np.clip(state["opacity"], 1e-6, 1 - 1e-6)
        arrays = (
            state["centers"],
            np.log(state["scales"]),
            state["rotations"][:, [3, 0, 1, 2]],
            np.log(opacities / (1 - opacities)),
            (state["rgb"][:, None] - 0.5) / SH_C0,
        )
        frames.append(Splats(*(array.astype(np.float32) for array in arrays)))
    return frames


def of_splat4d(path: Path, folder: Path) -> list[Splats]:
    """The frames as decoded by the program of the format's authors, without placeholders."""
    assert PROGRAM is not None
    frames = []
    for number in range(NUM_FRAMES):
        out = folder / "one.splat"
        words = [PROGRAM, "decode", str(path), "--frame", str(number), "--output", str(out)]
        subprocess.run(words, check=True, capture_output=True)
        rows = np.frombuffer(out.read_bytes(), RECORD)
        out.write_bytes(rows[rows["rgba"][:, 3] > 0].tobytes())
        frames.append(read_splats(out))
    return frames


@needs_fourdgs
@precisions
def test_4dgs_there_and_back(precision: Precision, tmp_path: Path) -> None:
    data = encode_fourdgs(Moving(), precision)
    (tmp_path / "a.4dgs").write_bytes(data)
    theirs, ours = of_fourdgs(data), read_here(tmp_path / "a.4dgs")
    assert_close(theirs, precision, ".4dgs read by fourdgs")
    assert_close(ours, precision, ".4dgs read here")
    for a, b in zip(theirs, ours, strict=True):
        assert len(a) == len(b) == COUNT
        # An opacity of 1 has no logit: our reader makes it a quarter of a step less.
        assert (largest_errors(a, b) < (1e-4, 1e-4, 1e-4, 0.006, 1e-4)).all()


@needs_splat4d
@precisions
def test_splat4d_there_and_back(precision: Precision, tmp_path: Path) -> None:
    path = tmp_path / "a.splat4d"
    write_splat4d(path, Moving(), precision)
    theirs, ours = of_splat4d(path, tmp_path), read_here(path)
    assert_close(theirs, precision, ".splat4d read by splat4d")
    assert_close(ours, precision, ".splat4d read here")
    for a, b in zip(theirs, ours, strict=True):
        assert len(a) == len(b)
        # Their decoder returns sizes, not their logarithms.
        for x, y in zip(a.arrays, b.arrays, strict=True):
            assert np.abs(x - y).max() < 1e-5


@needs_splat4d
def test_what_splat4d_makes_of_files_is_read(tmp_path: Path) -> None:
    """Without our writer: Gaussians only move, so that all frames have the same ones."""
    assert PROGRAM is not None
    (tmp_path / "in").mkdir()
    for number in range(NUM_FRAMES):
        rows = splat_rows(turned(FIGURE.take(slice(COUNT)), 0.03 * number))
        (tmp_path / "in" / f"frame_{number:04d}.splat").write_bytes(rows.tobytes())
    words = ["encode", "-i", str(tmp_path / "in"), "-o", str(tmp_path / "a.splat4d"), "--gop", "3"]
    subprocess.run([PROGRAM, *words, "--fps", str(FPS)], check=True, capture_output=True)
    theirs, ours = of_splat4d(tmp_path / "a.splat4d", tmp_path), read_here(tmp_path / "a.splat4d")
    for a, b in zip(theirs, ours, strict=True):
        assert all(np.abs(x - y).max() < 1e-5 for x, y in zip(a.arrays, b.arrays, strict=True))


@needs_fourdgs
@pytest.mark.parametrize("mode", [0, 1])
@pytest.mark.parametrize("codec", [0, 1])
def test_what_fourdgs_makes_is_read(mode: int, codec: int, tmp_path: Path) -> None:
    """Motion, fading, windows, deltas on the keyframe or the state before, deflate and zstd."""
    writer = importlib.import_module("fourdgs.keyframe_delta_writer")
    model = importlib.import_module("fourdgs.model")
    rng = np.random.default_rng(mode)

    def sample(number: int) -> Any:
        ids = np.arange(number, 60 + number)
        gaussians = model.GaussianSet(
            positions=rng.normal(size=(60, 3)),
            scales=np.exp(rng.normal(-4, 1, (60, 3))),
            rotations=rng.normal(size=(60, 4)),
            colors=rng.uniform(0.05, 0.95, (60, 4)),
            motions=rng.normal(size=(60, 3)),
            mu_t=np.full(60, number / FPS),
            sigma_t=0.02 * (1 + ids % 3),
            win_lo=0.03 * (ids % 4),
            win_hi=np.full(60, NUM_FRAMES / FPS),
        )
        return writer.Sample(number / FPS, ids, gaussians)

    options = writer.KeyframeDeltaOptions(keyframe_every=3, delta_mode=mode)
    samples = [sample(number) for number in range(NUM_FRAMES)]
    data = fourdgs.write_sequence(samples, NUM_FRAMES / FPS, kd=options, codec=codec)
    (tmp_path / "a.4dgs").write_bytes(data)
    theirs, ours = of_fourdgs(data), read_here(tmp_path / "a.4dgs")
    assert len({len(splats) for splats in ours}) > 1
    for a, b in zip(theirs, ours, strict=True):
        assert len(a) == len(b)
        assert (largest_errors(a, b) < 1e-4).all()


@needs_fourdgs
@needs_splat4d
@pytest.mark.parametrize("format", list(SequenceFormat))
def test_a_stream_there_and_back(format: SequenceFormat, tmp_path: Path) -> None:
    (tmp_path / "files").mkdir()
    for number, splats in enumerate(FRAMES):
        write_splats(tmp_path / "files" / f"{number}.ply", splats, SplatFormat.PLY)
    import_stream(tmp_path / "files", tmp_path / "stream", ImportOptions(fps=FPS))
    run_ok("swings-stream", "export", tmp_path / "stream", tmp_path / f"all.{format}")
    import_stream(tmp_path / f"all.{format}", tmp_path / "back", ImportOptions())
    assert verify_stream(tmp_path / "back").num_frames == NUM_FRAMES
    before, after = (StreamReader(tmp_path / name) for name in ("stream", "back"))
    assert after.manifest.fps == FPS
    for frame in range(NUM_FRAMES):
        a, b = (reader.active_splats(frame, 4) for reader in (before, after))
        assert (largest_errors(b, a) < (1.5, 0.2, 0.15, 0.03, 0.06)).all()
    # A range of frames, with the identities of a stream with several lanes.
    write_tiny(tmp_path / "tiny", 6)
    [out] = export_stream(tmp_path / "tiny", tmp_path / "t", None, "1:4", format, 1)
    frames = contained_frames(out)
    assert frames is not None
    tracks = StreamTracks(StreamReader(tmp_path / "tiny"), range(1, 4), 1)
    assert len(frames) == 3
    for contained, tracked in zip(frames, tracks, strict=True):
        assert (np.diff(tracked.slots) > 0).all()
        assert tracked.slots[-1] < tracks.num_slots
        assert len(contained.read(1000)) == len(tracked.slots)


def test_what_cannot_be_exported_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_tiny(tmp_path / "tiny", 3)
    for name, options, says in (
        ("a.4dgs", {"frame": 1}, "4dgs holds a sequence; choose its frames by --frames"),
        ("a.splat4d", {"spz_version": SpzVersion.V2}, "splat4d holds a sequence"),
        ("a.ply", {"frame": 1, "precision": Precision.FINE}, "--precision is for 4dgs and splat4d"),
        ("a.4dgs", {"frames": "2:9"}, "has frames 0:3"),
    ):
        with pytest.raises(InvalidError, match=says):
            export_files(Export(str(tmp_path / "tiny"), tmp_path / name, **options))
    monkeypatch.setitem(sys.modules, "fourdgs", None)
    monkeypatch.setattr(shutil, "which", lambda name: None)
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    for format in SequenceFormat:
        with pytest.raises(InvalidError, match=r"pip install '.\[neighbours\]'"):
            export_stream(tmp_path / "tiny", tmp_path / f"b.{format}", None, None, format, None)
        assert not list(tmp_path.glob(f"*b.{format}*"))
