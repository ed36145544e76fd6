"""Sound added to a stream during training is the same as sound added afterwards."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from codec.storage import objectstore
from codec.stream import StreamReader
from codec.stream.sound import SAMPLE_RATE, SoundSource, first_sample
from codec.tools.audit import verify_stream
from codec.tools.streamsound import add_sound
from tests.support.commands import run, run_ok
from tests.support.sounding import best_shift, heard, write_clicks
from tests.support.stores.s3_server import BUCKET, s3_server
from tests.support.tiny_capture import write_dynerf
from trainer.capture.capture import Capture
from trainer.capture.layout import open_capture
from trainer.run.capturesound import CaptureSound, capture_sound
from trainer.run.config import TrainConfig
from trainer.storedfiles import forget_stored

SETTINGS = (
    "--num-gs", 100, "--genesis-iterations", 10, "--settle-rounds", 0, "--window-iterations", 4,
    "--segment-frames", 2, "--snapshot-every", 0, "--frames", "2:8",
)  # fmt: skip
NUM_FRAMES = 8


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("capture") / "c"
    write_dynerf(path, 4, NUM_FRAMES)
    return path


def with_sound(video: Path, sound: Path) -> None:
    """Adds the sound of a WAV file to `video`, as plain samples."""
    silent = video.with_suffix(".silent.mp4")
    video.rename(silent)
    with (
        av.open(str(silent)) as pictures,
        av.open(str(sound)) as samples,
        av.open(str(video), "w") as out,
    ):
        film = out.add_stream_from_template(pictures.streams.video[0])
        track: Any = out.add_stream("flac", rate=SAMPLE_RATE, layout="stereo")
        for packet in pictures.demux(video=0):
            if packet.dts is not None:
                packet.stream = film
                out.mux(packet)
        for frame in samples.decode(audio=0):
            out.mux(track.encode(frame))
        out.mux(track.encode(None))
    silent.unlink()


def test_the_sound_of_a_file_is_that_of_the_frames(capture: Path, tmp_path: Path) -> None:
    write_clicks(tmp_path / "a.wav", 40000, (500, 3000, 9000, 12000))
    told, plain = tmp_path / "told", tmp_path / "plain"
    run_ok("swings-train", capture, told, *SETTINGS, "--audio", tmp_path / "a.wav")
    run_ok("swings-train", capture, plain, *SETTINGS)
    assert not StreamReader(plain).manifest.sound
    verify_stream(told)
    fps = StreamReader(told).manifest.fps
    offset_s = -first_sample(2, fps) / SAMPLE_RATE
    add_sound(plain, tmp_path / "a.wav", SoundSource("main", 2), offset_s=offset_s)
    for name in ("manifest.json", *(f"segments/{n}/audio-main" for n in range(3))):
        assert (told / name).read_bytes() == (plain / name).read_bytes()
    assert len(heard(told)) == first_sample(6, fps)


def test_a_video_gives_its_sound_unless_it_is_to_be_silent(capture: Path, tmp_path: Path) -> None:
    films = tmp_path / "films"
    shutil.copytree(capture, films)
    write_clicks(tmp_path / "a.wav", 20000, (4000, 9000, 12000))
    with_sound(films / "cam01.mp4", tmp_path / "a.wav")
    run_ok("swings-train", films, tmp_path / "s", *SETTINGS)
    fps = StreamReader(tmp_path / "s").manifest.fps
    with av.open(str(tmp_path / "a.wav")) as container:
        pieces = [frame.to_ndarray().reshape(-1, 2) for frame in container.decode(audio=0)]
    whole = np.concatenate(pieces)[first_sample(2, fps) :].astype(np.int16)
    found = heard(tmp_path / "s")
    count = min(len(whole), len(found))
    assert best_shift(whole[:count], found[:count], 40) == 0
    run_ok("swings-train", films, tmp_path / "silent", *SETTINGS, "--silent")
    assert not StreamReader(tmp_path / "silent").manifest.sound


def test_a_video_in_an_object_store_gives_its_sound(
    capture: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(objectstore, "PATIENT", objectstore.BRIEF)
    films, url = tmp_path / "films", f"s3://{BUCKET}/films"
    shutil.copytree(capture, films)
    write_clicks(tmp_path / "a.wav", 20000, (4000, 9000, 12000))
    with_sound(films / "cam01.mp4", tmp_path / "a.wav")

    def sound_of(opened: Capture) -> CaptureSound | None:
        config = TrainConfig(films, tmp_path / "s")
        return capture_sound(config, opened, range(2, NUM_FRAMES), lambda: 30.0)

    here = sound_of(open_capture(films))
    assert here is not None
    with s3_server() as server:
        server.upload(films, "films")
        stored = open_capture(url)
        assert sound_of(stored) == here
        server.delete("films/cam01.mp4")
        assert sound_of(stored) is None
        assert f"the sound of a video is left out: {url}/cam01.mp4" in caplog.text
        forget_stored()


@pytest.mark.parametrize(
    ("content", "says"), [(None, "is not a file"), (b"no sound", "cannot be read")]
)
def test_a_bad_file_is_one_line_and_no_stream(
    capture: Path, tmp_path: Path, content: bytes | None, says: str
) -> None:
    if content is not None:
        (tmp_path / "bad.wav").write_bytes(content)
    audio = ("--audio", tmp_path / "bad.wav")
    done = run("swings-train", capture, tmp_path / "s", *SETTINGS, *audio)
    assert done.returncode == 1
    assert "bad.wav" in done.stderr
    assert says in done.stderr
    assert len(done.stderr.splitlines()) == 1, done.stderr
    assert not (tmp_path / "s" / "manifest.json").exists()


def test_options_that_contradict_are_refused(capture: Path, tmp_path: Path) -> None:
    audio = ("--audio", tmp_path / "a.wav", "--silent")
    done = run("swings-train", capture, tmp_path / "s", *SETTINGS, *audio)
    assert done.returncode != 0
    assert "--silent" in done.stderr
