"""A disk that fails or is full: the stream stays valid, and the call can be repeated."""

from __future__ import annotations

import os
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import IO, Any

import pytest

from codec.errors import CorruptError
from codec.stream import StreamReader, StreamWriter
from codec.stream.index import record_bytes
from codec.tools.audit import verify_stream
from tests.support.hostile import file_limit
from tests.support.tiny_stream import append_tiny, files_of, tiny_manifest, tiny_slice, write_tiny

NUM_FRAMES = 10
RECORD_BYTES = record_bytes(2)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    path = tmp_path_factory.mktemp("writer") / "whole"
    write_tiny(path, NUM_FRAMES)
    return files_of(path)


def written(path: Path, num_frames: int = 7) -> StreamWriter:
    """A writer that has written the first frames of the stream."""
    writer = StreamWriter.create(path, tiny_manifest())
    append_tiny(writer, num_frames)
    return writer


def test_a_record_that_fits_in_part_is_taken_back(tmp_path: Path) -> None:
    path = tmp_path / "s"
    # Records of such short segments soon take more than the largest object.
    with StreamWriter.create(path, tiny_manifest(segment_frames=1)) as writer:
        append_tiny(writer, 51)
        index_bytes = os.stat(path / "index.bin").st_size
        assert index_bytes == 51 * RECORD_BYTES
        assert max(p.stat().st_size for p in path.glob("segments/*/*")) < index_bytes
        for room_bytes in (0, 1, RECORD_BYTES - 1):
            with (
                file_limit(index_bytes + room_bytes),
                pytest.raises(OSError, match="File too large"),
            ):
                writer.append(tiny_slice(51))
            assert os.stat(path / "index.bin").st_size == index_bytes
            assert writer.next_birth == verify_stream(path).num_frames == 51
        writer.append(tiny_slice(51))
    assert verify_stream(path).num_frames == 52


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


def test_short_writes_that_go_on_are_not_a_failure(
    tmp_path: Path, whole: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    def opened(path: Path, mode: str, **options: Any) -> object:
        return Grudging(open(path, mode, **options)) if "a" in mode else open(path, mode, **options)

    monkeypatch.setattr("codec.files.open", opened, raising=False)
    write_tiny(tmp_path / "s", NUM_FRAMES)
    assert files_of(tmp_path / "s") == whole


def test_a_torn_end_goes_before_the_next_record(tmp_path: Path, whole: dict[str, bytes]) -> None:
    with written(tmp_path / "s") as writer:
        with open(tmp_path / "s" / "index.bin", "ab") as index:
            index.write(b"torn")
        append_tiny(writer, NUM_FRAMES)
    assert files_of(tmp_path / "s") == whole


def test_an_index_that_somebody_cut_is_not_filled_up(tmp_path: Path) -> None:
    writer = written(tmp_path / "s")
    os.truncate(tmp_path / "s" / "index.bin", 9)
    with pytest.raises(CorruptError, match=r"index\.bin has 9 bytes, not the 228 written"):
        writer.append(tiny_slice(7))


STEPS = ("fsync", "replace")


def fails(
    patch: pytest.MonkeyPatch, at: int, call: Callable[[], object], names: tuple[str, ...] = STEPS
) -> bool:
    """Whether `call` fails if step number `at` of those of the disk does, as in a power failure."""
    steps = 0

    def failing(real: Callable[..., object]) -> Callable[..., object]:
        def step(*arguments: object) -> object:
            nonlocal steps
            steps += 1
            if steps == at:
                raise OSError(28, "No space left on device")
            return real(*arguments)

        return step

    with patch.context() as context:
        for name in names:
            context.setattr(os, name, failing(getattr(os, name)))
        try:
            call()
        except OSError:
            return True
    return False


@pytest.mark.parametrize("name", STEPS)
@pytest.mark.parametrize("again", [True, False])
def test_a_segment_whose_writing_fails_anywhere(
    tmp_path: Path, whole: dict[str, bytes], monkeypatch: pytest.MonkeyPatch, name: str, again: bool
) -> None:
    for at in count(1):
        path = tmp_path / str(at)
        writer = written(path)
        if not fails(monkeypatch, at, lambda w=writer: w.append(tiny_slice(7)), (name,)):
            break
        assert (writer.next_birth, writer.durable_birth) == (7, 4)
        if again:
            append_tiny(writer, NUM_FRAMES)
        writer.close()
        assert verify_stream(path).num_frames == (NUM_FRAMES if again else 7)
        assert not again or files_of(path) == whole
    assert at > 2


def test_a_close_that_failed_can_be_tried_again(
    tmp_path: Path, whole: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    for at in count(1):
        writer = written(tmp_path / str(at), NUM_FRAMES)
        if not fails(monkeypatch, at, writer.close):
            break
        writer.close()
        assert files_of(tmp_path / str(at)) == whole
    assert at > 5


def test_a_failure_at_any_step_of_any_write(
    tmp_path: Path, whole: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    for at in count(1):
        path = tmp_path / str(at)
        if not fails(monkeypatch, at, lambda path=path: write_tiny(path, NUM_FRAMES)):
            break
        if not (path / "manifest.json").exists():
            continue
        assert verify_stream(path).num_frames in (0, 4, 8, 10)
        reader = StreamReader(path)
        for record in reader.records:
            for part in reader.manifest.parts:
                name = f"segments/{record.segment}/{part}"
                assert (path / name).read_bytes() == whole[name]
        if reader.manifest.live:
            with StreamWriter.resume(path) as writer:
                append_tiny(writer, NUM_FRAMES)
        assert files_of(path) == whole
    assert at > 20


def test_a_torn_index_is_read_and_resumed_at_any_byte(tmp_path: Path) -> None:
    path = tmp_path / "s"
    written(path, 8)
    index = (path / "index.bin").read_bytes()
    for torn in range(0, RECORD_BYTES, 7):
        (path / "index.bin").write_bytes(index[: RECORD_BYTES + torn])
        assert StreamReader(path).num_frames == 4
        assert StreamWriter.resume(path).next_birth == 4
        assert (path / "index.bin").read_bytes() == index[:RECORD_BYTES]
