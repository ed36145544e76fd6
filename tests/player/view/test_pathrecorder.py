"""A recorded path, read again, shows the user's views with few key frames."""

from __future__ import annotations

import json
import math
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.camera import Camera
from codec.framerange import FrameRange
from codec.pose import Doubles, rotation_about, world_to_camera
from codec.rig import mean_up
from player.view import pathrecorder
from player.view.keyframes import MAX_FILE_BYTES, read_keyframes
from player.view.path import CameraPath, camera_path, orbit, scene_centre, turned
from player.view.pathrecorder import MAX_FRAMES, PathRecorder, _Poses, moved_px
from tests.support.drawn import directions, places, rotations
from tests.support.hosted_streams import small_manifest

MANIFEST = small_manifest()
BASE = MANIFEST.camera()
CENTRE = scene_centre(MANIFEST)
UP = mean_up(MANIFEST.cameras)


def reread(recorder: PathRecorder, tolerance_px: float) -> CameraPath:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "path.json"
        path.write_bytes(recorder.to_json(tolerance_px))
        return read_keyframes(path, BASE, UP)


@st.composite
def walks(draw: st.DrawFn) -> list[tuple[int, Camera]]:
    """Ascending frames with cameras that a user moves: jumps, rests, turns and zooms."""
    rng = np.random.default_rng(draw(st.integers(0, 1 << 32)))
    count, rough = draw(st.integers(1, 60)), draw(st.sampled_from((0.0, 0.003, 0.3, 3.0)))
    frames = np.cumsum(rng.integers(1, 4, count))
    position, rotation = draw(places), draw(rotations)
    step, axis = draw(places) * 0.002, draw(directions)
    fy_px, turn_rad = 60.0, draw(st.floats(-0.3, 0.3))
    walk = []
    for frame in frames:
        position = position + step + rough * rng.normal(size=3)
        turn = rotation_about(axis, turn_rad + rough * rng.normal())
        rotation = rotation @ turn
        fy_px = float(np.clip(fy_px * math.exp(rough * rng.normal()), 1, 1000))
        camera = replace(BASE, fx_px=fy_px, fy_px=fy_px, w2c=world_to_camera(rotation, position))
        walk.append((int(frame), camera))
    return walk


@settings(deadline=None, max_examples=40)
@given(walks(), st.sampled_from((0.01, 0.5, 20.0)))
def test_every_recorded_frame_shows_again_within_the_tolerance(
    walk: list[tuple[int, Camera]], tolerance_px: float
) -> None:
    recorder = PathRecorder(CENTRE)
    for frame, camera in walk:
        assert recorder.add(frame, camera)
    path = reread(recorder, tolerance_px)
    for frame, camera in walk:
        assert moved_px(path(frame), camera, CENTRE) <= tolerance_px + 1e-4
        assert path(frame).fx_px == pytest.approx(camera.fx_px, rel=tolerance_px)
    kept = [frame for frame, _ in recorder.keyframes(tolerance_px)]
    assert kept == sorted(set(kept))
    assert {walk[0][0], walk[-1][0]} <= set(kept) <= {frame for frame, _ in walk}


@given(rotations, places, places, directions, st.floats(-2.5, 2.5))
def test_what_moves_evenly_takes_two_key_frames(
    rotation: Doubles, start: Doubles, way: Doubles, axis: Doubles, turn_rad: float
) -> None:
    recorder = PathRecorder(CENTRE)
    for frame in range(100):
        share = frame / 99
        pose = world_to_camera(
            rotation @ rotation_about(axis, turn_rad * share), start + way * share
        )
        recorder.add(frame, replace(BASE, w2c=pose))
    assert [frame for frame, _ in recorder.keyframes(0.01)] == [0, 99]


def test_an_orbit_is_thinned_and_stays_where_it_was() -> None:
    path, recorder = orbit(MANIFEST, BASE, FrameRange(0, 300), 2 * math.pi), PathRecorder(CENTRE)
    for frame in range(300):
        recorder.add(frame, path(frame))
    counts = [len(recorder.keyframes(tolerance)) for tolerance in (0.05, 0.5, 5.0)]
    assert 10 < counts[1] < 60
    assert counts == sorted(counts, reverse=True)
    again = reread(recorder, 0.5)
    corners = np.array([CENTRE, CENTRE + UP, CENTRE - 0.5 * UP])
    for frame in range(300):
        for seen, expected in zip(
            again(frame).project(corners), path(frame).project(corners), strict=True
        ):
            # Places in pixels, and depths in metres.
            np.testing.assert_allclose(seen, expected, atol=1.5)


def test_moves_are_measured_as_the_picture_moves() -> None:
    """The centre, seen by the moved camera, shifts by about the reported distance."""
    small = 0.01
    right = replace(BASE, w2c=world_to_camera(BASE.w2c[:3, :3], BASE.position + small * BASE.right))
    about = turned(BASE, BASE.position, BASE.down, small)
    for moved in (right, about):
        u_px, v_px, _ = moved.project(CENTRE)
        u0_px, v0_px, _ = BASE.project(CENTRE)
        seen_px = math.hypot(float(u_px - u0_px), float(v_px - v0_px))
        assert moved_px(moved, BASE, CENTRE) == pytest.approx(seen_px, rel=0.02)
    zoomed = replace(BASE, fx_px=BASE.fx_px * 1.01, fy_px=BASE.fy_px * 1.01)
    assert moved_px(zoomed, BASE, CENTRE) == pytest.approx(0.01 * BASE.height_px / 2)
    assert moved_px(BASE, BASE, CENTRE) == pytest.approx(0, abs=1e-6)


def test_a_frame_that_shows_again_is_recorded_anew() -> None:
    recorder = PathRecorder(CENTRE)
    cameras = [turned(BASE, CENTRE, UP, n) for n in range(3)]
    for frame, camera in ((5, 0), (6, 0), (5, 1), (5, 2)):
        recorder.add(frame, cameras[camera])
    assert len(recorder) == 2
    assert [(frame, camera is cameras[2]) for frame, camera in recorder.keyframes()] == [
        (5, True),
        (6, False),
    ]
    recorder.clear()
    assert (len(recorder), recorder.keyframes()) == (0, [])


def test_the_file_is_a_path_of_the_command(tmp_path: Path) -> None:
    path, recorder = tmp_path / "p.json", PathRecorder(CENTRE)
    start = turned(BASE, CENTRE, UP, 0.7)
    recorder.add(3, start)
    recorder.add(9, BASE)
    path.write_bytes(recorder.to_json())
    assert [entry["frame"] for entry in json.loads(path.read_text())] == [3, 9]
    read = camera_path(str(path), MANIFEST, None, FrameRange(0, 20))
    np.testing.assert_allclose(read(0).w2c, start.w2c, atol=1e-9)
    np.testing.assert_allclose(read(12).w2c, BASE.w2c, atol=1e-9)


def test_a_long_recording_has_an_end_and_can_be_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """The worst case for thinning: a camera that shakes all the time."""
    most, seen = 1500, list[int]()
    monkeypatch.setattr(pathrecorder, "MAX_FRAMES", most)
    between_px = _Poses.between_px

    def noted(poses: _Poses, frames: Doubles, first: int, last: int) -> Doubles:
        seen.append(last - first)
        return between_px(poses, frames, first, last)

    monkeypatch.setattr(_Poses, "between_px", noted)
    recorder, rng = PathRecorder(CENTRE), np.random.default_rng(0)
    for frame in range(most):
        assert recorder.add(frame, turned(BASE, CENTRE, UP, rng.normal()))
    assert not recorder.add(most, BASE)
    assert recorder.add(7, BASE)
    data = recorder.to_json()
    assert sum(seen) < 40 * most  # grows little faster than the recording
    assert len(recorder.keyframes()) > 0.9 * most
    assert len(data) / most * MAX_FRAMES < MAX_FILE_BYTES
