"""Mathematics of rotations, quaternions and poses."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from codec.errors import InvalidError
from codec.pose import (
    Doubles,
    look_at,
    quat_of,
    rotation_about,
    rotation_of,
    slerp,
    world_to_camera,
)
from tests.support.drawn import directions, places, rotations, turns_rad


@given(directions, turns_rad)
def test_quaternions_and_rotations_are_the_same(axis: Doubles, angle_rad: float) -> None:
    rotation = rotation_about(axis, angle_rad)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)
    np.testing.assert_allclose(rotation_of(quat_of(rotation)), rotation, atol=1e-9)


@given(directions, turns_rad)
def test_quaternions_turn_by_twice_their_angle(axis: Doubles, angle_rad: float) -> None:
    quat = np.array([math.cos(angle_rad / 2), *(math.sin(angle_rad / 2) * axis)])
    np.testing.assert_allclose(rotation_of(quat), rotation_about(axis, angle_rad), atol=1e-12)
    # A quarter turn about z takes x to y.
    quarter = rotation_about(np.array([0.0, 0, 1]), math.pi / 2)
    np.testing.assert_allclose(quarter @ [1, 0, 0], [0, 1, 0], atol=1e-12)


@given(directions, st.floats(-3, 3), st.floats(0, 1))
def test_slerp_turns_evenly(axis: Doubles, angle_rad: float, share: float) -> None:
    first, last = np.eye(3), rotation_about(axis, angle_rad)
    between = rotation_of(slerp(quat_of(first), quat_of(last), share))
    np.testing.assert_allclose(between, rotation_about(axis, share * angle_rad), atol=1e-6)


@given(rotations, places)
def test_a_pose_takes_its_place_to_0(rotation: Doubles, position: Doubles) -> None:
    w2c = world_to_camera(rotation, position)
    np.testing.assert_allclose(w2c @ [*position, 1], [0, 0, 0, 1], atol=1e-12)
    for axis, expected in zip(rotation, np.eye(3), strict=True):
        np.testing.assert_allclose(w2c[:3, :3] @ axis, expected, atol=1e-12)


def test_look_at_is_the_pose_of_opencv() -> None:
    np.testing.assert_allclose(
        look_at(np.zeros(3), np.array([0.0, 0, 1]), np.array([0.0, -1, 0])), np.eye(4), atol=1e-12
    )
    with pytest.raises(InvalidError):
        look_at(np.zeros(3), np.array([0.0, 1, 0]), np.array([0.0, -1, 0]))
    with pytest.raises(InvalidError):
        look_at(np.ones(3), np.ones(3), np.array([0.0, -1, 0]))


@given(places, directions, st.floats(0.01, 100), directions, st.floats(1e-3, 1e3))
def test_look_at_puts_the_target_on_the_axis_and_up_upwards(
    position: Doubles, direction: Doubles, distance_m: float, up: Doubles, length: float
) -> None:
    assume(np.linalg.norm(np.cross(direction, up)) > 1e-3)
    w2c = look_at(position, position + distance_m * direction, length * up)
    np.testing.assert_allclose(w2c[:3, :3] @ w2c[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(w2c) == pytest.approx(1)
    np.testing.assert_allclose(w2c[:3, :3] @ position + w2c[:3, 3], np.zeros(3), atol=1e-10)
    target = w2c[:3, :3] @ (position + distance_m * direction) + w2c[:3, 3]
    np.testing.assert_allclose(target, [0, 0, distance_m], atol=1e-8)
    right, down, _ = w2c[:3, :3] @ up
    assert right == pytest.approx(0, abs=1e-8)
    assert down < 0
