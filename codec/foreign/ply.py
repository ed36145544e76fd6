"""The PLY of 3D Gaussian Splatting, in and out; without loss.

Layout: `element vertex N`, all properties float32, in the order of the reference implementation
(graphdeco-inria/gaussian-splatting, `save_ply`):

    x y z | nx ny nz (zeros) | f_dc_0..2 | f_rest_0.. (3 (K - 1) of them) | opacity | scale_0..2 |
    rot_0..3

f_rest is channel-major: all K - 1 coefficients of red, then green, then blue. opacity is a logit,
scale a natural logarithm, rot w, x, y, z of any norm. Frame RDF (x right, y down, z forward), which
is the world of a swings stream. A reader goes by name: any order and any other properties are fine.

Also read: 2D Gaussians, which have no scale_2; colours as bytes red, green, blue in the place of
f_dc; filter_3D (Mip-Splatting), the standard deviation of a smoothing that the sizes lack.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from codec.arrays import Doubles, Floats
from codec.errors import CorruptError, UnsupportedError
from codec.splats import MAX_SH_DEGREE, SH_C0, Splats, sh_count

from .limits import MAX_GAUSSIANS, Decoded, check_count
from .notes import ANTIALIASED, FLAT, notes, tell_model
from .plyheader import PlyElement, PlyHeader, read_ply_header

SURE_LOGIT = 16.0
"""Stands for infinite logits, which programs write that make them of opacity bytes 0 and 255."""

FLAT_SHARE = 1e-3
"""Third standard deviation of a 2D Gaussian, as a share of the smaller one: too thin to be seen."""
FILTER = "filter_3D"
RED_GREEN_BLUE = ["red", "green", "blue"]

FAR_M = 4096.0
"""Distance of a scene from the origin from which double positions lose digits as float32, which
steps by half a millimetre there."""
CENTRE_STEP_M = 1000.0
"""A centre that is taken away is a multiple of this, which files of one sequence agree on."""

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
    """The properties of each array of a Splats. `dc` are bytes if they are RED_GREEN_BLUE; `scale`
    are two for 2D Gaussians."""
    sh_degree: int
    model: str
    """How the Gaussians were trained; see `tell_model`."""


def ply_layout(head: bytes, file_bytes: int, max_gaussians: int = MAX_GAUSSIANS) -> PlyLayout:
    """The layout of the Gaussians, by the header of an uncompressed PLY of `file_bytes` in all.

    Raises CorruptError, or UnsupportedError, also for more than `max_gaussians`.
    """
    header = read_ply_header(head)
    vertex = header.tables.get("vertex")
    if vertex is None:
        header.check_rows()
        raise CorruptError("PLY: no element vertex")
    check_count("PLY", vertex.count, max_gaussians)
    names = {
        "means": ["x", "y", "z"],
        "dc": _names("f_dc", 3),
        "rest": rest_names(vertex.properties),
        "opacity": ["opacity"],
        "scale": _names("scale", 3),
        "rot": _names("rot", 4),
    }
    model = trained_as(header)
    have = set(vertex.properties)
    if "scale_1" in have and "scale_2" not in have:
        names["scale"], model = names["scale"][:2], FLAT
    kinds = {vertex.dtype[name] for name in RED_GREEN_BLUE if name in have}
    if "f_dc_0" not in have and set(RED_GREEN_BLUE) <= have and kinds == {np.dtype(np.uint8)}:
        names["dc"] = RED_GREEN_BLUE
    missing = [name for group in names.values() for name in group if name not in have]
    if missing and not header.has_list:  # before a text file is converted for nothing
        is_cloud = not {"opacity", "scale_0", "rot_0"} & have
        reason = "; these are points, not Gaussians" if is_cloud else ""
        raise CorruptError(f"PLY: no property {', '.join(missing[:4])}{reason}")
    header.check_rows()
    vertex.check_size(file_bytes)
    return PlyLayout(vertex, names, REST_COUNTS[len(names["rest"])], model)


def trained_as(header: PlyHeader) -> str:
    """How the Gaussians of a file were trained by its comments, which `tell_model` explains: those
    of Brush and gsplat, `SplatRenderMode: mip`, and of Postshot, `antialiased 1`."""
    model = ""
    for comment in header.comments:
        match comment.lower().split():
            case ["splatrendermode:", mode]:
                model = ANTIALIASED if mode == "mip" else mode
            case ["antialiased", "0" | "1" as flag]:
                model = ANTIALIASED if flag == "1" else ""
    return model


def _fold_filter(made: Decoded, sizes_m: Floats) -> None:
    """Smooths the Gaussians by filters of the standard deviations `sizes_m`, (N,)."""
    log_scales = made.log_scales.astype(np.float64)
    wider = np.logaddexp(2 * log_scales, 2 * np.log(sizes_m.astype(np.float64))[:, None]) / 2
    shrunk = made.opacities * np.exp((log_scales - wider).sum(axis=1))
    shrunk = np.clip(shrunk, np.finfo(np.float64).tiny, 1 - np.finfo(np.float64).eps)
    made.log_scales[:] = wider
    made.logit_opacities[:] = np.log(shrunk) - np.log1p(-shrunk)


def _centred(means: Doubles) -> Doubles:
    """(N, 3) positions around the origin, if they are so far from it that float32 would
    lose digits: the same is taken from all files of an import."""
    found = notes()
    if found.centre is None:
        finite = means[np.isfinite(means).all(axis=1)]
        middle = np.median(finite, axis=0) if len(finite) else np.zeros(3)
        if np.abs(middle).max() < FAR_M:
            return means
        found.centre = CENTRE_STEP_M * np.rint(middle / CENTRE_STEP_M) + 0.0  # no -0
        away = ", ".join(f"{value:.0f}" for value in found.centre)
        found.say(f"positions are far from the origin: ({away}) m is taken away from all")
    centred: Doubles = means - found.centre
    return centred


def _warn_of_linear_sizes(log_scales: Floats) -> None:
    """Logarithms of metres are negative but for sizes above a metre, which are never all."""
    if len(log_scales) and log_scales.min() > 0 and np.median(log_scales) < 1:
        notes().say(
            "all sizes are above 0 and most below 1: they look like metres, where a PLY has their "
            "logarithms; write ln of the sizes if the model is a fog"
        )


def decode_ply(data: bytes, max_gaussians: int = MAX_GAUSSIANS) -> Splats:
    """The Gaussians of an uncompressed PLY.

    Raises CorruptError, or UnsupportedError, also for more than `max_gaussians`.
    """
    from numpy.lib.recfunctions import structured_to_unstructured  # loads masked arrays

    layout = ply_layout(data, len(data), max_gaussians)
    tell_model(layout.model)
    rows = layout.vertex.rows(data)
    made = Decoded.empty(layout.vertex.count, layout.sh_degree)
    places = {
        "means": made.means,
        "dc": made.sh[:, 0],
        "rest": made.sh[:, 1:].swapaxes(1, 2),  # channel-major in the file
        "opacity": made.logit_opacities,
        "scale": made.log_scales[:, : len(layout.names["scale"])],
        "rot": made.quats,
    }
    with np.errstate(all="ignore"):  # a double beyond float32 becomes inf, which is refused below
        for key, names in layout.names.items():
            if names:
                place = places[key]
                values = structured_to_unstructured(rows[names])
                if key == "means" and values.dtype == np.float64:
                    values = _centred(values)
                place[:] = values.reshape(place.shape)
        if layout.names["dc"] == RED_GREEN_BLUE:
            made.sh[:, 0] = (made.sh[:, 0] / 255 - 0.5) / SH_C0
        if len(layout.names["scale"]) == 2:
            made.log_scales[:, 2] = made.log_scales[:, :2].min(axis=1) + np.log(FLAT_SHARE)
        _warn_of_linear_sizes(made.log_scales)
        logits = made.logit_opacities
        endless = np.isinf(logits)
        logits[endless] = np.copysign(np.float32(SURE_LOGIT), logits[endless])
        if FILTER in layout.vertex.properties:
            _fold_filter(made, rows[FILTER])
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
