"""The synthetic scene: a room and its furniture, the cameras, a figure that walks in a circle and
waves, and a ball that bounces.

Everything is a function of the time, so any number of frames at any rate shows the same motion. The
world's y points down and the floor is y = 0, so a height of h metres is y = -h.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from codec.arrays import Doubles, Floats
from codec.camera import Camera, look_at
from codec.splats import Splats

from . import surfels as paint
from .surfels import (
    LAMP_AT,
    LAMP_RADIUS_M,
    REACH_RADII,
    Cone,
    Surfels,
    cone,
    cone_surfels,
    light_of,
    past_cones,
    rectangle,
    upright,
)

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


HALF_M, HEIGHT_M = 3.75, 3.1
"""Half the width of the square room, and its height, metres."""

CAMERA_RADIUS_M = 3.2
"""Horizontal distance of the cameras from the middle of the room."""
CAMERA_HEIGHTS_M = (1.05, 2.05)
"""Taken in turn along the arc."""
CAMERA_TARGET = np.array([0.0, -1.0, 0.15])
"""The point that every camera looks at, metres."""
UP = np.array([0.0, -1.0, 0.0])
FIELD_OF_VIEW_RAD = np.radians(74.0)
"""Horizontal."""

GLOW = np.array([3.0, 2.75, 2.3])
"""The light of the lamp's own surface."""
CELL_M = 0.25
"""Side of the cells of the room that are looked at together for what moves near them."""
MOVING_SPACING = 0.85
"""Distance of the surfels of what moves, which has finer details, in those of the room."""
INSET = 1.2
"""How much thinner round things are made, in distances of surfels: discs at an edge reach beyond
it."""
SEEN = 0.98
"""Share of its light above which a surface is as bright as without what moves."""

X, Y, Z = np.eye(3)
Vector = tuple[float, float, float]

FURNITURE: tuple[tuple[str | paint.Flat, Vector, Vector, float], ...] = (
    ("7a5132", (2.1, 1.0, 3.5), (1.5, 2.0, 0.42), 0.0),  # the shelf
    # The sofa: seat, back, two arms, cushions.
    ("d9694f", (-0.75, 0.24, 2.95), (2.1, 0.4, 0.85), 0.0),
    ("c75b44", (-0.75, 0.52, 3.38), (2.1, 0.86, 0.24), 0.0),
    ("c75b44", (-1.9, 0.34, 2.97), (0.24, 0.62, 0.9), 0.0),
    ("c75b44", (0.4, 0.34, 2.97), (0.24, 0.62, 0.9), 0.0),
    ("f2b632", (-1.45, 0.62, 3.12), (0.42, 0.36, 0.16), 0.25),
    ("f1e6d2", (-0.05, 0.6, 3.13), (0.4, 0.34, 0.16), -0.3),
    # Crates in the right corner, the upper one turned; cupboards; the plant's pot.
    (paint.crate("cf9f63", "9c6a38"), (3.05, 0.33, 2.05), (0.66, 0.66, 0.66), 0.12),
    (paint.crate("5f9ea0", "f0e4cf"), (3.08, 0.9, 2.08), (0.48, 0.48, 0.48), 0.6),
    (paint.wood("a8744a"), (-3.45, 0.4, 1.9), (0.55, 0.8, 1.2), 0.0),
    (paint.wood("8d5f3a"), (1.3, 0.35, -3.52), (1.6, 0.7, 0.42), 0.0),
    ("f0e8da", (-3.12, 0.22, 2.95), (0.42, 0.44, 0.42), 0.4),
)
"""Colour or pattern, middle (its height up) and size in metres, and turn about the vertical."""

WALLS = (
    (X, Z, paint.PLASTER, ((-1.55, 1.85, 1.15, 1.3, paint.framed(paint.sunset)),
                           (0.15, 1.85, 1.15, 1.3, paint.framed(paint.blobs)))),
    (Z, -X, paint.SAND, ((-0.6, 1.85, 1.9, 1.35, paint.window),
                         (2.0, 1.85, 0.9, 1.1, paint.framed(paint.arches)))),
    (-Z, X, paint.CLAY, ((0.4, 1.85, 1.0, 1.3, paint.framed(paint.blocks)),
                         (-1.9, 1.95, 0.9, 1.1, paint.framed(paint.blobs)))),
    (-X, -Z, paint.SAGE, ((-1.6, 1.85, 1.2, 1.2, paint.framed(paint.arches)),
                          (0.9, 1.85, 1.9, 1.35, paint.window))),
)  # fmt: skip
"""Of each wall: right and back as one looks at it, its colour, and what hangs there: the middle's
place to the right and its height, width and height, metres, and the pattern."""


def fixtures(seed: int) -> list[Cone]:
    """The round things that do not move: the lamp first, its cord, the plant, vases."""
    x, y, z = LAMP_AT
    cones = [
        cone("ffffff", LAMP_AT, 0.17),
        cone("23262e", (x, y - 0.15, z), 0.07, (x, y - 0.22, z), 0.03),
        cone("23262e", (x, y - 0.17, z), 0.018, (x, -HEIGHT_M, z), 0.018),
        cone("2c5fa8", (-3.42, -0.94, 1.6), 0.13, (-3.42, -1.13, 1.6), 0.07),
        cone("f2b632", (-3.42, -0.92, 2.12), 0.12),
        cone("e58fa0", (1.0, -0.85, -3.5), 0.14, (1.0, -1.1, -3.5), 0.05),
    ]
    rng, root = np.random.default_rng(seed), np.array([-3.12, -0.44, 2.95])
    for _ in range(15):
        around, tilt, reach = rng.uniform((0, 0.15, 0.45), (2 * np.pi, 0.95, 0.95))
        out = np.cos(around) * np.sin(tilt), -np.cos(tilt), np.sin(around) * np.sin(tilt)
        tip = np.clip(root + reach * np.array(out), -3.6, 3.6)
        middle = 0.5 * (root + tip) + (0, -0.05, 0)
        cones.append(cone(paint.even("4f8d50", 0.5), middle, 0.08, tip, 0.02))
    return cones


def room_surfels(spacing_m: float, seed: int) -> Iterator[Surfels]:
    """The surfaces that do not move, but for the fixtures."""
    low, wide = HALF_M, 2 * HALF_M
    yield rectangle(low * (Z - X), wide * X, -wide * Z, paint.floor, spacing_m, seed)
    top = -HEIGHT_M * Y - low * (X + Z)
    yield rectangle(top, wide * X, wide * Z, paint.ceiling, 2 * spacing_m, seed)
    for right, back, colour, pictures in WALLS:
        corner = low * (back - right) - HEIGHT_M * Y
        yield rectangle(corner, wide * right, HEIGHT_M * Y, paint.wall(colour), spacing_m, seed)
        for x, height, w, h, pattern in pictures:
            middle = (low - 0.02) * back + x * right - height * Y
            corner = middle - w / 2 * right - h / 2 * Y
            yield rectangle(corner, w * right, h * Y, pattern, spacing_m, seed)
    for number, (look, (x, height, z), (w, h, d), turn) in enumerate(FURNITURE):
        pattern = paint.plain(look) if isinstance(look, str) else look
        right = np.array([np.cos(turn), 0, np.sin(turn)])
        back, middle = np.cross(right, Y), np.array([x, -height, z])
        for one, other, width, depth in (
            *((right, back, w, d), (-back, right, d, w)),
            *((-right, -back, w, d), (back, -right, d, w)),
        ):
            corner = middle - width / 2 * one - depth / 2 * other - h / 2 * Y
            front = paint.books if not number and width == w else pattern
            yield rectangle(corner, width * one, h * Y, front, spacing_m, seed + number)
        corner = middle - w / 2 * right + d / 2 * back - h / 2 * Y
        yield rectangle(corner, w * right, -d * back, pattern, spacing_m, seed + number)


def room_occlusion(surfels: Surfels) -> Floats:
    """(N,) the share of the ambient light that corners and furniture leave."""
    left, p, n = np.ones(len(surfels.places), np.float32), surfels.places, surfels.normals
    for axis, low, high in (0, -HALF_M, HALF_M), (1, -HEIGHT_M, 0.0), (2, -HALF_M, HALF_M):
        for gap in p[:, axis] - low, high - p[:, axis]:
            dark = 0.42 * np.exp(-np.maximum(0, gap) / 0.22)
            left *= 1 - np.where(np.abs(n[:, axis]) > 0.9, 0, dark)
    for _, (x, height, z), size, turn in FURNITURE:
        near = np.flatnonzero(np.abs(p - (x, -height, z)).max(axis=1) < max(size) / 2 + 0.6)
        c, s = np.cos(turn), np.sin(turn)
        at = (p[near] - (x, -height, z)) @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
        gap = np.linalg.norm(np.maximum(0, np.abs(at) - np.array(size) / 2), axis=1)
        left[near] *= 1 - np.where(gap > 1e-3, 0.5 * np.exp(-gap / 0.14), 0)
    return left


class Scene:
    """All that every camera sees."""

    def __init__(self, fps: float, seed: int, walk_radius_m: float, spacing_m: float) -> None:
        """spacing_m: from one surfel to the next."""
        self._fps, self._seed, self._walk_radius_m = fps, seed, walk_radius_m
        self._spacing_m = spacing_m
        still = [cone.thinner(INSET * spacing_m) for cone in fixtures(seed)]
        surfaces = [*room_surfels(spacing_m, seed), cone_surfels(still, spacing_m, seed)]
        room = Surfels.joined(surfaces)
        self._ambient, self._lamp = light_of(room)
        # The lamp, the first of the round things, hides nothing and glows.
        dim, lit = past_cones(room._replace(owners=room.owners - 1), still[1:])
        self._ambient *= (dim * room_occlusion(room))[:, None]
        self._lamp *= lit[:, None]
        self._ambient[room.owners == 0], self._lamp[room.owners == 0] = GLOW, 0
        self._room = room._replace(owners=np.full_like(room.owners, -1))
        cells = np.floor(room.places / CELL_M)
        keys = cells @ np.array([1 << 12, 1 << 6, 1], np.float32)
        _, first, self._cell_of = np.unique(keys, return_index=True, return_inverse=True)
        self._cells = cells[first]
        self.moving = lru_cache(maxsize=1)(self._moving)
        """Gives what moves in a frame, and the surfaces of the room that it takes light from."""

    def room(self) -> Splats:
        """What does not move."""
        return self._room.splats(self._ambient + self._lamp)

    def _moving(self, frame: int) -> Splats:
        made = moving_cones(frame / self._fps, self._seed, self._walk_radius_m)
        cones = [cone.thinner(INSET * self._spacing_m) for cone in made]
        movers = cone_surfels(cones, MOVING_SPACING * self._spacing_m, self._seed)
        dim, lit = past_cones(movers, cones)
        # The floor is near.
        dim *= 1 - 0.3 * np.maximum(0, movers.normals[:, 1]) * np.exp(movers.places[:, 1] / 0.3)
        ambient, lamp = light_of(movers)
        own = movers.splats(ambient * dim[:, None] + lamp * lit[:, None])
        rows = self._near(cones)
        shaded = self._room.take(rows)
        dim, lit = past_cones(shaded, cones)
        changed = np.flatnonzero(np.minimum(dim, lit) < SEEN)
        dim, lit, rows = dim[changed, None], lit[changed, None], rows[changed]
        light = self._ambient[rows] * dim + self._lamp[rows] * lit
        return Splats.concatenate([own, shaded.take(changed).splats(light)])

    def _near(self, cones: Sequence[Cone]) -> npt.NDArray[np.intp]:
        """Rows of the room that cones may take light from."""
        table = np.array([cone.row() for cone in cones])
        middles, half = (self._cells[:, None] + 0.5) * CELL_M, CELL_M * 0.87
        around, thick = (table[:, :3] + table[:, 4:7]) / 2, np.maximum(table[:, 3], table[:, 7])
        radii = np.linalg.norm(table[:, :3] - table[:, 4:7], axis=1) / 2 + thick + half
        away, to = around - middles, LAMP_AT - middles
        dims = np.linalg.norm(away, axis=2) < radii + (REACH_RADII - 1) * thick
        along = np.clip((away * to).sum(axis=2) / (to**2).sum(axis=2), 0, 1)
        gaps = np.linalg.norm(away - along[..., None] * to, axis=2)
        near = (dims | (gaps < radii + LAMP_RADIUS_M * along)).any(axis=1)
        return np.flatnonzero(near[self._cell_of])


def camera_rig(num_cameras: int, width_px: int, height_px: int, arc_rad: float) -> list[Camera]:
    """Cameras cam00, cam01, ... evenly on an arc around the room's middle, all looking inward."""
    focal = width_px / 2 / np.tan(FIELD_OF_VIEW_RAD / 2)
    cameras = []
    for i in range(num_cameras):
        angle = arc_rad * (i / (num_cameras - 1) - 0.5) if num_cameras > 1 else 0.0
        position = CAMERA_RADIUS_M * np.array([-np.sin(angle), 0.0, -np.cos(angle)])
        position[1] = -CAMERA_HEIGHTS_M[i % len(CAMERA_HEIGHTS_M)]
        cameras.append(
            Camera(
                name=f"cam{i:02d}",
                width_px=width_px,
                height_px=height_px,
                fx_px=float(focal),
                fy_px=float(focal),
                cx_px=width_px / 2,
                cy_px=height_px / 2,
                w2c=look_at(position, CAMERA_TARGET, UP),
            )
        )
    return cameras


def held_out_cameras(cameras: Sequence[Camera], held_out: int) -> list[str]:
    """Names of `held_out` cameras, evenly between the others and never at an end of the arc."""
    places = np.linspace(0, len(cameras) - 1, held_out + 2)[1:-1]
    return [cameras[round(float(place))].name for place in places]
