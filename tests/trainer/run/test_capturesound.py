"""Sound added to a stream during training is the same as sound added afterwards."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import av
import pytest

from codec.errors import SwingsError
from codec.storage import objectstore
from codec.stream import StreamReader
from codec.stream.sound import SAMPLE_RATE, SoundSource, first_sample
from codec.tools.audit import verify_stream
from codec.tracks.streamtracks import add_sound
from tests.support.sounding import best_shift, heard, track_of, write_clicks
from tests.support.stores.s3_server import BUCKET, s3_server
from tests.support.trainings import train_here
from trainer.capture.capture import Capture
from trainer.capture.layout import open_capture
from trainer.run.config import TrainConfig
from trainer.run.outputs import CaptureSound, capture_sound
from trainer.storedfiles import forget_stored

SETTINGS = (
    "--num-gs", 100, "--genesis-iterations", 10, "--settle-rounds", 0, "--window-iterations", 4,
    "--segment-frames", 2, "--snapshot-every", 0, "--frames", "2:6",
)  # fmt: skip


@pytest.fixture
def films(capture: Path, tmp_path: Path) -> Path:
    """The capture, of which one video has sound, as plain samples."""
    films = tmp_path / "films"
    shutil.copytree(capture, films)
    write_clicks(tmp_path / "a.wav", 20000, (4000, 6000, 8000))
    video, silent = films / "cam01.mp4", capture / "cam01.mp4"
    with (
        av.open(str(silent)) as pictures,
        av.open(str(tmp_path / "a.wav")) as samples,
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
    return films


def test_the_sound_of_a_file_is_that_of_the_frames(capture: Path, tmp_path: Path) -> None:
    write_clicks(tmp_path / "a.wav", 40000, (500, 3000, 5000, 8000))
    told, plain = tmp_path / "told", tmp_path / "plain"
    train_here(capture, told, *SETTINGS, "--audio", tmp_path / "a.wav")
    train_here(capture, plain, *SETTINGS)
    assert not StreamReader(plain).manifest.sound
    verify_stream(told)
    fps = StreamReader(told).manifest.fps
    offset_s = -first_sample(2, fps) / SAMPLE_RATE
    add_sound(plain, tmp_path / "a.wav", SoundSource("main", 2), offset_s=offset_s)
    for name in ("manifest.json", *(f"segments/{n}/audio-main" for n in range(2))):
        assert (told / name).read_bytes() == (plain / name).read_bytes()
    assert len(heard(told)) == first_sample(4, fps)


def test_a_video_gives_its_sound(films: Path, tmp_path: Path) -> None:
    train_here(films, tmp_path / "s", *SETTINGS)
    fps = StreamReader(tmp_path / "s").manifest.fps
    whole = track_of(tmp_path / "a.wav")[first_sample(2, fps) :]
    found = heard(tmp_path / "s")
    count = min(len(whole), len(found))
    assert best_shift(whole[:count], found[:count], 40) == 0


def sound_of(capture: Capture, **options: Any) -> CaptureSound | None:
    config = TrainConfig(capture.root, capture.root / "unused", **options)
    return capture_sound(config, capture, range(2, 6), lambda: 30.0)


def test_a_video_in_an_object_store_gives_its_sound(
    films: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(objectstore, "PATIENT", objectstore.BRIEF)
    url, here = f"s3://{BUCKET}/films", sound_of(open_capture(films))
    assert here is not None
    assert sound_of(open_capture(films), silent=True) is None
    with s3_server() as server:
        server.upload(films, "films")
        stored = open_capture(url)
        assert sound_of(stored) == here
        server.delete("films/cam01.mp4")
        assert sound_of(stored) is None
        assert f"the sound of a video is left out: {url}/cam01.mp4" in caplog.text
        forget_stored()


def test_a_bad_file_is_named_and_leaves_no_stream(capture: Path, tmp_path: Path) -> None:
    (tmp_path / "bad.wav").write_bytes(b"no sound")
    for name, says in (("none.wav", "is not a file"), ("bad.wav", "cannot be read")):
        with pytest.raises(SwingsError, match=f"{name}.*{says}"):
            train_here(capture, tmp_path / "s", *SETTINGS, "--audio", tmp_path / name)
        assert not (tmp_path / "s" / "manifest.json").exists()
