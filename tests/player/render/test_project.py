"""The camera in the form of the kernels."""

from __future__ import annotations

import numpy as np

from codec.camera import Camera
from player.render.project import (
    CAM_CX,
    CAM_CY,
    CAM_FX,
    CAM_FY,
    CAM_LIMIT_X,
    CAM_LIMIT_Y,
    CAM_NEAR,
    CAM_POSITION,
    CAM_ROTATION,
    CAM_TRANSLATION,
    camera_rotation,
    camera_vector,
    jacobian_limits,
)
from player.render.recipe import JACOBIAN_CLAMP


def test_the_camera_vector_has_everything_at_its_place() -> None:
    w2c = np.eye(4)
    w2c[:3, :3] = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    w2c[:3, 3] = (0.1, -0.2, 2.2)
    camera = Camera("c", 80, 60, 40.0, 43.0, 21.0, 20.0, w2c)
    vector = camera_vector(camera, 0.25)
    assert vector.dtype == np.float32
    assert vector.shape == (CAM_NEAR + 1,)
    np.testing.assert_array_equal(vector[CAM_ROTATION : CAM_ROTATION + 9], w2c[:3, :3].ravel())
    np.testing.assert_array_equal(camera_rotation(vector), w2c[:3, :3].ravel())
    np.testing.assert_allclose(vector[CAM_TRANSLATION : CAM_TRANSLATION + 3], w2c[:3, 3])
    np.testing.assert_allclose(vector[CAM_POSITION : CAM_POSITION + 3], camera.position)
    assert vector[[CAM_FX, CAM_FY, CAM_CX, CAM_CY]].tolist() == [40, 43, 21, 20]
    limits = jacobian_limits(camera)
    np.testing.assert_allclose(limits, [JACOBIAN_CLAMP * 40 / 40, JACOBIAN_CLAMP * 30 / 43])
    np.testing.assert_array_equal(vector[[CAM_LIMIT_X, CAM_LIMIT_Y]], np.array(limits, np.float32))
    assert vector[CAM_NEAR] == 0.25
