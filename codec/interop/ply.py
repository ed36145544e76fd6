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

import numpy as np

from ..errors import CorruptError, UnsupportedError
from ..splats import MAX_SH_DEGREE, Floats, Splats, sh_count
from .limits import checked_splats
from .plyheader import PlyElement, read_ply_elements

SURE_LOGIT = 16.0
"""Stands for infinite logits, which programs write that make them of opacity bytes 0 and 255."""

REST_COUNTS = {3 * (sh_count(degree) - 1) for degree in range(MAX_SH_DEGREE + 1)}
"""How many f_rest there may be: 0, 9, 24, 45."""


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


def _columns(vertex: PlyElement, data: bytes, names: list[str]) -> Floats:
    """(N, len(names)) float32."""
    rows = vertex.rows(data)
    columns = np.empty((vertex.count, len(names)), np.float32)
    for i, name in enumerate(names):
        columns[:, i] = rows[name]
    return columns


def decode_ply(data: bytes) -> Splats:
    """The Gaussians of an uncompressed PLY. Raises CorruptError or UnsupportedError."""
    vertex = read_ply_elements(data).get("vertex")
    if vertex is None:
        raise CorruptError("PLY: no element vertex")
    groups = {
        "means": ["x", "y", "z"],
        "dc": _names("f_dc", 3),
        "rest": rest_names(vertex.properties),
        "opacity": ["opacity"],
        "scale": _names("scale", 3),
        "rot": _names("rot", 4),
    }
    missing = [n for names in groups.values() for n in names if n not in vertex.properties]
    if missing:
        raise CorruptError(
            f"PLY: no property {', '.join(missing[:4])}; these are points, not Gaussians"
        )
    with np.errstate(all="ignore"):  # a double beyond float32 becomes inf, which is refused below
        found = {key: _columns(vertex, data, names) for key, names in groups.items()}
    sh = np.empty((vertex.count, 1 + len(groups["rest"]) // 3, 3), np.float32)
    sh[:, 0] = found["dc"]
    sh[:, 1:] = found["rest"].reshape(vertex.count, 3, sh.shape[1] - 1).swapaxes(1, 2)
    logits = found["opacity"][:, 0].copy()
    endless = np.isinf(logits)
    logits[endless] = np.copysign(np.float32(SURE_LOGIT), logits[endless])
    return checked_splats("PLY", found["means"], found["scale"], found["rot"], logits, sh)


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
