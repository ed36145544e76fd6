"""Captures with a sound track: the samples of exactly the frames that are drawn."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest

from codec.errors import SwingsError
from codec.framerange import FrameRange
from codec.stream import StreamReader
from codec.stream.sound import SoundObject, SoundSource, first_sample
from player.config import CameraPathName, PlayConfig
from player.render.renderer import RendererKind
from player.run.playback import play
from player.show.sink import Sound, VideoSink
from player.sound.feed import gains_of
from player.view.path import Size
from tests.support.hosted_streams import ring_of_cameras, served, static_host, write_stream
from tests.support.sounding import add_clicks, best_shift, heard, track_of

CPU = RendererKind.CPU
SMALL = Size(32, 24)
FRAMES = FrameRange(3, 20)


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("root")
    write_stream(root / "s", 23)
    add_clicks(root / "s", (0, 4, 5, 10, 19, 22))
    return root


@pytest.fixture
def encoded(monkeypatch: pytest.MonkeyPatch) -> list[Sound]:
    """The samples that reach the encoder of a video, before AAC changes them."""
    pieces: list[Sound] = []
    monkeypatch.setattr(VideoSink, "write_sound", lambda _, samples: pieces.append(samples))
    return pieces


def test_a_track_is_that_of_the_frames(root: Path, tmp_path: Path, encoded: list[Sound]) -> None:
    whole = heard(root / "s")
    fps = StreamReader(root / "s").manifest.fps
    with served(root) as server, static_host(root) as host:
        for number, source in enumerate((str(root / "s"), f"{server.url}/watch/s", f"{host}/s")):
            out = tmp_path / f"{number}.mp4"
            encoded.clear()
            play(PlayConfig(source, out, frames=FRAMES, loop=2, renderer=CPU, size=SMALL))
            track = np.concatenate(encoded)
            begin, count = first_sample(3, fps), first_sample(17, fps)
            # A capture starts the decoder at its first frame's segment; it has converged by then.
            once = whole[begin : begin + count].astype(int)
            assert len(track) == first_sample(34, fps)
            assert np.abs(track[:count] - once).max() <= 400
            assert np.abs(track[count : 2 * count] - once).max() <= 400
            assert best_shift(whole[begin : begin + count], track[:count], 30) == 0
            with av.open(str(out)) as container:
                assert container.streams.video[0].frames == 34


def test_the_track_of_an_mp4_is_in_step_to_the_sample(root: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.mp4"
    play(PlayConfig(str(root / "s"), out, renderer=CPU, size=SMALL, volume=0.5))
    whole, track = heard(root / "s"), track_of(out)
    assert abs(len(track) - len(whole)) <= 1024  # AAC completes its last packet
    count = min(len(track), len(whole))
    assert best_shift(whole[:count], track[:count], 60) == 0
    loud = float(np.linalg.norm(track[:count].astype(float)) / np.linalg.norm(whole.astype(float)))
    assert loud == pytest.approx(0.5, rel=0.05)


def test_a_placed_source_is_heard_from_its_side_and_turns_without_a_step(
    tmp_path: Path, encoded: list[Sound]
) -> None:
    write_stream(tmp_path / "s", 20)
    add_clicks(tmp_path / "s", range(20), keys=((0.0, 2.0, 0.0, 4.0),))
    (source,) = StreamReader(tmp_path / "s").manifest.sound
    mono = heard(tmp_path / "s")[:, 0].astype(float)
    tracks = []
    for name in ("camera:c0", "camera:c3", "orbit"):
        config = PlayConfig(str(tmp_path / "s"), tmp_path / "o.mp4", renderer=CPU, size=SMALL)
        encoded.clear()
        play(replace(config, camera=CameraPathName(name)))
        tracks.append(np.concatenate(encoded).astype(float))
    for number, track in zip((0, 3), tracks, strict=False):
        gains = gains_of(source, 0.0, ring_of_cameras(4)[number])
        assert np.abs(track - mono[:, None] * np.array(gains)).max() <= 1
    loud = np.abs(mono) > 4000
    ratio = tracks[2][loud] / mono[loud, None]
    assert ratio.min() >= 0
    assert np.abs(np.diff(ratio, axis=0)).max() < 0.1  # values up to a frame apart
    assert np.ptp(ratio[:, 0]) > 0.1


def test_gains_are_of_equal_power_and_fall_with_distance() -> None:
    camera = ring_of_cameras(1)[0]  # at the origin, looking along z
    for angle in np.linspace(-math.pi, math.pi, 25):
        for distance_m in (0.5, 1.0, 4.0):
            place = distance_m * math.sin(angle), 0.0, distance_m * math.cos(angle)
            left, right = gains_of(SoundSource("a", 1, ((0.0, *place),)), 3.0, camera)
            assert math.hypot(left, right) == pytest.approx(1 / max(1.0, distance_m))
            assert (right - left) * math.sin(angle) >= -1e-9
    assert gains_of(SoundSource("a", 2), 0.0, camera) == (1.0, 1.0)


@pytest.mark.parametrize("damage", ["a bit", "the number of samples to skip"])
def test_a_bad_object_is_named_and_leaves_no_file(tmp_path: Path, damage: str) -> None:
    write_stream(tmp_path / "s", 12)
    add_clicks(tmp_path / "s", (2,))
    path = tmp_path / "s" / "segments" / "1" / "audio-main"
    data = path.read_bytes()
    skipping = replace(SoundObject.parse(data), pre_skip=65535).pack()
    path.write_bytes(data[:-1] + bytes([data[-1] ^ 1]) if damage == "a bit" else skipping)
    out = tmp_path / "out.mp4"
    with pytest.raises(SwingsError, match="segment 1, audio-main"):
        play(PlayConfig(str(tmp_path / "s"), out, renderer=CPU, size=SMALL))
    assert not out.exists()
