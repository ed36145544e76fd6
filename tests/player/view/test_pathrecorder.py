"""A recorded path, read again, shows the user's views with few key frames."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from codec.framerange import FrameRange
from player.view.path import camera_path, orbit, scene_centre
from player.view.pathrecorder import PathRecorder, moved_px
from tests.support.hosted_streams import small_manifest

MANIFEST = small_manifest()


def test_a_recorded_walk_is_thinned_and_shows_again_within_the_tolerance(tmp_path: Path) -> None:
    frames, centre, rng = FrameRange(0, 300), scene_centre(MANIFEST), np.random.default_rng(0)
    path, file = orbit(MANIFEST, MANIFEST.camera(), frames, 2 * math.pi), tmp_path / "p.json"
    for tolerance_px, most, rough in ((0.5, 60, 0.0), (5.0, 30, 0.0), (0.5, 301, 0.3)):
        recorder = PathRecorder(centre)
        zooms = np.exp(np.cumsum(rough * rng.normal(size=300)) + np.linspace(0, 1, 300))
        cameras = [path(n) for n in range(300)]
        walk = [
            replace(c, fx_px=c.fx_px * z, fy_px=c.fy_px * z)
            for c, z in zip(cameras, zooms, strict=True)
        ]
        for frame, camera in [(0, walk[99]), *enumerate(walk)]:  # frame 0 is recorded anew
            assert recorder.add(frame, camera)
        file.write_bytes(recorder.to_json(tolerance_px))
        assert 2 < len(recorder.keyframes(tolerance_px)) < most
        again = camera_path(str(file), MANIFEST, None, frames)
        worst_px = max(moved_px(again(frame), walk[frame], centre) for frame in range(300))
        assert worst_px <= tolerance_px + 1e-4
