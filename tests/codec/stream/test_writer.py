"""What a writer refuses; and one whose call failed is as it was before: the call can be made again,
or the stream closed."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

import numpy as np
import pytest

from codec.errors import CorruptError, InvalidError
from codec.profiles.profile import Profile
from codec.slice import Slice
from codec.splats import Splats
from codec.stream import StreamReader, StreamWriter
from codec.stream.index import record_bytes
from codec.tools.audit import verify_stream
from tests.support.commands import ROOT
from tests.support.tiny_stream import tiny_manifest, tiny_slice, write_tiny

NUM_FRAMES = 10


def files(path: Path) -> dict[str, bytes]:
    """All that is there but leftovers, which a reader ignores."""
    found = (p for p in path.rglob("*") if p.is_file() and not p.name.startswith("."))
    return {str(p.relative_to(path)): p.read_bytes() for p in found}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    path = tmp_path_factory.mktemp("writer") / "whole"
    write_tiny(path, NUM_FRAMES)
    return files(path)


def append_all(writer: StreamWriter) -> None:
    for birth in range(writer.next_birth, NUM_FRAMES):
        writer.append(tiny_slice(birth))


def test_what_the_writer_refuses(tmp_path: Path) -> None:
    manifest = tiny_manifest()
    with pytest.raises(InvalidError, match="no rank is called 'size'"):
        StreamWriter.create(tmp_path / "s", manifest, rank="size")  # type: ignore[arg-type]
    writer = StreamWriter.create(tmp_path / "s", manifest)
    with pytest.raises(InvalidError, match="not empty"):
        StreamWriter.create(tmp_path / "s", manifest)
    with pytest.raises(InvalidError, match="born at 0, expected -2"):
        writer.append(tiny_slice(0))
    slice = tiny_slice(-2)
    double = Splats.concatenate([slice.splats, slice.splats])
    with pytest.raises(InvalidError, match="80 Gaussians, at most 40"):
        writer.append(Slice(-2, double, np.zeros(80, np.uint8)))
    with pytest.raises(InvalidError, match="SH degree 1, not 0"):
        writer.append(Slice(-2, Splats.empty(1), np.zeros(0, np.uint8)))
    writer.append(slice)
    writer.close()
    writer.close()
    with pytest.raises(InvalidError, match="closed"):
        writer.append(tiny_slice(-1))
    assert StreamReader(tmp_path / "s").num_frames == 0
    with pytest.raises(InvalidError, match="finished"):
        StreamWriter.resume(tmp_path / "s")


def test_after_a_short_segment_nothing_follows(tmp_path: Path) -> None:
    path = tmp_path / "s"
    write_tiny(path, 6)
    live = replace(StreamReader(path).manifest, live=True)
    # Killed after the last record, before the manifest said that the stream is finished.
    (path / "manifest.json").write_bytes(live.to_json())
    with StreamWriter.resume(path) as writer:
        assert (writer.next_birth, writer.complete) == (6, True)
        with pytest.raises(InvalidError, match="nothing can follow"):
            writer.append(tiny_slice(6))
    assert not StreamReader(path).manifest.live


# A disk that has no room for all of a record, as the kernel shows it: a short write, then EFBIG.
SHORT_OF_SPACE = """
import os, resource, sys
from pathlib import Path
from codec.tools.audit import verify_stream
from codec.stream.index import record_bytes
from codec.stream import StreamWriter
from tests.support.tiny_stream import tiny_manifest, tiny_slice

path, room = Path(sys.argv[1]), int(sys.argv[2])
manifest = tiny_manifest(segment_frames=1)
writer = StreamWriter.create(path, manifest)
# Records of such short segments soon take more than the largest object.
births = iter(range(manifest.first_birth, 400))
for birth in births:
    writer.append(tiny_slice(birth))
    if birth == 50:
        break
index_bytes = os.stat(path / "index.bin").st_size
assert index_bytes == 51 * record_bytes(2)
assert max(p.stat().st_size for p in path.glob("segments/*/*")) < index_bytes
before = resource.getrlimit(resource.RLIMIT_FSIZE)
resource.setrlimit(resource.RLIMIT_FSIZE, (index_bytes + room, before[1]))
for _ in range(2):
    try:
        writer.append(tiny_slice(51))
    except OSError as error:
        print(type(error).__name__, error.strerror)
    assert os.stat(path / "index.bin").st_size == index_bytes
    assert writer.next_birth == 51
    assert verify_stream(path).num_frames == 51
resource.setrlimit(resource.RLIMIT_FSIZE, before)
writer.append(tiny_slice(51))
writer.close()
assert verify_stream(path).num_frames == 52
"""


@pytest.mark.skipif(not Path("/proc").exists(), reason="needs Linux: RLIMIT_FSIZE")
@pytest.mark.parametrize("room", [0, 1, record_bytes(2) - 1])
def test_a_record_that_fits_in_part_is_taken_back(tmp_path: Path, room: int) -> None:
    done = subprocess.run(
        [sys.executable, "-c", SHORT_OF_SPACE, str(tmp_path / "s"), str(room)],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert (done.returncode, done.stdout) == (0, "OSError File too large\n" * 2), done.stderr


class Grudging:
    """A file that takes a few bytes a write."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file

    def write(self, data: memoryview) -> int:
        return self._file.write(data[:7])

    def __enter__(self) -> Grudging:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def __getattr__(self, name: str) -> object:
        return getattr(self._file, name)


def grudge(monkeypatch: pytest.MonkeyPatch) -> None:
    """Makes the index take a few bytes at a time."""

    def opened(path: Path, mode: str, **options: Any) -> object:
        return Grudging(open(path, mode, **options)) if "a" in mode else open(path, mode, **options)

    monkeypatch.setattr("codec.files.open", opened, raising=False)


def test_short_writes_that_go_on_are_not_a_failure(
    tmp_path: Path, whole: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    grudge(monkeypatch)
    write_tiny(tmp_path / "s", NUM_FRAMES)
    assert files(tmp_path / "s") == whole


def test_what_could_not_be_taken_back_is_cut_off_before_the_next_record(
    tmp_path: Path, whole: dict[str, bytes]
) -> None:
    path = tmp_path / "s"
    with StreamWriter.create(path, tiny_manifest()) as writer:
        for birth in range(-2, 7):
            writer.append(tiny_slice(birth))
        # As if taking back had failed too.
        with open(path / "index.bin", "ab") as index:
            index.write(b"torn")
        append_all(writer)
    assert files(path) == whole


def test_an_index_that_somebody_cut_is_not_filled_up(tmp_path: Path) -> None:
    path = tmp_path / "s"
    writer = StreamWriter.create(path, tiny_manifest())
    for birth in range(-2, 7):
        writer.append(tiny_slice(birth))
    os.truncate(path / "index.bin", 9)
    with pytest.raises(CorruptError, match=r"index\.bin has 9 bytes, not the 108 written"):
        writer.append(tiny_slice(7))


def too_far(birth: int) -> Slice:
    """One that profile paper refuses, in its last layer: a mean beyond fp16."""
    slice = tiny_slice(birth)
    means = slice.splats.means.copy()
    means[slice.splats.logit_opacities.argmin()] = 1e6
    return replace(slice, splats=replace(slice.splats, means=means))


@pytest.mark.parametrize("birth", [-2, 0, 3, 9])
def test_a_slice_that_was_refused_leaves_nothing(tmp_path: Path, birth: int) -> None:
    manifest = tiny_manifest(Profile.PAPER)
    write_tiny(tmp_path / "whole", NUM_FRAMES, manifest)
    with StreamWriter.create(tmp_path / "s", manifest) as writer:
        for good in range(-2, birth):
            writer.append(tiny_slice(good))
        for _ in range(2):
            with pytest.raises(InvalidError):
                writer.append(too_far(birth))
        append_all(writer)
    assert files(tmp_path / "s") == files(tmp_path / "whole")


@pytest.mark.parametrize("birth", [0, 2, 3, 8, 9])
def test_a_refused_slice_and_then_the_end(tmp_path: Path, birth: int) -> None:
    with StreamWriter.create(tmp_path / "s", tiny_manifest(Profile.PAPER)) as writer:
        for good in range(-2, birth):
            writer.append(tiny_slice(good))
        with pytest.raises(InvalidError):
            writer.append(too_far(birth))
    assert verify_stream(tmp_path / "s").num_frames == birth


@pytest.mark.parametrize("birth", [1, 3, 9])
def test_a_quality_that_raises_leaves_nothing(
    tmp_path: Path, whole: dict[str, bytes], birth: int
) -> None:
    fail = True

    def quality(frame: int, slices: Sequence[Slice]) -> list[float] | None:
        if fail and frame == birth:
            raise ZeroDivisionError
        return [20.0 + frame, 30.0] if frame >= 0 else None

    path = tmp_path / "s"
    with StreamWriter.create(path, tiny_manifest(), quality=quality) as writer:
        for good in range(-2, birth):
            writer.append(tiny_slice(good))
        with pytest.raises(ZeroDivisionError):
            writer.append(tiny_slice(birth))
        fail = False
        append_all(writer)
    assert [record.psnr_db for record in StreamReader(path).records] == [
        (21.5, 30.0),
        (25.5, 30.0),
        (28.5, 30.0),
    ]
    found = files(path)
    assert {name: data for name, data in found.items() if name != "index.bin"} == {
        name: data for name, data in whole.items() if name != "index.bin"
    }


@pytest.mark.parametrize("scores", [(30.0, math.inf), (30.0,), (30.0, 31.0, 32.0)])
def test_a_quality_that_the_index_cannot_hold(tmp_path: Path, scores: tuple[float, ...]) -> None:
    with StreamWriter.create(
        tmp_path / "s", tiny_manifest(), quality=lambda frame, slices: scores
    ) as writer:
        with pytest.raises(InvalidError, match="is not 2 numbers, each finite"):
            writer.append(tiny_slice(-2))
        assert writer.next_birth == -2


def failing(at: int, real: Callable[..., object]) -> Callable[..., object]:
    calls = 0

    def call(*arguments: object) -> object:
        nonlocal calls
        calls += 1
        if calls == at:
            raise OSError(28, "No space left on device")
        return real(*arguments)

    return call


@pytest.mark.parametrize("name", ["fsync", "replace"])
@pytest.mark.parametrize("again", [True, False])
def test_a_segment_whose_writing_fails_anywhere(
    tmp_path: Path, whole: dict[str, bytes], monkeypatch: pytest.MonkeyPatch, name: str, again: bool
) -> None:
    at = 0
    while True:
        at += 1
        path = tmp_path / str(at)
        writer = StreamWriter.create(path, tiny_manifest())
        for birth in range(-2, 7):
            writer.append(tiny_slice(birth))
        with monkeypatch.context() as patch:
            patch.setattr(os, name, failing(at, getattr(os, name)))
            try:
                writer.append(tiny_slice(7))
                break
            except OSError:
                pass
        assert (writer.next_birth, writer.durable_birth) == (7, 4)
        if again:
            append_all(writer)
        writer.close()
        assert verify_stream(path).num_frames == (NUM_FRAMES if again else 7)
        if again:
            assert files(path) == whole
    assert at > 2


def test_a_close_that_failed_can_be_tried_again(
    tmp_path: Path, whole: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    at = 0
    while True:
        at += 1
        path = tmp_path / str(at)
        writer = StreamWriter.create(path, tiny_manifest())
        append_all(writer)
        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", failing(at, os.fsync))
            try:
                writer.close()
                break
            except OSError:
                pass
        writer.close()
        assert files(path) == whole
    assert at > 5
