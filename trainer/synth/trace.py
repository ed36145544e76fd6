"""The ray tracer of the synthetic scene: a still room with a few moving round parts.

The room is traced once per camera into a buffer, four rays a pixel; a frame then only asks each ray
whether a moving part stands before the room or takes light from the place that it sees. The world's
y points down; directions are unit vectors.
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
from .solid import Vector, ahead, dot, hit_box, hit_part, hit_sphere, part_foot, unit

Floats = npt.NDArray[np.float32]
Integers = npt.NDArray[np.int64]
Pixels = npt.NDArray[np.uint8]
Table = npt.NDArray[np.float64]

RAYS_PER_PIXEL = 4
"""A 2x2 grid."""

T, PX, PY, PZ, NX, NY, NZ, AMBIENT, KEY = 0, 1, 2, 3, 4, 5, 6, 7, 10
"""Columns of the room buffer: distance, place, normal, light without the lamp (3), light of the
lamp (3)."""
BUFFER_COLUMNS = 13

SAME_SURFACE = 0.98
"""Two rays of a pixel see one surface when the ratio of their distances is above this and their
normals agree; soft light is then worked out once for both."""


@kernel(error_model="numpy")
def part_surface(
    p: Vector, parts: Any, frames: Any, patterns: Any, colours: Any, i: int, seed: int
) -> tuple[Vector, Rgb]:
    """The normal and the colour of a part at a place on its surface."""
    h = part_foot(p, parts, i)
    m = (p[0] - parts[i, 0], p[1] - parts[i, 1], p[2] - parts[i, 2])
    axis = (parts[i, 4] - parts[i, 0], parts[i, 5] - parts[i, 1], parts[i, 6] - parts[i, 2])
    n = unit((m[0] - h * axis[0], m[1] - h * axis[1], m[2] - h * axis[2]))
    k = 1.0 / parts[i, 3]
    local = (
        k * (frames[i, 0] * m[0] + frames[i, 1] * m[1] + frames[i, 2] * m[2]),
        k * (frames[i, 3] * m[0] + frames[i, 4] * m[1] + frames[i, 5] * m[2]),
        k * (frames[i, 6] * m[0] + frames[i, 7] * m[1] + frames[i, 8] * m[2]),
    )
    along = h * math.sqrt(dot(axis, axis))
    return n, paint_part(patterns[i], colours, i, local[0], local[1], local[2], along, seed)


@kernel(error_model="numpy")
def room_hit(
    c: Vector, d: Vector, room: Any, boxes: Any, parts: Any
) -> tuple[float, Vector, int, int, int]:
    """(distance, normal of a wall or box, face, box, part) first hit; box and part are -1 if not
    hit.

    `face` is that of the room, or the axis across the face of the box.
    """
    t, face = math.inf, 0
    n = (0.0, 0.0, 0.0)
    for axis in range(3):
        if abs(d[axis]) < 1e-12:
            continue
        low = -room[0] if axis != 1 else -room[1]
        high = room[0] if axis != 1 else 0.0
        wall = ((high if d[axis] > 0 else low) - c[axis]) / d[axis]
        if wall < t:
            t = wall
            sign = -1.0 if d[axis] > 0 else 1.0
            if axis == 0:
                face, n = (RIGHT if d[0] > 0 else LEFT), (sign, 0.0, 0.0)
            elif axis == 1:
                face, n = (FLOOR if d[1] > 0 else CEILING), (0.0, sign, 0.0)
            else:
                face, n = (BACK if d[2] > 0 else FRONT), (0.0, 0.0, sign)
    box, part = -1, -1
    for i in range(boxes.shape[0]):
        near, axis = hit_box(c, d, boxes, i)
        if near < t:
            t, box, face = near, i, axis
    for i in range(parts.shape[0]):
        near = hit_part(c, d, parts, i)
        if near < t:
            t, part = near, i
    if box >= 0 and part < 0:
        cos, sin = boxes[box, 6], boxes[box, 7]
        slope = cos * d[0] + sin * d[2]
        if face == 0:
            n = (-cos, 0.0, -sin) if slope > 0 else (cos, 0.0, sin)
        elif face == 1:
            n = (0.0, -1.0, 0.0) if d[1] > 0 else (0.0, 1.0, 0.0)
        else:
            slope = cos * d[2] - sin * d[0]
            n = (sin, 0.0, -cos) if slope > 0 else (-sin, 0.0, cos)
    return t, n, face, box, part


@kernel(nogil=True, error_model="numpy")
def trace_room(
    camera: Table,
    room: Table,
    lamp: Table,
    boxes: Table,
    box_patterns: Integers,
    box_colours: Table,
    parts: Table,
    frames: Table,
    patterns: Integers,
    colours: Table,
    pictures: Table,
    seed: int,
    out_buffer: Floats,
    out_picture: Pixels,
) -> None:
    """Fills the room buffer (h, w, 4, BUFFER_COLUMNS) and the picture (h, w, 3) of the empty room.

    camera: rotation world to camera row by row (9), centre (3), focal length and principal point in
    pixels (3). room: half its width and its height, metres. lamp: its middle.
    """
    c = (camera[9], camera[10], camera[11])
    for row in range(out_buffer.shape[0]):
        for column in range(out_buffer.shape[1]):
            red, green, blue = 0.0, 0.0, 0.0
            for ray in range(RAYS_PER_PIXEL):
                x = (column + 0.25 + 0.5 * (ray % 2) - camera[13]) / camera[12]
                y = (row + 0.25 + 0.5 * (ray // 2) - camera[14]) / camera[12]
                d = unit(
                    (
                        camera[0] * x + camera[3] * y + camera[6],
                        camera[1] * x + camera[4] * y + camera[7],
                        camera[2] * x + camera[5] * y + camera[8],
                    )
                )
                t, n, face, box, part = room_hit(c, d, room, boxes, parts)
                p = ahead(c, d, t)
                if part >= 0:
                    n, colour = part_surface(p, parts, frames, patterns, colours, part, seed)
                elif box >= 0:
                    px, py, pz = p[0] - boxes[box, 0], p[1] - boxes[box, 1], p[2] - boxes[box, 2]
                    u = boxes[box, 6] * px + boxes[box, 7] * pz
                    w = boxes[box, 6] * pz - boxes[box, 7] * px
                    half = boxes[box, 3:6]
                    colour = paint_box(
                        box_patterns[box], box_colours, box, u, py, w, half, face, seed
                    )
                else:
                    colour = paint_room(face, p[0], p[1], p[2], pictures, seed)
                ambient = ambient_light(n)
                dim = ambient_of_room(p, n, boxes, room[0], room[1])
                dim *= ambient_of_parts(p, n, parts, 0, parts.shape[0], part)
                key = light_of_lamp(p, n, lamp)
                if key > 0:
                    key *= lamp_past_boxes(p, n, lamp, boxes)
                    key *= shadow_of_parts(p, lamp, parts, patterns, 0, parts.shape[0], part)
                if part >= 0 and patterns[part] == LAMP:
                    ambient, dim, key = (3.0, 2.75, 2.3), 1.0, 0.0
                cell = out_buffer[row, column, ray]
                cell[T], cell[PX], cell[PY], cell[PZ] = t, p[0], p[1], p[2]
                cell[NX], cell[NY], cell[NZ] = n
                for k in range(3):
                    cell[AMBIENT + k] = colour[k] * ambient[k] * dim
                    cell[KEY + k] = colour[k] * LAMP_LIGHT[k] * key
                red += cell[AMBIENT] + cell[KEY]
                green += cell[AMBIENT + 1] + cell[KEY + 1]
                blue += cell[AMBIENT + 2] + cell[KEY + 2]
            out_picture[row, column, 0] = encode(red / RAYS_PER_PIXEL)
            out_picture[row, column, 1] = encode(green / RAYS_PER_PIXEL)
            out_picture[row, column, 2] = encode(blue / RAYS_PER_PIXEL)


@kernel(nogil=True, error_model="numpy")
def trace_frame(
    centre: Table,
    lamp: Table,
    parts: Table,
    frames: Table,
    patterns: Integers,
    colours: Table,
    groups: Table,
    windows: Integers,
    seed: int,
    buffer: Floats,
    room_picture: Pixels,
    out_picture: Pixels,
    out_distance: Floats,
) -> None:
    """Fills the picture (h, w, 3) of a frame and the distance (h, w) that each pixel's first ray
    sees.

    groups: as of synth_motion.Moving. windows: the first column, last column, first row and last
    row that can show each group.
    """
    c = (centre[0], centre[1], centre[2])
    for row in range(buffer.shape[0]):
        for column in range(buffer.shape[1]):
            red, green, blue = 0.0, 0.0, 0.0
            changed = False
            known = -1  # the ray of this pixel that dim and key were last worked out for
            dim, key = 1.0, 1.0
            for ray in range(RAYS_PER_PIXEL):
                t = float(buffer[row, column, ray, T])
                px = float(buffer[row, column, ray, PX])
                py = float(buffer[row, column, ray, PY])
                pz = float(buffer[row, column, ray, PZ])
                inverse = 1.0 / t
                d = ((px - c[0]) * inverse, (py - c[1]) * inverse, (pz - c[2]) * inverse)
                part = -1
                for g in range(groups.shape[0]):
                    if not (
                        windows[g, 0] <= column <= windows[g, 1]
                        and windows[g, 2] <= row <= windows[g, 3]
                    ):
                        continue
                    middle = (groups[g, 2], groups[g, 3], groups[g, 4])
                    if hit_sphere(c, d, middle, groups[g, 5]) < t:
                        for i in range(int(groups[g, 0]), int(groups[g, 1])):
                            near = hit_part(c, d, parts, i)
                            if near < t:
                                t, part = near, i
                if ray == 0:
                    out_distance[row, column] = t
                if part >= 0:
                    changed = True
                    p = ahead(c, d, t)
                    n, colour = part_surface(p, parts, frames, patterns, colours, part, seed)
                    dark, lit = light_past_groups(p, n, lamp, parts, patterns, groups, part)
                    dark *= 1.0 - 0.3 * max(0.0, n[1]) * math.exp(p[1] / 0.3)  # the floor is near
                    lit *= light_of_lamp(p, n, lamp)
                    ambient = ambient_light(n)
                    red += colour[0] * (ambient[0] * dark + LAMP_LIGHT[0] * lit)
                    green += colour[1] * (ambient[1] * dark + LAMP_LIGHT[1] * lit)
                    blue += colour[2] * (ambient[2] * dark + LAMP_LIGHT[2] * lit)
                    continue
                if known < 0 or not same_surface(buffer, row, column, known, ray):
                    n = (
                        float(buffer[row, column, ray, NX]),
                        float(buffer[row, column, ray, NY]),
                        float(buffer[row, column, ray, NZ]),
                    )
                    dim, key = light_past_groups((px, py, pz), n, lamp, parts, patterns, groups, -1)
                    known = ray
                    changed = changed or dim != 1.0 or key != 1.0
                red += buffer[row, column, ray, AMBIENT] * dim + buffer[row, column, ray, KEY] * key
                green += (
                    buffer[row, column, ray, AMBIENT + 1] * dim
                    + buffer[row, column, ray, KEY + 1] * key
                )
                blue += (
                    buffer[row, column, ray, AMBIENT + 2] * dim
                    + buffer[row, column, ray, KEY + 2] * key
                )
            if changed:
                out_picture[row, column, 0] = encode(red / RAYS_PER_PIXEL)
                out_picture[row, column, 1] = encode(green / RAYS_PER_PIXEL)
                out_picture[row, column, 2] = encode(blue / RAYS_PER_PIXEL)
            else:
                for k in range(3):
                    out_picture[row, column, k] = room_picture[row, column, k]


@kernel(error_model="numpy")
def same_surface(buffer: Any, row: int, column: int, first: int, second: int) -> bool:
    """Whether two rays of a pixel see one surface."""
    a, b = buffer[row, column, first, T], buffer[row, column, second, T]
    agree = 0.0
    for k in range(3):
        agree += buffer[row, column, first, NX + k] * buffer[row, column, second, NX + k]
    return min(a, b) > SAME_SURFACE * max(a, b) and agree > SAME_SURFACE
