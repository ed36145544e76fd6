"""The ray tracer of the synthetic scene: a still room with a few moving round parts.

The room is traced once per camera into a buffer, four rays a pixel; a frame then only asks each ray
whether a moving part stands before the room or takes light from the place that it sees. The world's
y points down; directions are unit vectors.

The two loops over pixels are long for speed: numba counts references to the arrays that one kernel
hands to another. With more of what they do in kernels of its own, a frame took twice as long.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from codec.kernel import kernel

from .light import (
    LAMP_LIGHT,
    ambient_light,
    ambient_of_parts,
    ambient_of_room,
    encode,
    lamp_past_boxes,
    light_of_lamp,
    light_past_groups,
    shadow_of_parts,
)
from .paint import (
    BACK,
    CEILING,
    FLOOR,
    FRONT,
    LAMP,
    LEFT,
    RIGHT,
    Rgb,
    paint_box,
    paint_part,
    paint_room,
)
from .solid import (
    COS,
    FIRST,
    GROUP_CENTRE,
    GROUP_END,
    GROUP_FIRST,
    GROUP_RADIUS,
    RADIUS,
    SIN,
    Boxes,
    Parts,
    Table,
    Vector,
    ahead,
    dot,
    hit_box,
    hit_part,
    hit_sphere,
    in_box,
    minus,
    part_axis,
    part_foot,
    turned,
    unit,
    vector_at,
)

Floats = npt.NDArray[np.float32]
Pixels = npt.NDArray[np.uint8]

RAYS_PER_PIXEL = 4
"""A 2x2 grid."""

T, PX, PY, PZ, NX, NY, NZ, AMBIENT, KEY = 0, 1, 2, 3, 4, 5, 6, 7, 10
"""Columns of the room buffer: distance, place, normal, light without the lamp (3), light of the
lamp (3)."""
BUFFER_COLUMNS = 13

FACES = (RIGHT, LEFT), (FLOOR, CEILING), (BACK, FRONT)
"""The faces of the room across each axis, at its greater end and at its lesser one."""

SAME_SURFACE = 0.98
"""Two rays of a pixel see one surface when the ratio of their distances is above this and their
normals agree; soft light is then worked out once for both."""


@kernel(error_model="numpy")
def part_surface(p: Vector, parts: Parts, i: int, seed: int) -> tuple[Vector, Rgb]:
    """The normal and the colour of a part at a place on its surface."""
    h = part_foot(p, parts.cones, i)
    m, axis = minus(p, vector_at(parts.cones, i, FIRST)), part_axis(parts.cones, i)
    n = unit(ahead(m, axis, -h))
    k = 1.0 / parts.cones[i, FIRST + RADIUS]
    right, up = vector_at(parts.axes, i, 0), vector_at(parts.axes, i, 3)
    local = (k * dot(right, m), k * dot(up, m), k * dot(vector_at(parts.axes, i, 6), m))
    return n, paint_part(parts, i, local, h * math.sqrt(dot(axis, axis)), seed)


@kernel(error_model="numpy")
def across(axis: int, sign: float) -> Vector:
    """The unit vector along an axis, or against it."""
    return sign * (axis == 0), sign * (axis == 1), sign * (axis == 2)


@kernel(error_model="numpy")
def room_hit(
    c: Vector, d: Vector, room: Table, places: Table, cones: Table
) -> tuple[float, Vector, int, int, int]:
    """(distance, normal, face, box, part) of the first hit; box and part are -1 if not hit.

    face: which of the room's faces, or of a box the axis across it. normal: of a wall or box only.
    """
    t, face = math.inf, 0
    n = (0.0, 0.0, 0.0)
    for axis in range(3):
        if abs(d[axis]) < 1e-12:
            continue
        forward = d[axis] > 0
        low = -room[0] if axis != 1 else -room[1]
        high = room[0] if axis != 1 else 0.0
        wall = ((high if forward else low) - c[axis]) / d[axis]
        if wall < t:
            t, face = wall, FACES[axis][0 if forward else 1]
            n = across(axis, -1.0 if forward else 1.0)
    box, part = -1, -1
    for i in range(places.shape[0]):
        near, axis = hit_box(c, d, places, i)
        if near < t:
            t, box, face = near, i, axis
    for i in range(cones.shape[0]):
        near = hit_part(c, d, cones, i)
        if near < t:
            t, part = near, i
    if box >= 0 and part < 0:
        cos, sin = places[box, COS], places[box, SIN]
        way = turned(d, cos, sin)
        n = turned(across(face, -1.0 if way[face] > 0 else 1.0), cos, -sin)
    return t, n, face, box, part


@kernel(error_model="numpy")
def ray_direction(camera: Table, row: int, column: int, ray: int) -> Vector:
    """Where a pixel's ray goes, in the world. camera: as of `trace_room`."""
    x = (column + 0.25 + 0.5 * (ray % 2) - camera[13]) / camera[12]
    y = (row + 0.25 + 0.5 * (ray // 2) - camera[14]) / camera[12]
    return unit(
        (
            camera[0] * x + camera[3] * y + camera[6],
            camera[1] * x + camera[4] * y + camera[7],
            camera[2] * x + camera[5] * y + camera[8],
        )
    )


@kernel(error_model="numpy")
def set_pixel(picture: Pixels, row: int, column: int, light: Rgb) -> None:
    """Sets a pixel to the mean of its rays; light: the sum of theirs."""
    for k in range(3):
        picture[row, column, k] = encode(light[k] / RAYS_PER_PIXEL)


@kernel(nogil=True, error_model="numpy")
def trace_room(
    camera: Table,
    room: Table,
    lamp: Table,
    boxes: Boxes,
    parts: Parts,
    wall_pictures: Table,
    seed: int,
    out_buffer: Floats,
    out_picture: Pixels,
) -> None:
    """Fills the room buffer (h, w, 4, BUFFER_COLUMNS) and the picture (h, w, 3) of the empty room.

    camera: rotation world to camera row by row (9), centre (3), focal length and principal point in
    pixels (3). room: half its width and its height, metres. lamp: its middle.
    """
    c = (camera[9], camera[10], camera[11])
    places, cones, patterns = boxes.places, parts.cones, parts.patterns
    num_parts = cones.shape[0]
    for row in range(out_buffer.shape[0]):
        for column in range(out_buffer.shape[1]):
            light = (0.0, 0.0, 0.0)
            for ray in range(RAYS_PER_PIXEL):
                d = ray_direction(camera, row, column, ray)
                t, n, face, box, part = room_hit(c, d, room, places, cones)
                p = ahead(c, d, t)
                if part >= 0:
                    n, colour = part_surface(p, parts, part, seed)
                elif box >= 0:
                    colour = paint_box(boxes, box, in_box(p, places, box), face, seed)
                else:
                    colour = paint_room(face, p, wall_pictures, seed)
                ambient = ambient_light(n)
                dim = ambient_of_room(p, n, places, room)
                dim *= ambient_of_parts(p, n, cones, 0, num_parts, part)
                key = light_of_lamp(p, n, lamp)
                if key > 0:
                    key *= lamp_past_boxes(p, n, lamp, places)
                    key *= shadow_of_parts(p, lamp, cones, patterns, 0, num_parts, part)
                if part >= 0 and patterns[part] == LAMP:  # which glows
                    ambient, dim, key = (3.0, 2.75, 2.3), 1.0, 0.0
                cell = out_buffer[row, column, ray]
                cell[T], cell[PX], cell[PY], cell[PZ] = t, p[0], p[1], p[2]
                cell[NX], cell[NY], cell[NZ] = n
                for k in range(3):
                    cell[AMBIENT + k] = colour[k] * ambient[k] * dim
                    cell[KEY + k] = colour[k] * LAMP_LIGHT[k] * key
                light = (
                    light[0] + (cell[AMBIENT] + cell[KEY]),
                    light[1] + (cell[AMBIENT + 1] + cell[KEY + 1]),
                    light[2] + (cell[AMBIENT + 2] + cell[KEY + 2]),
                )
            set_pixel(out_picture, row, column, light)


@kernel(error_model="numpy")
def light_of_part(p: Vector, part: int, lamp: Table, parts: Parts, groups: Table, seed: int) -> Rgb:
    """The light that comes from a place on a moving part."""
    n, colour = part_surface(p, parts, part, seed)
    dim, key = light_past_groups(p, n, lamp, parts.cones, parts.patterns, groups, part)
    dim *= 1.0 - 0.3 * max(0.0, n[1]) * math.exp(p[1] / 0.3)  # the floor is near
    key *= light_of_lamp(p, n, lamp)
    ambient = ambient_light(n)
    return (
        colour[0] * (ambient[0] * dim + LAMP_LIGHT[0] * key),
        colour[1] * (ambient[1] * dim + LAMP_LIGHT[1] * key),
        colour[2] * (ambient[2] * dim + LAMP_LIGHT[2] * key),
    )


@kernel(nogil=True, error_model="numpy")
def trace_frame(
    centre: Table,
    lamp: Table,
    parts: Parts,
    groups: Table,
    seed: int,
    buffer: Floats,
    room_picture: Pixels,
    out_picture: Pixels,
    out_distance: Floats,
) -> None:
    """Fills the picture (h, w, 3) of a frame and the distance (h, w) that each pixel's first ray
    sees.

    centre: the camera's. parts, groups: those that move. buffer, room_picture: of `trace_room`.
    """
    c = (centre[0], centre[1], centre[2])
    cones, patterns = parts.cones, parts.patterns
    for row in range(buffer.shape[0]):
        for column in range(buffer.shape[1]):
            red, green, blue = 0.0, 0.0, 0.0
            changed = False
            known = -1  # the ray of this pixel that dim and key were last worked out for
            dim, key = 1.0, 1.0
            for ray in range(RAYS_PER_PIXEL):
                cell = buffer[row, column, ray]
                t, part = float(cell[T]), -1
                p = (float(cell[PX]), float(cell[PY]), float(cell[PZ]))
                way, inverse = minus(p, c), 1.0 / t
                d = (way[0] * inverse, way[1] * inverse, way[2] * inverse)
                for g in range(groups.shape[0]):
                    radius = groups[g, GROUP_RADIUS]
                    if hit_sphere(c, d, vector_at(groups, g, GROUP_CENTRE), radius) < t:
                        for i in range(int(groups[g, GROUP_FIRST]), int(groups[g, GROUP_END])):
                            near = hit_part(c, d, cones, i)
                            if near < t:
                                t, part = near, i
                if ray == 0:
                    out_distance[row, column] = t
                if part >= 0:
                    changed = True
                    light = light_of_part(ahead(c, d, t), part, lamp, parts, groups, seed)
                    red, green, blue = red + light[0], green + light[1], blue + light[2]
                    continue
                if known < 0 or not same_surface(buffer[row, column, known], cell):
                    n = (float(cell[NX]), float(cell[NY]), float(cell[NZ]))
                    dim, key = light_past_groups(p, n, lamp, cones, patterns, groups, -1)
                    known = ray
                    changed = changed or dim != 1.0 or key != 1.0
                red += cell[AMBIENT] * dim + cell[KEY] * key
                green += cell[AMBIENT + 1] * dim + cell[KEY + 1] * key
                blue += cell[AMBIENT + 2] * dim + cell[KEY + 2] * key
            if changed:
                set_pixel(out_picture, row, column, (red, green, blue))
            else:
                for k in range(3):
                    out_picture[row, column, k] = room_picture[row, column, k]


@kernel(error_model="numpy")
def same_surface(first: Any, second: Any) -> bool:
    """Whether two rays of a pixel, cells of the room buffer, see one surface."""
    a, b = first[T], second[T]
    agree = 0.0
    for k in range(3):
        agree += first[NX + k] * second[NX + k]
    return min(a, b) > SAME_SURFACE * max(a, b) and agree > SAME_SURFACE
