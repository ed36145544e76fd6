"""A disk that fails or is full: the stream stays valid, and the call can be repeated."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import pytest

from codec.errors import CorruptError
from codec.stream import StreamReader, StreamWriter
from codec.stream.index import record_bytes
from codec.tools.audit import verify_stream
from tests.support.commands import ROOT
from tests.support.tiny_stream import (
    append_tiny,
    files_of,
    tiny_manifest,
    tiny_slice,
    write_tiny,
)

NUM_FRAMES = 10


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    path = tmp_path_factory.mktemp("writer") / "whole"
    write_tiny(path, NUM_FRAMES)
    return files_of(path)


# A disk without room for a whole record; the kernel reports a short write, then EFBIG.
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
    """A file that accepts only a few bytes per write."""

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
    """Makes the index accept only a few bytes per write."""

    def opened(path: Path, mode: str, **options: Any) -> object:
        return Grudging(open(path, mode, **options)) if "a" in mode else open(path, mode, **options)

    monkeypatch.setattr("codec.files.open", opened, raising=False)


def test_short_writes_that_go_on_are_not_a_failure(
    tmp_path: Path, whole: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    grudge(monkeypatch)
    write_tiny(tmp_path / "s", NUM_FRAMES)
    assert files_of(tmp_path / "s") == whole


def test_what_could_not_be_taken_back_is_cut_off_before_the_next_record(
    tmp_path: Path, whole: dict[str, bytes]
) -> None:
    path = tmp_path / "s"
    with StreamWriter.create(path, tiny_manifest()) as writer:
        for birth in range(-2, 7):
            writer.append(tiny_slice(birth))
        # As if the rollback had failed, too.
        with open(path / "index.bin", "ab") as index:
            index.write(b"torn")
        append_tiny(writer, NUM_FRAMES)
    assert files_of(path) == whole


def test_an_index_that_somebody_cut_is_not_filled_up(tmp_path: Path) -> None:
    path = tmp_path / "s"
    writer = StreamWriter.create(path, tiny_manifest())
    for birth in range(-2, 7):
        writer.append(tiny_slice(birth))
    os.truncate(path / "index.bin", 9)
    with pytest.raises(CorruptError, match=r"index\.bin has 9 bytes, not the 228 written"):
        writer.append(tiny_slice(7))


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
            append_tiny(writer, NUM_FRAMES)
        writer.close()
        assert verify_stream(path).num_frames == (NUM_FRAMES if again else 7)
        if again:
            assert files_of(path) == whole
    assert at > 2


def test_a_close_that_failed_can_be_tried_again(
    tmp_path: Path, whole: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    at = 0
    while True:
        at += 1
        path = tmp_path / str(at)
        writer = StreamWriter.create(path, tiny_manifest())
        append_tiny(writer, NUM_FRAMES)
        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", failing(at, os.fsync))
            try:
                writer.close()
                break
            except OSError:
                pass
        writer.close()
        assert files_of(path) == whole
    assert at > 5


def assert_valid_prefix(path: Path, whole: dict[str, bytes]) -> int:
    """Asserts that the stream at `path` is valid and a prefix of the one with files `whole`."""
    num_frames = verify_stream(path).num_frames
    reader = StreamReader(path)
    for record in reader.records:
        for part in reader.manifest.parts:
            name = f"segments/{record.segment}/{part}"
            assert (path / name).read_bytes() == whole[name]
    return num_frames


def test_a_failure_at_any_step_of_any_write(
    tmp_path: Path, whole: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each fsync and each rename fails in turn, as in a power failure."""
    real: dict[str, Callable[..., object]] = {"fsync": os.fsync, "replace": os.replace}
    steps = 0

    def failing(name: str, at: int) -> Callable[..., object]:
        def call(*arguments: object) -> object:
            nonlocal steps
            steps += 1
            if steps == at:
                raise OSError("the disk is gone")
            return real[name](*arguments)

        return call

    at = 0
    while True:
        at += 1
        steps = 0
        path = tmp_path / str(at)
        with monkeypatch.context() as patch:
            for name in real:
                patch.setattr(os, name, failing(name, at))
            try:
                write_tiny(path, NUM_FRAMES)
                break
            except OSError:
                pass
        if not (path / "manifest.json").exists():
            continue
        frames = assert_valid_prefix(path, whole)
        assert frames in (0, 4, 8, 10)
        if StreamReader(path).manifest.live:
            with StreamWriter.resume(path) as writer:
                for birth in range(writer.next_birth, NUM_FRAMES):
                    writer.append(tiny_slice(birth))
        assert files_of(path) == whole
    assert at > 20


def test_a_torn_index_is_read_and_resumed_at_any_byte(tmp_path: Path) -> None:
    path = tmp_path / "s"
    writer = StreamWriter.create(path, tiny_manifest())
    for birth in range(-2, 8):
        writer.append(tiny_slice(birth))
    index = (path / "index.bin").read_bytes()
    for torn in range(0, record_bytes(2), 7):
        (path / "index.bin").write_bytes(index[: record_bytes(2) + torn])
        assert StreamReader(path).num_frames == 4
        writer = StreamWriter.resume(path)
        assert writer.next_birth == 4
        assert (path / "index.bin").read_bytes() == index[: record_bytes(2)]
