"""The PLY of 3D Gaussian Splatting, in and out; without loss.

Layout: `element vertex N`, all properties float32, in the order of the reference implementation
(graphdeco-inria/gaussian-splatting, `save_ply`):

    x y z | nx ny nz (zeros) | f_dc_0..2 | f_rest_0.. (3 (K - 1) of them) | opacity | scale_0..2 |
    rot_0..3

f_rest is channel-major: all K - 1 coefficients of red, then green, then blue. opacity is a logit,
scale a natural logarithm, rot w, x, y, z of any norm. Frame RDF (x right, y down, z forward), which
is the world of a swings stream. A reader goes by name: any order and any other properties are fine.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from codec.errors import CorruptError, UnsupportedError
from codec.splats import MAX_SH_DEGREE, Splats, sh_count

from .limits import MAX_GAUSSIANS, Decoded, check_count
from .plyheader import PlyElement, read_ply_elements

SURE_LOGIT = 16.0
"""Stands for infinite logits, which programs write that make them of opacity bytes 0 and 255."""

REST_COUNTS = {3 * (sh_count(degree) - 1): degree for degree in range(MAX_SH_DEGREE + 1)}
"""How many f_rest there may be, 0, 9, 24 or 45, and the SH degree of each."""


def _names(stem: str, count: int) -> list[str]:
    return [f"{stem}_{i}" for i in range(count)]


def rest_names(properties: tuple[str, ...]) -> list[str]:
    """f_rest_0.. as `properties` has them. Raises a CodecError if they fit no SH degree."""
    count = sum(name.startswith("f_rest_") for name in properties)
    if count not in REST_COUNTS:
        raise UnsupportedError(
            f"PLY: {count} properties f_rest; this program reads 0, 9, 24 or 45 (SH degree 0 to 3)"
        )
    names = _names("f_rest", count)
    missing = [name for name in names if name not in properties]
    if missing:
        raise CorruptError(f"PLY: {count} properties f_rest, but no {missing[0]}")
    return names


@dataclass(frozen=True, slots=True)
class PlyLayout:
    """Where in a PLY the Gaussians are."""

    vertex: PlyElement
    names: dict[str, list[str]]
    """The properties of each array of a Splats."""
    sh_degree: int


def ply_layout(head: bytes, file_bytes: int, max_gaussians: int = MAX_GAUSSIANS) -> PlyLayout:
    """The layout of the Gaussians, by the header of an uncompressed PLY of `file_bytes` in all.

    Raises CorruptError, or UnsupportedError, also for more than `max_gaussians`.
    """
    vertex = read_ply_elements(head).get("vertex")
    if vertex is None:
        raise CorruptError("PLY: no element vertex")
    names = {
        "means": ["x", "y", "z"],
        "dc": _names("f_dc", 3),
        "rest": rest_names(vertex.properties),
        "opacity": ["opacity"],
        "scale": _names("scale", 3),
        "rot": _names("rot", 4),
    }
    missing = [n for group in names.values() for n in group if n not in vertex.properties]
    if missing:
        raise CorruptError(
            f"PLY: no property {', '.join(missing[:4])}; these are points, not Gaussians"
        )
    check_count("PLY", vertex.count, max_gaussians)
    vertex.check_size(file_bytes)
    return PlyLayout(vertex, names, REST_COUNTS[len(names["rest"])])


def decode_ply(data: bytes, max_gaussians: int = MAX_GAUSSIANS) -> Splats:
    """The Gaussians of an uncompressed PLY.

    Raises CorruptError, or UnsupportedError, also for more than `max_gaussians`.
    """
    from numpy.lib.recfunctions import structured_to_unstructured  # loads masked arrays

    layout = ply_layout(data, len(data), max_gaussians)
    rows = layout.vertex.rows(data)
    made = Decoded.empty(layout.vertex.count, layout.sh_degree)
    places = {
        "means": made.means,
        "dc": made.sh[:, 0],
        "rest": made.sh[:, 1:].swapaxes(1, 2),  # channel-major in the file
        "opacity": made.logit_opacities,
        "scale": made.log_scales,
        "rot": made.quats,
    }
    with np.errstate(all="ignore"):  # a double beyond float32 becomes inf, which is refused below
        for key, names in layout.names.items():
            if names:
                place = places[key]
                place[:] = structured_to_unstructured(rows[names]).reshape(place.shape)
    logits = made.logit_opacities
    endless = np.isinf(logits)
    logits[endless] = np.copysign(np.float32(SURE_LOGIT), logits[endless])
    return made.checked("PLY")


def encode_ply(splats: Splats) -> bytes:
    """The PLY file of `splats`, which `decode_ply` gives back bit by bit."""
    count, rest_count = len(splats), 3 * (splats.sh.shape[1] - 1)
    names = [
        *("x", "y", "z", "nx", "ny", "nz"),
        *_names("f_dc", 3),
        *_names("f_rest", rest_count),
        "opacity",
        *_names("scale", 3),
        *_names("rot", 4),
    ]
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    lines += [f"property float {name}" for name in names]
    rows = np.concatenate(
        [
            splats.means,
            np.zeros((count, 3), np.float32),
            splats.sh[:, 0],
            splats.sh[:, 1:].swapaxes(1, 2).reshape(count, rest_count),
            splats.logit_opacities[:, None],
            splats.log_scales,
            splats.quats,
        ],
        axis=1,
    )
    return "\n".join([*lines, "end_header\n"]).encode() + rows.astype("<f4").tobytes()
