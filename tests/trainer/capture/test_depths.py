"""Place and depth of the scene, estimated from the cameras of a capture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from codec.camera import Camera
from codec.pose import look_at
from codec.rig import rig_centre, rig_depths
from tests.support.tiny_capture import tiny_rig
from trainer.synth.scene import CAMERA_RADIUS_M, CAMERA_TARGET


def test_rig_depths_of_an_inward_rig() -> None:
    cameras = tiny_rig(9)
    centre = rig_centre(cameras)
    assert centre is not None
    assert np.allclose(centre, CAMERA_TARGET, atol=1e-9)
    depths = rig_depths(cameras, (0.1, 99.0))
    assert depths is not None
    distances = [float(np.linalg.norm(c.position - centre)) for c in cameras]
    assert depths[0] == pytest.approx(0.35 * min(distances))
    assert depths[1] >= 2 * max(distances) - 1e-9
    assert depths[1] >= 1.2 * 2 * CAMERA_RADIUS_M * np.sin(np.radians(79))


def test_rig_depths_of_a_forward_facing_rig() -> None:
    cameras = tiny_rig(6, arc_deg=20)
    assert rig_centre(cameras) is None
    assert rig_depths(cameras, (1.2, 34.0)) == (1.2, 34.0)
    assert rig_depths(cameras) is None
    assert rig_depths([]) is None
    assert rig_depths(cameras[:1]) is None


def test_a_rig_of_which_a_camera_looks_away_has_no_centre() -> None:
    cameras = tiny_rig(9)
    around = np.diag([-1.0, 1.0, -1.0, 1.0])
    assert rig_centre([*cameras[:8], replace(cameras[8], w2c=around @ cameras[8].w2c)]) is None


def test_cameras_that_face_each_other_along_one_line_have_no_centre() -> None:
    def camera(x_m: float, z_m: float) -> Camera:
        pose = look_at(np.array([x_m, 0, z_m]), np.zeros(3), np.array([0.0, -1, 0]))
        return Camera("c", 64, 36, 50.0, 50.0, 32.0, 18.0, pose)

    assert rig_centre([camera(0, -3), camera(0, 3)]) is None
    off_line = rig_centre([camera(0, -3), camera(0, 3), camera(0.1, 3)])
    assert off_line is not None
    np.testing.assert_allclose(off_line, np.zeros(3), atol=1e-9)
