"""`import codec` opens a stream from a string and returns any frame as arrays."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import codec
from codec.errors import CorruptError, InvalidError
from codec.storage.openstorage import open_storage
from codec.stream import StreamReader, StreamWriter
from tests.support.drawn import same_splats
from tests.support.hostile import refused
from tests.support.slots.folder import write_slots
from tests.support.tiny_stream import append_tiny, tiny_manifest, write_tiny

FRAMES = 7


@pytest.fixture(params=[write_tiny, write_slots])
def stream(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    request.param(tmp_path / "stream", FRAMES)
    return tmp_path / "stream"


def test_three_lines_give_a_frame(stream: Path) -> None:
    opened = codec.open_stream(str(stream))
    splats = opened.frame(5)
    reader = StreamReader(stream)
    assert same_splats(splats, reader.active_splats(5, reader.manifest.num_layers))
    assert (len(opened), opened.fps) == (reader.num_frames, reader.manifest.fps)
    assert [c.name for c in opened.cameras] == [c.name for c in reader.manifest.cameras]
    assert opened.camera().name == reader.manifest.default_camera


def test_whatever_names_a_folder_opens_it(stream: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = codec.open_stream(stream).frame(0)
    monkeypatch.chdir(stream.parent)
    for place in ("stream", "./stream/", Path("stream"), open_storage(stream)):
        with codec.open_stream(place) as opened:
            assert same_splats(opened.frame(0), expected)


def test_fewer_layers_and_frames_in_any_order(stream: Path) -> None:
    reader = StreamReader(stream)
    with codec.open_stream(stream) as opened:
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


def test_what_cannot_be_given_is_one_line(stream: Path) -> None:
    with codec.open_stream(stream) as opened:
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
        "assert {'open_stream', 'SwingsError'} <= set(codec.__all__)\n"
        "try:\n    codec.nothing\n"
        "except AttributeError as error:\n    assert 'nothing' in str(error)\n"
        "else:\n    raise SystemExit(1)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
