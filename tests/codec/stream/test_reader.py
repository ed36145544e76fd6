"""A stream on disk: any window is there, and whatever happens to the writer it stays valid."""

from __future__ import annotations

import hashlib
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from codec.errors import CodecError, CorruptError, InvalidError
from codec.profiles.profile import Profile
from codec.slice import Slice
from codec.splats import Splats
from codec.stream import StreamReader, StreamWriter
from codec.stream.chunk import Chunk, encode_chunk
from codec.stream.index import pack_record, record_bytes
from codec.stream.object import encode_object
from codec.tools.audit import summarise, verify_stream
from tests.support.commands import ROOT
from tests.support.tiny_stream import SLICE_SIZE, tiny_manifest, tiny_slice, write_tiny

NUM_FRAMES = 10


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("streams") / "finished"
    write_tiny(path, NUM_FRAMES)
    return path


@pytest.fixture
def stream(finished: Path, tmp_path: Path) -> Path:
    """A copy that a test may alter."""
    return Path(shutil.copytree(finished, tmp_path / "stream"))


def files(path: Path) -> dict[str, bytes]:
    return {str(p.relative_to(path)): p.read_bytes() for p in path.rglob("*") if p.is_file()}


def test_every_window_shows_the_slices_that_went_in(tmp_path: Path) -> None:
    manifest = tiny_manifest(Profile.RAW)
    write_tiny(tmp_path / "s", NUM_FRAMES, manifest)
    reader = StreamReader(tmp_path / "s")
    assert (reader.num_frames, len(reader.records), reader.manifest.live) == (NUM_FRAMES, 3, False)
    for frame in (9, 0, 5, 3, 4):
        window = reader.window(frame, 2)
        assert [part.birth for part in window] == [frame - 2, frame - 1, frame]
        expected = Splats.concatenate(
            [
                s.splats.take(np.flatnonzero(s.active(frame, 3)))
                for s in map(tiny_slice, range(frame - 2, frame + 1))
            ]
        )
        found = reader.active_splats(frame, 2)
        assert sorted(found.means[:, 0].tolist()) == sorted(expected.means[:, 0].tolist())
    assert [part.birth for part in reader.slices(-2, 1)] == list(range(-2, NUM_FRAMES))
    assert len(reader.slice(4, 1).splats) == SLICE_SIZE // 2


def test_fewer_layers_read_fewer_objects(stream: Path) -> None:
    for path in stream.glob("segments/*/1"):
        path.unlink()
    reader = StreamReader(stream)
    assert len(list(reader.slices(-2, 1))) == NUM_FRAMES + 2
    with pytest.raises(CorruptError, match=r"segments/0/1 is missing"):
        reader.slice(0, 2)


@pytest.mark.parametrize(("swin_size", "segment_frames"), [(1, 1), (9, 2), (3, 4096), (255, 5)])
def test_windows_and_segments_of_any_length(
    tmp_path: Path, swin_size: int, segment_frames: int
) -> None:
    write_tiny(tmp_path / "s", 5, tiny_manifest(Profile.RAW, swin_size, segment_frames))
    reader = StreamReader(tmp_path / "s")
    for frame in range(5):
        assert len(reader.window(frame, 2)) == swin_size
    assert verify_stream(tmp_path / "s").num_frames == 5


def test_memory_of_reader_and_writer_is_bounded(tmp_path: Path) -> None:
    manifest = tiny_manifest()
    with StreamWriter.create(tmp_path / "s", manifest) as writer:
        for birth in range(-2, 60):
            writer.append(tiny_slice(birth))
            assert writer.num_packets <= 2 * (4 + 2)
    assert writer.bytes_written == sum(
        p.stat().st_size for p in (tmp_path / "s").glob("segments/*/*")
    )
    reader = StreamReader(tmp_path / "s")
    for frame in range(60):
        reader.window(frame, 2)
        assert len(reader._objects) <= 4
        assert len(reader._chunks) <= 8


def test_the_cache_is_bounded_by_what_its_chunks_hold(tmp_path: Path) -> None:
    """The layers of a hostile stream: each is as full as the whole slice may be."""
    path, num_layers = tmp_path / "s", 8
    manifest = replace(tiny_manifest(Profile.RAW), layers=(1 / num_layers,) * num_layers)
    write_tiny(path, NUM_FRAMES, manifest)
    records = []
    for record in StreamReader(path).records:
        births = manifest.births(record.segment, record.num_frames)
        objects = [
            encode_object([encode_chunk(tiny_slice(b), layer, Profile.RAW) for b in births])
            for layer in range(num_layers)
        ]
        for layer, data in enumerate(objects):
            (path / f"segments/{record.segment}/{layer}").write_bytes(data)
        hashes = tuple(hashlib.sha256(data).digest() for data in objects)
        records.append(replace(record, object_bytes=tuple(map(len, objects)), object_sha256=hashes))
    (path / "index.bin").write_bytes(b"".join(map(pack_record, records)))
    reader = StreamReader(path)
    for birth in reader.births:
        for layer in range(num_layers):
            assert len(reader.chunk(birth, layer).slice.splats) == SLICE_SIZE
            held = sum(len(chunk.slice.splats) for chunk in reader._chunks.values())
            assert held == reader._chunk_splats <= (manifest.swin_size + 1) * SLICE_SIZE


def test_a_window_is_decoded_once(finished: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reader = StreamReader(finished)
    decoded = 0

    def counting(birth: int, layer: int) -> Chunk:
        nonlocal decoded
        decoded += 1
        return StreamReader._decode(reader, birth, layer)

    monkeypatch.setattr(reader, "_decode", counting)
    for frame in range(NUM_FRAMES):
        reader.window(frame, 2)
        reader.window(frame, 2)
    assert decoded == 2 * len(reader.births)


def test_arguments_out_of_range(finished: Path) -> None:
    reader = StreamReader(finished)
    wrong: list[Callable[[], object]] = [
        lambda: reader.slice(NUM_FRAMES, 1),
        lambda: reader.slice(-3, 1),
        lambda: reader.slice(0, 0),
        lambda: reader.slice(0, 3),
        lambda: reader.window(-1, 1),
        lambda: reader.window(NUM_FRAMES, 1),
        lambda: reader.read_object(3, 0),
        lambda: reader.read_object(0, 2),
    ]
    for call in wrong:
        with pytest.raises(InvalidError):
            call()


def test_empty_and_partial_slices_are_fine(tmp_path: Path) -> None:
    with StreamWriter.create(tmp_path / "s", tiny_manifest()) as writer:
        for birth in range(-2, 4):
            writer.append(Slice(birth, Splats.empty(), np.zeros(0, np.uint8)))
    assert len(StreamReader(tmp_path / "s").active_splats(3, 2)) == 0


def test_a_growing_stream_is_followed(tmp_path: Path) -> None:
    path = tmp_path / "s"
    with StreamWriter.create(path, tiny_manifest()) as writer:
        reader = StreamReader(path)
        assert (reader.num_frames, reader.manifest.live) == (0, True)
        for birth in range(-2, 9):
            writer.append(tiny_slice(birth))
        assert reader.refresh() == 2
        assert (reader.num_frames, reader.manifest.live) == (8, True)
        assert reader.slice(7, 2).birth == 7
        assert reader.refresh() == 0
    assert reader.refresh() == 1
    assert (reader.num_frames, reader.manifest.live) == (9, False)
    assert summarise(path).num_frames == 9


def assert_valid_prefix(path: Path, whole: dict[str, bytes]) -> int:
    """The stream at `path` is good and begins like the one of which `whole` are the files."""
    num_frames = verify_stream(path).num_frames
    for record in StreamReader(path).records:
        for layer in range(2):
            name = f"segments/{record.segment}/{layer}"
            assert (path / name).read_bytes() == whole[name]
    return num_frames


def write_and_fail(path: Path, num_frames: int) -> None:
    """Writes `num_frames` frames, then fails inside the `with`."""
    with StreamWriter.create(path, tiny_manifest()) as writer:
        for birth in range(-2, num_frames):
            writer.append(tiny_slice(birth))
        raise ZeroDivisionError


def test_an_exception_leaves_a_shorter_live_stream_that_resumes(
    tmp_path: Path, finished: Path
) -> None:
    path = tmp_path / "s"
    with pytest.raises(ZeroDivisionError):
        write_and_fail(path, 6)
    assert assert_valid_prefix(path, files(finished)) == 4
    with StreamWriter.resume(path) as writer:
        assert writer.next_birth == 4
        for birth in range(4, NUM_FRAMES):
            writer.append(tiny_slice(birth))
    assert files(path) == files(finished)


def test_a_failure_at_any_step_of_any_write(
    tmp_path: Path, finished: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As if the power went at each fsync and each rename in turn."""
    whole = files(finished)
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
        assert files(path) == whole
    assert at > 20


def test_killed_at_any_instant(tmp_path: Path, finished: Path) -> None:
    path = tmp_path / "s"
    num_frames = 40
    write_tiny(tmp_path / "whole", num_frames)
    whole = files(tmp_path / "whole")
    rng = random.Random(0)
    lengths = [0]
    for round_ in range(5):
        process = subprocess.Popen(
            [sys.executable, "-m", "tests.support.tiny_stream", str(path), str(num_frames)],
            cwd=ROOT,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert process.stdout is not None
        if round_ < 4:
            for _ in range(rng.randrange(4, 12)):
                process.stdout.readline()
            time.sleep(rng.uniform(0, 0.01))
            process.kill()
        process.communicate(timeout=60)
        assert process.returncode == (-signal.SIGKILL if round_ < 4 else 0)
        lengths.append(assert_valid_prefix(path, whole))
        assert lengths[-1] >= lengths[-2]
    assert lengths[-2] > 0
    assert files(path) == whole


def test_a_torn_index_is_read_and_resumed_at_any_byte(tmp_path: Path) -> None:
    path = tmp_path / "s"
    with pytest.raises(ZeroDivisionError):
        write_and_fail(path, 8)
    index = (path / "index.bin").read_bytes()
    for torn in range(0, record_bytes(2), 7):
        (path / "index.bin").write_bytes(index[: record_bytes(2) + torn])
        assert StreamReader(path).num_frames == 4
        writer = StreamWriter.resume(path)
        assert writer.next_birth == 4
        assert (path / "index.bin").read_bytes() == index[: record_bytes(2)]


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("manifest.json", lambda data: data[:-9]),
        ("manifest.json", lambda data: data.replace(b'"fps": 25.0', b'"fps": "x"')),
        ("manifest.json", lambda data: data.replace(b'"profile": "compact"', b'"profile": "raw"')),
        (
            "manifest.json",
            lambda data: data.replace(b'"segment_frames": 4', b'"segment_frames": 5'),
        ),
        ("manifest.json", lambda data: data.replace(b'"swin_size": 3', b'"swin_size": 2')),
        ("manifest.json", lambda data: data.replace(b'"num_gs": 120', b'"num_gs": 60')),
        ("manifest.json", None),
        ("index.bin", lambda data: data[:20] + b"\xff" + data[21:]),
        ("index.bin", None),
        ("segments/1/0", lambda data: data[:-1]),
        ("segments/1/0", lambda data: data + b"\0"),
        ("segments/1/1", lambda data: data[:50] + bytes([data[50] ^ 4]) + data[51:]),
        ("segments/2/1", lambda data: b""),
        ("segments/2/1", None),
    ],
)
def test_an_altered_folder_gives_one_line_that_names_the_file(
    stream: Path, name: str, change: Callable[[bytes], bytes] | None
) -> None:
    path = stream / name
    if change is None:
        path.unlink()
    else:
        path.write_bytes(change(path.read_bytes()))
    with pytest.raises(CodecError) as caught:
        verify_stream(stream)
    message = str(caught.value)
    assert str(stream) in message
    # A manifest that contradicts the rest shows in whichever file is compared with it first.
    assert name.split("/")[0] in message or name == "manifest.json"
    assert "\n" not in message


def test_truncated_anywhere_every_file_is_refused_or_shorter(stream: Path) -> None:
    for name in ("segments/0/0", "manifest.json"):
        data = (stream / name).read_bytes()
        for length in range(0, len(data) - 2, 41):
            (stream / name).write_bytes(data[:length])
            with pytest.raises(CodecError, match=name):
                verify_stream(stream)
        (stream / name).write_bytes(data)
    index = (stream / "index.bin").read_bytes()
    for length in range(0, len(index), 13):
        (stream / "index.bin").write_bytes(index[:length])
        frames = (0, 4, 8)[length // record_bytes(2)]
        assert StreamReader(stream).num_frames == frames
        if length % record_bytes(2):
            with pytest.raises(CodecError, match=r"index\.bin: byte \d+: .* of a finished stream"):
                verify_stream(stream)
        else:
            assert verify_stream(stream).num_frames == frames


def test_an_object_with_the_right_hash_and_the_wrong_births(stream: Path) -> None:
    reader = StreamReader(stream)
    data = encode_object([encode_chunk(tiny_slice(birth), 0, Profile.COMPACT) for birth in (4, 6)])
    (stream / "segments/1/0").write_bytes(data)
    records = list(reader.records)
    records[1] = replace(
        records[1],
        object_bytes=(len(data), records[1].object_bytes[1]),
        object_sha256=(hashlib.sha256(data).digest(), records[1].object_sha256[1]),
    )
    (stream / "index.bin").write_bytes(b"".join(map(pack_record, records)))
    with pytest.raises(
        CorruptError, match=r"segments/1/0: byte 32: object: its births are not 4..7"
    ):
        verify_stream(stream)


@pytest.mark.parametrize("path", ["absent", "a-file"])
def test_what_is_not_a_stream(tmp_path: Path, path: str) -> None:
    (tmp_path / "a-file").write_text("hello", encoding="utf-8")
    with pytest.raises(CodecError, match=path):
        StreamReader(tmp_path / path)
    with pytest.raises(CodecError, match=r"manifest\.json"):
        StreamReader(tmp_path)
    with pytest.raises(CodecError, match="missing; this is not a whole swings stream"):
        StreamWriter.resume(tmp_path)
