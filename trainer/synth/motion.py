"""Movement in the synthetic scene: a figure walks in a circle and waves, and a ball bounces.

Everything is a function of the time, so any number of frames at any rate shows the same motion.
"""

from __future__ import annotations

import numpy as np

from codec.arrays import Doubles

from . import paint
from .surfels import Cone, cone, upright

BALL_RADIUS_M = 0.15

WALK_RADIUS_M = 0.72
"""Radius of the circle that the figure walks, unless another is chosen."""

_UP = np.array([0.0, -1.0, 0.0])
_WALK_M_PER_S = 0.85
_STRIDE_M = 1.0
"""How far the body moves while each foot takes one step."""
_STANCE = 0.6
"""Share of a stride for which a foot stays on the floor."""
_THIGH_M, _SHIN_M, _ANKLE_M = 0.43, 0.41, 0.085
_UPPER_ARM_M, _FOREARM_M = 0.29, 0.25


def moving_cones(time_s: float, seed: int, radius_m: float) -> list[Cone]:
    """The figure, on a circle of that radius, and last the ball at a time. The seed shifts where
    they start."""
    cones: list[Cone] = []
    start_m = 1.7 + 0.37 * (seed % 97)
    _add_figure(cones, _WALK_M_PER_S * time_s + start_m, time_s, radius_m)
    c, s = np.cos(3.1 * time_s), np.sin(3.1 * time_s)
    tilt = np.array([[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    spin = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ tilt
    cones.append(cone(paint.ball, ball_place(time_s, seed), BALL_RADIUS_M, axes=spin))
    return cones


def ball_place(time_s: float, seed: int) -> Doubles:
    """(3,) the ball's middle, metres: free fall between bounces 0.9 s apart."""
    phase = (time_s + 0.13 * (seed % 7)) / 0.9 % 1.0
    height = BALL_RADIUS_M + 4.0 * 0.99 * phase * (1.0 - phase)  # g t^2 / 8 = 0.99 m
    angle = -1.1 + 0.45 * time_s - 0.5 * seed
    return np.array([1.35 * np.cos(angle), -height, 0.1 + 1.35 * np.sin(angle)])


def _add_figure(cones: list[Cone], walked_m: float, time_s: float, radius_m: float) -> None:
    """Adds a person after `walked_m` along the circle."""
    root, forward = _path_place(walked_m, radius_m)
    right = np.cross(-_UP, forward)
    stride = walked_m / _STRIDE_M
    beat = 4 * np.pi * stride  # twice a stride: once a step
    hips = root + (0.897 + 0.018 * np.cos(beat - 1.2 * np.pi)) * _UP
    sway = 0.025 * np.sin(2 * np.pi * stride)
    hips = hips + sway * right
    twist = 0.16 * np.sin(2 * np.pi * stride)
    chest_right = np.cos(twist) * right + np.sin(twist) * forward
    chest_forward = np.cross(chest_right, -_UP)
    lean = _unit(_UP + 0.07 * forward)
    waist, chest = hips + 0.1 * lean, hips + 0.38 * lean
    neck, head = hips + 0.55 * lean, hips + 0.73 * lean + 0.02 * forward
    axes = np.stack([right, _UP, forward])

    cones.append(cone(paint.stripes("f4efe2", "d8432f"), waist, 0.125, chest, 0.16, axes))
    shoulders = (chest + 0.09 * lean - 0.13 * chest_right, chest + 0.09 * lean + 0.13 * chest_right)
    cones.append(cone("d8432f", shoulders[0], 0.075, shoulders[1], 0.075))
    cones.append(cone("e8b48f", neck - 0.03 * lean, 0.055, head, 0.055))
    # A scarf with a tail that swings behind.
    cones.append(cone("f2b632", neck - 0.035 * lean, 0.088, neck - 0.01 * lean, 0.08))
    tail = neck - 0.05 * lean - 0.13 * forward + 0.05 * right
    drift = 0.05 * np.sin(beat) * right - (0.1 + 0.04 * np.cos(beat)) * forward
    cones.append(cone("f2b632", tail + 0.07 * forward, 0.04, tail - 0.24 * _UP + drift, 0.045))

    look = _unit(forward + 0.35 * np.sin(1.7 * time_s) * right)
    face = upright(look)
    cones.append(cone(paint.face, head, 0.138, axes=face))
    cones.append(cone("dfa27c", head + 0.136 * look - 0.012 * _UP, 0.02))
    for side in (-1.0, 1.0):
        cones.append(cone("e0a37e", head + 0.136 * side * face[0] - 0.01 * _UP, 0.03))
    bun = head - 0.11 * look + 0.1 * _UP
    cones.append(cone("4b2a1d", bun, 0.062))

    # The left arm swings against the left leg, the right one waves.
    swing = 0.5 * np.sin(2 * np.pi * stride)
    upper = _unit(-_UP + swing * forward - 0.22 * chest_right)
    lower = _unit(-_UP + (swing + 0.45) * forward - 0.08 * chest_right)
    _add_arm(cones, shoulders[0] - 0.045 * chest_right, upper, lower)
    wave = 0.45 * np.sin(2 * np.pi * 1.4 * time_s)
    upper = _unit(chest_right + 0.25 * _UP + 0.15 * chest_forward)
    lower = _unit(np.cos(wave) * _UP + (np.sin(wave) + 0.15) * chest_right)
    _add_arm(cones, shoulders[1] + 0.045 * chest_right, upper, lower)

    jeans = paint.even("31507f", 0.22)
    cones.append(cone(jeans, hips - 0.075 * right, 0.115, hips + 0.075 * right, 0.115))
    for side, offset in ((-1.0, 0.0), (1.0, 0.5)):
        hip = hips + side * 0.085 * right - 0.03 * _UP
        foot, pitch, heading = foot_place(stride + offset, offset, side, radius_m)
        ankle = foot + _ANKLE_M * _UP
        knee = _knee(hip, ankle, _THIGH_M, _SHIN_M, heading)
        cones.append(cone(jeans, hip, 0.092, knee, 0.066))
        cones.append(cone(jeans, knee, 0.065, ankle + 0.05 * _UP, 0.05))
        toe_to = np.cos(pitch) * heading - np.sin(pitch) * _UP
        sole = upright(toe_to)
        heel = ankle - 0.03 * _UP - 0.04 * toe_to
        toe = heel + 0.17 * toe_to - 0.006 * _UP
        cones.append(cone(paint.shoe, heel, 0.055, toe, 0.048, sole))


def _path_place(walked_m: float, radius_m: float) -> tuple[Doubles, Doubles]:
    """(place, direction) on the floor after walking that far along the circle."""
    angle = walked_m / radius_m
    out = np.array([np.cos(angle), 0.0, np.sin(angle)])
    place = np.array([0.0, 0.0, 0.1]) + radius_m * out
    return place, np.array([-np.sin(angle), 0.0, np.cos(angle)])


def foot_place(
    cycle: float, offset: float, side: float, radius_m: float
) -> tuple[Doubles, float, Doubles]:
    """(place on or above the floor, pitch of the toes down in radians, heading) of a foot.

    A foot stands still for the first part of its cycle, below where the body passes in the middle
    of that part, and then flies to its next place.
    """
    number = np.floor(cycle)
    phase = float(cycle - number)
    here, heading_here = _footfall(number, offset, side, radius_m)
    if phase < _STANCE:
        roll = max(0.0, phase - 0.8 * _STANCE) / (0.2 * _STANCE)
        return here + 0.03 * roll * _UP, 0.35 * roll, heading_here
    there, heading_there = _footfall(number + 1, offset, side, radius_m)
    t = (phase - _STANCE) / (1 - _STANCE)
    ease = t * t * (3 - 2 * t)
    lift = 0.03 * (1 - t) ** 2 + 0.11 * np.sin(np.pi * t)
    pitch = 0.35 * (1 - t) + 0.5 * np.sin(np.pi * t) * (1 - 1.6 * t)
    heading = _unit((1 - ease) * heading_here + ease * heading_there)
    return here + ease * (there - here) + lift * _UP, float(pitch), heading


def _footfall(
    number: float, offset: float, side: float, radius_m: float
) -> tuple[Doubles, Doubles]:
    place, heading = _path_place((number - offset + _STANCE / 2) * _STRIDE_M, radius_m)
    return place + side * 0.085 * np.cross(-_UP, heading), heading


def _add_arm(cones: list[Cone], shoulder: Doubles, upper: Doubles, lower: Doubles) -> None:
    elbow = shoulder + _UPPER_ARM_M * upper
    wrist = elbow + _FOREARM_M * lower
    cones.append(cone("d8432f", shoulder, 0.066, elbow, 0.052))
    cones.append(cone(paint.stripes("d8432f", "f4efe2"), elbow, 0.052, wrist, 0.043))
    cones.append(cone("e8b48f", wrist + 0.045 * lower, 0.05, wrist + 0.08 * lower, 0.04))


def _knee(hip: Doubles, ankle: Doubles, thigh_m: float, shin_m: float, front: Doubles) -> Doubles:
    """The knee between hip and ankle, as far from them as the two lengths say, and to the front."""
    axis = ankle - hip
    span = min(float(np.linalg.norm(axis)), 0.999 * (thigh_m + shin_m))
    axis = _unit(axis)
    along = (thigh_m**2 - shin_m**2 + span**2) / (2 * span)
    bend = _unit(front - (front @ axis) * axis)
    return hip + along * axis + float(np.sqrt(max(0.0, thigh_m**2 - along**2))) * bend


def _unit(v: Doubles) -> Doubles:
    return v / np.linalg.norm(v)
