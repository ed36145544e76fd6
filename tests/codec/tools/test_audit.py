"""swings-stream verify reports the first wrong byte and its file; `import codec` opens streams."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import codec
from codec.errors import CodecError, CorruptError, InvalidError
from codec.slots.skipmap import encode_skip_map
from codec.slots.slotlayout import ENDED, KEPT
from codec.storage.openstorage import open_storage
from codec.stream import StreamReader, StreamWriter
from codec.stream.manifest import SKIP_MAPS, Part, is_keyframe, keyframe_part
from codec.stream.segment import encode_packet, read_object_table
from codec.tools.audit import verify_stream
from tests.support.drawn import same_splats
from tests.support.hostile import flips, packets_of, put_packets, refused
from tests.support.slots.folder import write_slots
from tests.support.tiny_stream import append_tiny, tiny_manifest, write_tiny

NUM_FRAMES = 6


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("audit") / "finished"
    write_tiny(path, NUM_FRAMES)
    return path


@pytest.fixture
def stream(finished: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(finished, tmp_path / "stream"))


@pytest.fixture
def updates(tmp_path: Path) -> Path:
    """A stream whose slots last."""
    path = tmp_path / "updates"
    write_slots(path, 10)
    return path


def found(stream: Path, name: str) -> CodecError:
    """The error of verify; its message contains `name` and its byte."""
    error: CodecError = refused(CodecError, "", verify_stream, stream)
    message = str(error)
    assert message.startswith(f"{stream / name}: ")
    assert "\n" not in message
    told = re.match(r": byte ([0-9]+): ", message.removeprefix(str(stream / name)))
    assert error.at == (int(told[1]) if told else None)
    return error


def fields(data: bytes) -> list[int]:
    """Beginnings of an object's parts that are checked as one: fields, packets; and its end."""
    entries = read_object_table(data)
    table = [20 + 12 * n + field for n in range(len(entries)) for field in (0, 4, 8)]
    return [0, 4, 8, 12, 13, 14, 16, *table, *(entry.offset for entry in entries), len(data)]


@pytest.mark.parametrize("name", ["segments/1/0", "segments/1/skipmaps", "segments/0/keyframe-1"])
def test_an_altered_byte_is_found_in_its_field_or_packet(stream: Path, name: str) -> None:
    path = stream / name
    data = path.read_bytes()
    parts = list(pairwise(fields(data)))
    # Each contradicts an earlier value: the count the length of the table, an offset the size of
    # the previous packet, a birth the previous one.
    slack_bytes = 12
    unplaced = 0
    every = 7
    for n, altered in enumerate(flips(data, every)):
        place = n // 3 * every
        path.write_bytes(altered)
        error = found(stream, name)
        assert "was altered" in str(error)
        if error.at is None:
            unplaced += 1
            continue
        begin, end = next((a, b) for a, b in parts if a <= place < b)
        in_table = end <= parts[-2][0] and place < read_object_table(data)[0].offset
        assert begin - (slack_bytes if in_table else 0) <= error.at <= place < end
    # A decoder ignores a bit or two of a frame's header; then the place is unknown.
    assert unplaced <= 0.01 * 3 * len(data) / every


def test_an_object_is_wrong_where_it_ends(stream: Path) -> None:
    assert verify_stream(stream).num_frames == NUM_FRAMES
    path = stream / "segments/0/1"
    data = path.read_bytes()
    for length in range(0, len(data), 17):
        path.write_bytes(data[:length])
        assert found(stream, "segments/0/1").at == length
    path.write_bytes(data + b"more")
    assert found(stream, "segments/0/1").at == len(data)
    index = stream / "index.bin"
    records = index.read_bytes()
    index.write_bytes(records + b"torn")
    assert found(stream, "index.bin").at == len(records)
    index.write_bytes(records)
    # Damage before the end comes first.
    entry = read_object_table(data)[1]
    at = entry.offset + entry.size - 1
    path.write_bytes(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 : -3])
    assert found(stream, "segments/0/1").at == entry.offset


def test_the_first_of_several_damaged_files_is_named(stream: Path) -> None:
    for name in ("segments/1/0", "segments/0/1"):
        data = (stream / name).read_bytes()
        (stream / name).write_bytes(data[:-1])
    found(stream, "segments/0/1")
    (stream / "segments/0/0").unlink()
    refused(CodecError, r"segments/0/0 is missing", verify_stream, stream)
    (stream / "index.bin").unlink()
    refused(CodecError, r"stream.*index\.bin", verify_stream, stream)


@pytest.mark.parametrize(
    ("change", "at"),
    [
        (lambda data: data[:100], 100),
        (lambda data: b"", 0),
        (lambda data: data[:40] + b"\xff" + data[41:], 40),
        (lambda data: data.replace(b'"fps": 25.0,', b'"fps": 25.0;'), 29),
    ],
)
def test_a_manifest_cut_off(stream: Path, change: Callable[[bytes], bytes], at: int) -> None:
    path = stream / "manifest.json"
    path.write_bytes(change(path.read_bytes()))
    error = found(stream, "manifest.json")
    assert error.at is not None
    # A token that is cut off is noticed at its beginning.
    assert at - 20 <= error.at <= at


def test_a_wrong_chunk_with_a_right_hash(stream: Path) -> None:
    first, _ = packets_of(stream, 1, 1)
    put_packets(stream, 1, 1, [first, (5, packets_of(stream, 1, 0)[1][1])])
    error = found(stream, "segments/1/1")
    assert error.at == 20 + 12 * 2 + len(first[1])
    assert "altered" not in str(error)
    assert "change: layer 0 where layer 1 belongs (chunk of birth 5, " in str(error)


def test_the_slice_born_at_0_is_in_the_keyframes_alone(stream: Path) -> None:
    """Only a checker reads a skip map of birth 0 that has other statuses than kept."""
    layout = StreamReader(stream).manifest.slot_layout
    history = np.zeros(layout.num_slots, np.uint8)
    kept, ended = (
        encode_packet(
            encode_skip_map(layout, 0, np.full(layout.num_slots, status, np.uint8), history)
        )
        for status in (KEPT, ENDED)
    )
    skip_maps = packets_of(stream, 0, SKIP_MAPS)
    put_packets(stream, 0, SKIP_MAPS, [(0, kept), *skip_maps])
    assert verify_stream(stream).num_frames == NUM_FRAMES
    put_packets(stream, 0, SKIP_MAPS, [(0, ended), *skip_maps])
    error = found(stream, "segments/0/skipmaps")
    assert "the slice born at 0 does not keep all slots" in str(error)


@pytest.mark.parametrize("part", [SKIP_MAPS, 0, keyframe_part(0)])
def test_a_packet_that_was_altered_is_named_once(updates: Path, part: Part) -> None:
    (birth, packet), *others = packets_of(updates, 0, part)
    put_packets(updates, 0, part, [(birth, packet[:-1] + bytes([packet[-1] ^ 1])), *others])
    error = refused(CorruptError, "checksum", verify_stream, updates)
    assert str(error).count("segments") == 1
    if is_keyframe(part):
        error = refused(CorruptError, "checksum", lambda: StreamReader(updates).window(0, 1))
        assert str(error).count("segments") == 1


def test_what_a_faulty_writer_would_do_is_named(updates: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    write_slots(other, 10, seed=1)
    cases: list[tuple[int, Part, str]] = [
        (1, SKIP_MAPS, "skip map|change"),
        (1, 1, "change"),
        (1, keyframe_part(0), "is not what the slices before it left"),
        (0, keyframe_part(1), "change|keyframe"),
    ]
    for segment, part, message in cases:
        good = packets_of(updates, segment, part)
        put_packets(updates, segment, part, packets_of(other, segment, part))
        assert "segments" in str(refused(CorruptError, message, verify_stream, updates))
        put_packets(updates, segment, part, good)
    verify_stream(updates)
    skip_maps, layer = packets_of(updates, 0, SKIP_MAPS), packets_of(updates, 0, 0)
    assert [birth for birth, _ in layer] == [1, 2, 3]
    put_packets(updates, 0, 0, [(1, layer[1][1]), *layer[1:]])

    def refused_window(says: str) -> str:
        return str(refused(CorruptError, says, lambda: StreamReader(updates).window(1, 2)))

    told = refused_window("birth 2 where birth 1 belongs")
    assert told.startswith(str(updates / "segments" / "0" / "0"))
    put_packets(updates, 0, 0, layer)
    put_packets(updates, 0, SKIP_MAPS, [*skip_maps, (4, skip_maps[-1][1])])
    refused_window(r"birth 4 is not one of 0\.\.3")
    put_packets(updates, 0, SKIP_MAPS, skip_maps)
    put_packets(updates, 0, 1, packets_of(updates, 0, 1)[1:])
    refused_window(r"segments/0/1: .*it is missing, but the skip map declares")


FRAMES = 7


@pytest.fixture(params=[write_tiny, write_slots])
def place(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    request.param(tmp_path / "stream", FRAMES)
    return tmp_path / "stream"


def test_three_lines_give_a_frame(place: Path) -> None:
    opened = codec.open_stream(str(place))
    splats = opened.frame(5)
    reader = StreamReader(place)
    assert same_splats(splats, reader.active_splats(5, reader.manifest.num_layers))
    assert same_splats(opened[5], splats)
    assert same_splats(opened[5 - FRAMES], splats)
    assert repr(opened).endswith(f"stream: {FRAMES} frames at 25 a second, 2 layers>")
    assert (len(opened), opened.fps) == (reader.num_frames, reader.manifest.fps)
    assert [c.name for c in opened.cameras] == [c.name for c in reader.manifest.cameras]
    assert opened.camera().name == reader.manifest.default_camera


def test_whatever_names_a_folder_opens_it(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = codec.open_stream(place).frame(0)
    monkeypatch.chdir(place.parent)
    for way in ("stream", "./stream/", Path("stream"), open_storage(place)):
        with codec.open_stream(way) as opened:
            assert same_splats(opened.frame(0), expected)


def test_fewer_layers_and_frames_in_any_order(place: Path) -> None:
    reader = StreamReader(place)
    with codec.open_stream(place) as opened:
        sizes = [len(opened.frame(4, layers=n)) for n in range(1, opened.num_layers + 1)]
        assert same_splats(opened.frame(4, 1), reader.active_splats(4, 1))
        assert sizes == sorted(set(sizes))
        forward = list(opened)
        assert len(forward) == FRAMES
        for frame in (6, 0, 5, 1, 1, 4):
            assert same_splats(opened.frame(frame), forward[frame])


def test_a_live_stream_grows_when_one_asks(tmp_path: Path) -> None:
    writer = StreamWriter.create(tmp_path / "stream", tiny_manifest())
    append_tiny(writer, 4)
    with codec.open_stream(tmp_path / "stream") as opened:
        assert (opened.num_frames, opened.refresh()) == (4, 0)
        append_tiny(writer, 8)
        assert (opened.refresh(), opened.num_frames) == (4, 8)
        assert len(opened.frame(7)) > 0


def test_what_cannot_be_given_is_one_line(place: Path) -> None:
    with codec.open_stream(place) as opened:
        for frame, layers in ((FRAMES, None), (-1, None), (0, 0), (0, 99)):
            assert "\n" not in str(refused(InvalidError, "", opened.frame, frame, layers))
        refused(InvalidError, "no camera is called 'x'", opened.camera, "x")
    refused(InvalidError, "closed", opened.frame, 0)
    with pytest.raises(InvalidError, match="closed"), opened:
        pass
    opened.close()


def test_what_is_not_a_stream_is_an_error_of_ours(tmp_path: Path) -> None:
    refused(CorruptError, "nowhere", codec.open_stream, str(tmp_path / "nowhere"))
    refused(codec.SwingsError, r"manifest\.json", codec.open_stream, tmp_path)
    refused(InvalidError, r"player\.Scene", codec.open_stream, "http://127.0.0.1:1/watch/x")
    refused(InvalidError, "ftp", codec.open_stream, "ftp://127.0.0.1/x")


def test_importing_codec_loads_nothing_else() -> None:
    code = (
        "import sys, codec\n"
        "loaded = [n for n in sys.modules if n.startswith(('codec.', 'numpy', 'numba'))]\n"
        "assert not loaded, loaded\n"
        "assert {'open_stream', 'SwingsError'} <= set(dir(codec))\n"
        "try:\n    codec.nothing\n"
        "except AttributeError as error:\n    assert 'nothing' in str(error)\n"
        "else:\n    raise SystemExit(1)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
