"""Movement in the synthetic scene: a figure walks in a circle and waves, and a ball bounces.

Everything is a function of the time, so any number of frames at any rate shows the same motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from .light import REACH_RADII
from .paint import BALL, FACE, JEANS, PLAIN, SHOE, STRIPES
from .scene import PartList
from .solid import FIRST, RADIUS, SECOND, Parts, Table

BALL_RADIUS_M = 0.15
BALL_COLOUR = "ef7d1f"

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


@dataclass(frozen=True, slots=True, eq=False)
class Moving:
    """The moving parts at one time."""

    parts: Parts
    groups: Table  # (G, 7), columns GROUP_FIRST and so on of solid.py


def moving_parts(time_s: float, seed: int, radius_m: float) -> Moving:
    """The figure, on a circle of that radius, and the ball at a time. The seed shifts where they
    start."""
    parts = PartList()
    start_m = 1.7 + 0.37 * (seed % 97)
    ends = _add_figure(parts, _WALK_M_PER_S * time_s + start_m, time_s, radius_m)
    _add_ball(parts, time_s, seed)
    built = parts.parts()
    bounds = pairwise([0, *ends, len(parts)])
    return Moving(built, np.array([_group(built, first, end) for first, end in bounds]))


def ball_place(time_s: float, seed: int) -> Table:
    """(3,) the ball's middle, metres: free fall between bounces 0.9 s apart."""
    phase = (time_s + 0.13 * (seed % 7)) / 0.9 % 1.0
    height = BALL_RADIUS_M + 4.0 * 0.99 * phase * (1.0 - phase)  # g t^2 / 8 = 0.99 m
    angle = -1.1 + 0.45 * time_s - 0.5 * seed
    return np.array([1.35 * np.cos(angle), -height, 0.1 + 1.35 * np.sin(angle)])


def _add_ball(parts: PartList, time_s: float, seed: int) -> None:
    spin = 3.1 * time_s
    c, s = np.cos(spin), np.sin(spin)
    tilt = np.array([[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    axes = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ tilt
    place = ball_place(time_s, seed)
    parts.add(BALL, BALL_COLOUR, place, BALL_RADIUS_M, axes=axes, second_colour="2a1a14")


def _add_figure(parts: PartList, walked_m: float, time_s: float, radius_m: float) -> list[int]:
    """Adds a person after `walked_m` along the circle; gives where each group of parts
    ends."""
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

    parts.add(STRIPES, "f4efe2", waist, 0.125, chest, 0.16, axes, "d8432f")
    shoulders = (chest + 0.09 * lean - 0.13 * chest_right, chest + 0.09 * lean + 0.13 * chest_right)
    parts.add(PLAIN, "d8432f", shoulders[0], 0.075, shoulders[1], 0.075)
    parts.add(PLAIN, "e8b48f", neck - 0.03 * lean, 0.055, head, 0.055)
    # A scarf with a tail that swings behind.
    parts.add(PLAIN, "f2b632", neck - 0.035 * lean, 0.088, neck - 0.01 * lean, 0.08)
    tail = neck - 0.05 * lean - 0.13 * forward + 0.05 * right
    drift = 0.05 * np.sin(beat) * right - (0.1 + 0.04 * np.cos(beat)) * forward
    parts.add(PLAIN, "f2b632", tail + 0.07 * forward, 0.04, tail - 0.24 * _UP + drift, 0.045)

    look = _unit(forward + 0.35 * np.sin(1.7 * time_s) * right)
    face = np.stack([np.cross(-_UP, look), _UP, look])
    parts.add(FACE, "e8b48f", head, 0.138, axes=face)
    parts.add(PLAIN, "dfa27c", head + 0.136 * look - 0.012 * _UP, 0.02)
    for side in (-1.0, 1.0):
        parts.add(PLAIN, "e0a37e", head + 0.136 * side * face[0] - 0.01 * _UP, 0.03)
    bun = head - 0.11 * look + 0.1 * _UP
    parts.add(PLAIN, "4b2a1d", bun, 0.062)

    ends = [len(parts)]

    # The left arm swings against the left leg, the right one waves.
    swing = 0.5 * np.sin(2 * np.pi * stride)
    upper = _unit(-_UP + swing * forward - 0.22 * chest_right)
    lower = _unit(-_UP + (swing + 0.45) * forward - 0.08 * chest_right)
    _add_arm(parts, shoulders[0] - 0.045 * chest_right, upper, lower)
    ends.append(len(parts))
    wave = 0.45 * np.sin(2 * np.pi * 1.4 * time_s)
    upper = _unit(chest_right + 0.25 * _UP + 0.15 * chest_forward)
    lower = _unit(np.cos(wave) * _UP + (np.sin(wave) + 0.15) * chest_right)
    _add_arm(parts, shoulders[1] + 0.045 * chest_right, upper, lower)
    ends.append(len(parts))

    parts.add(JEANS, "31507f", hips - 0.075 * right, 0.115, hips + 0.075 * right, 0.115)
    for side, offset in ((-1.0, 0.0), (1.0, 0.5)):
        hip = hips + side * 0.085 * right - 0.03 * _UP
        foot, pitch, heading = foot_place(stride + offset, offset, side, radius_m)
        ankle = foot + _ANKLE_M * _UP
        knee = _knee(hip, ankle, _THIGH_M, _SHIN_M, heading)
        parts.add(JEANS, "31507f", hip, 0.092, knee, 0.066)
        parts.add(JEANS, "31507f", knee, 0.065, ankle + 0.05 * _UP, 0.05)
        toe_to = np.cos(pitch) * heading - np.sin(pitch) * _UP
        sole = np.stack([np.cross(-_UP, toe_to), _UP, toe_to])
        heel = ankle - 0.03 * _UP - 0.04 * toe_to
        toe = heel + 0.17 * toe_to - 0.006 * _UP
        parts.add(SHOE, "c9372c", heel, 0.055, toe, 0.048, sole, "f4f1ea")
    ends.append(len(parts))
    return ends


def _path_place(walked_m: float, radius_m: float) -> tuple[Table, Table]:
    """(place, direction) on the floor after walking that far along the circle."""
    angle = walked_m / radius_m
    out = np.array([np.cos(angle), 0.0, np.sin(angle)])
    place = np.array([0.0, 0.0, 0.1]) + radius_m * out
    return place, np.array([-np.sin(angle), 0.0, np.cos(angle)])


def foot_place(
    cycle: float, offset: float, side: float, radius_m: float
) -> tuple[Table, float, Table]:
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


def _footfall(number: float, offset: float, side: float, radius_m: float) -> tuple[Table, Table]:
    place, heading = _path_place((number - offset + _STANCE / 2) * _STRIDE_M, radius_m)
    return place + side * 0.085 * np.cross(-_UP, heading), heading


def _add_arm(parts: PartList, shoulder: Table, upper: Table, lower: Table) -> None:
    elbow = shoulder + _UPPER_ARM_M * upper
    wrist = elbow + _FOREARM_M * lower
    parts.add(PLAIN, "d8432f", shoulder, 0.066, elbow, 0.052)
    parts.add(STRIPES, "d8432f", elbow, 0.052, wrist, 0.043, None, "f4efe2")
    parts.add(PLAIN, "e8b48f", wrist + 0.045 * lower, 0.05, wrist + 0.08 * lower, 0.04)


def _knee(hip: Table, ankle: Table, thigh_m: float, shin_m: float, front: Table) -> Table:
    """The knee between hip and ankle, as far from them as the two lengths say, and to the front."""
    axis = ankle - hip
    span = min(float(np.linalg.norm(axis)), 0.999 * (thigh_m + shin_m))
    axis = _unit(axis)
    along = (thigh_m**2 - shin_m**2 + span**2) / (2 * span)
    bend = _unit(front - (front @ axis) * axis)
    return hip + along * axis + float(np.sqrt(max(0.0, thigh_m**2 - along**2))) * bend


def _unit(v: Table) -> Table:
    return v / np.linalg.norm(v)


def _group(parts: Parts, first: int, end: int) -> tuple[float, ...]:
    """A row of `Moving.groups`."""
    cones = parts.cones[first:end]
    centres = np.concatenate([cones[:, at : at + RADIUS] for at in (FIRST, SECOND)])
    radii = np.concatenate([cones[:, at + RADIUS] for at in (FIRST, SECOND)])
    middle = (centres.min(axis=0) + centres.max(axis=0)) / 2
    radius = float((np.linalg.norm(centres - middle, axis=1) + radii).max())
    return (first, end, *middle, radius + 1e-3, (REACH_RADII - 1) * float(radii.max()))
