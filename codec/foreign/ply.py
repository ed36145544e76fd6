"""The PLY of 3D Gaussian Splatting, in and out, without loss; in, also compressed (SuperSplat).

Layout: `element vertex N`, all properties float32, in the order of the reference implementation
(graphdeco-inria/gaussian-splatting, `save_ply`):

    x y z | nx ny nz (zeros) | f_dc_0..2 | f_rest_0.. (3 (K - 1) of them) | opacity | scale_0..2 |
    rot_0..3

f_rest is channel-major: all K - 1 coefficients of red, then green, then blue. opacity is a logit,
scale a natural logarithm, rot w, x, y, z of any norm. Frame RDF (x right, y down, z forward), which
is the world of a swings stream. A reader goes by name: any order and any other properties are fine.

Also read: 2D Gaussians, which have no scale_2; colours as bytes red, green, blue in the place of
f_dc; filter_3D (Mip-Splatting), the standard deviation of a smoothing that the sizes lack.

The text header says which elements follow, and how their rows are laid out. Source: "The PLY
Polygon File Format" (G. Turk, 1994). Every writer of Gaussians gives rows of numbers in
`binary_little_endian`, and these are read here. A caller that also takes text or meshes reads their
rows itself, as trainer/capture/points.py does.

The compressed PLY has 16 bytes a Gaussian, and bounds for each 256 of them. Layout
(playcanvas/engine, `gsplat-compressed-data.js`), a PLY file with the elements

    chunk    ceil(N / 256) rows: float min_x .. max_z, min_scale_x .. max_scale_z (of ln s) and, in
             newer files, min_r .. max_b; without these colours lie in 0..1
    vertex   N rows of four uint, highest bits first:
             packed_position  x 11, y 10, z 11 bits between the chunk's bounds
             packed_rotation  2 bits: which of w, x, y, z is largest and left out; the other three
                              in order, 10 bits each, as (v / 1023 - 1/2) * sqrt(2)
             packed_scale     x 11, y 10, z 11 bits between the chunk's bounds
             packed_color     red, green, blue between the chunk's bounds, opacity 0..1; 8 bits each
    sh       optional, N rows of 9, 24 or 45 uchar f_rest_i, channel-major: v * 8 / 255 - 4

Frame RDF as in the PLY; colour is 0.5 + SH_C0 f_dc.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from codec.arrays import Doubles, Floats
from codec.errors import CorruptError, UnsupportedError
from codec.splats import MAX_SH_DEGREE, SH_C0, Splats, sh_count

from .bounds import MAX_GAUSSIANS, Decoded, byte_logits, check_count, restore_largest
from .notes import ANTIALIASED, FLAT, notes, tell_model

MAX_HEADER_BYTES = 1 << 16
"""Longest header read: one of 62 properties has about 1.5 KB."""

_TYPES = {
    **dict.fromkeys(("char", "int8"), "<i1"),
    **dict.fromkeys(("uchar", "uint8"), "<u1"),
    **dict.fromkeys(("short", "int16"), "<i2"),
    **dict.fromkeys(("ushort", "uint16"), "<u2"),
    **dict.fromkeys(("int", "int32"), "<i4"),
    **dict.fromkeys(("uint", "uint32"), "<u4"),
    **dict.fromkeys(("float", "float32"), "<f4"),
    **dict.fromkeys(("double", "float64"), "<f8"),
}
_END = b"end_header"
BINARY, TEXT = "binary_little_endian", "ascii"


@dataclass(frozen=True, slots=True)
class PlyElement:
    """A table of `count` rows that starts `offset` bytes into the file."""

    name: str
    count: int
    offset: int
    dtype: np.dtype[np.void]

    @property
    def properties(self) -> tuple[str, ...]:
        return self.dtype.names or ()

    @property
    def end(self) -> int:
        """Where the rows end, as an offset into the file."""
        return self.offset + self.count * self.dtype.itemsize

    def check_size(self, file_bytes: int) -> None:
        """Raises CorruptError if a file of `file_bytes` ends before the rows do."""
        if file_bytes < self.end:
            raise CorruptError(
                f"PLY: ends after {file_bytes} bytes; the {self.count} rows of {self.name[:40]} "
                f"need {self.end}"
            )

    def rows(self, data: bytes) -> npt.NDArray[np.void]:
        """(count,) structured rows, a view into `data`. Raises CorruptError if they are cut off."""
        if not self.properties:
            raise CorruptError(f"PLY: element {self.name[:40]} has no properties")
        self.check_size(len(data))
        return np.frombuffer(data, self.dtype, self.count, self.offset)


@dataclass(frozen=True, slots=True)
class PlyHeader:
    """Elements and properties of the header; the counts are claims."""

    layout: str
    """How the rows are written: BINARY, TEXT, or what else it says."""
    tables: dict[str, PlyElement]
    """The elements before the first with a list, by name and in order. Where they begin is right
    for binary rows, and for the first of all in any layout."""
    has_list: bool
    """Whether there is a list. Its rows have lengths of their own, so nothing behind it has a fixed
    place."""
    comments: tuple[str, ...] = ()
    """The text of each comment."""

    def check_rows(self) -> None:
        """Raises CorruptError, or UnsupportedError, if the rows cannot be read as arrays."""
        for element in self.tables.values():
            check_count("PLY", element.count)
        if self.has_list:
            raise UnsupportedError("PLY: a list among the properties; this is a mesh")
        if self.layout != BINARY:
            raise UnsupportedError(f"PLY: format {self.layout[:40]!r}; this program reads {BINARY}")


def _header_lines(data: bytes) -> tuple[list[str], int]:
    """The lines up to end_header, and how many bytes they take."""
    head = data[:MAX_HEADER_BYTES]
    # Old programs end lines with \r alone.
    newline = b"\n" if b"\n" in head.partition(_END)[0] else b"\r"
    if head.partition(newline)[0].split() != [b"ply"]:
        raise CorruptError("PLY: does not start with a line `ply`")
    at = head.find(newline + _END)
    end = head.find(newline, at + 1) if at >= 0 else -1
    if end < 0:
        raise CorruptError(f"PLY: no end_header in the first {len(head)} bytes")
    try:
        lines = head[:end].decode("utf-8").split(newline.decode())
    except UnicodeDecodeError as error:
        raise CorruptError("PLY: the header is not text") from error
    if lines[-1].strip() != _END.decode():
        raise CorruptError(f"PLY: header line {lines[-1][:40]!r}")
    return lines[1:-1], end + 1


def _count(text: str, name: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) <= 18):
        raise CorruptError(f"PLY: element {name[:40]} has {text[:40]!r} rows, which is not a count")
    return int(text)


def read_ply_header(data: bytes) -> PlyHeader:
    """The header of the PLY file that begins with `data`, of which MAX_HEADER_BYTES are looked at.

    Raises CorruptError.
    """
    lines, offset = _header_lines(data)
    layout = "none"
    first_list: int | None = None
    found: list[tuple[str, int, list[tuple[str, str]]]] = []
    comments: list[str] = []
    for line in lines:
        match line.split():
            case ["comment", *words]:
                comments.append(" ".join(words))
            case [] | ["obj_info", *_]:
                pass
            case ["format", kind, *_]:
                layout = kind
            case ["element", name, rows]:
                found.append((name, _count(rows, name), []))
            case ["property", "list", *_] if found:
                first_list = len(found) - 1 if first_list is None else first_list
            case ["property", kind, name] if found and kind in _TYPES:
                found[-1][2].append((name, _TYPES[kind]))
            case _:
                raise CorruptError(f"PLY: header line {line[:40]!r}")
    tables: dict[str, PlyElement] = {}
    for name, count, properties in found:
        try:
            dtype = np.dtype(properties)
        except ValueError as error:
            raise CorruptError(f"PLY: element {name[:40]} names a property twice") from error
        if name in tables:
            raise CorruptError(f"PLY: two elements are called {name[:40]}")
        tables[name] = PlyElement(name, count, offset, dtype)
        offset += count * dtype.itemsize
    before_list = dict(list(tables.items())[:first_list])
    return PlyHeader(layout, before_list, first_list is not None, tuple(comments))


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


CHUNK_GAUSSIANS = 256
AXES, SCALES, COLOURS = ("x", "y", "z"), ("scale_x", "scale_y", "scale_z"), ("r", "g", "b")
PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")

Words = npt.NDArray[np.uint32]


def is_compressed(header: PlyHeader) -> bool:
    """Whether a PLY with this header is of this layout."""
    vertex = header.tables.get("vertex")
    return "chunk" in header.tables and vertex is not None and PACKED[0] in vertex.properties


def _unpack(words: Words, *widths: int) -> Doubles:
    """(N, len(widths)) numbers 0..1 of bit fields, highest bits first."""
    fields = np.empty((len(words), len(widths)))
    shift = sum(widths)
    for i, width in enumerate(widths):
        shift -= width
        top = (1 << width) - 1
        fields[:, i] = (words >> np.uint32(shift) & np.uint32(top)) / top
    return fields


def _bounds(chunks: npt.NDArray[np.void], count: int, suffixes: tuple[str, ...]) -> Doubles:
    """(2, N, 3) the lower and upper bounds of each Gaussian's chunk."""
    corners = np.stack(
        [
            np.stack([chunks[f"{end}_{suffix}"].astype(np.float64) for suffix in suffixes], 1)
            for end in ("min", "max")
        ]
    )
    repeated: Doubles = np.repeat(corners, CHUNK_GAUSSIANS, axis=1)[:, :count]
    return repeated


def _between(bounds: Doubles, shares: Doubles) -> Doubles:
    between: Doubles = bounds[0] * (1 - shares) + bounds[1] * shares
    return between


def _rest_names(sh: PlyElement | None, count: int) -> list[str]:
    """The properties of `sh`, in order; none without it."""
    if sh is None:
        return []
    names = rest_names(sh.properties)
    if sh.count != count or any(sh.dtype[name] != np.uint8 for name in names):
        raise CorruptError(f"PLY: element sh is not {count} rows of uchar")
    return names


@dataclass(frozen=True, slots=True)
class CompressedLayout:
    """Where in a compressed PLY the Gaussians are."""

    chunk: PlyElement
    vertex: PlyElement
    sh: PlyElement | None
    rest: list[str]
    """The properties of `sh`, in order."""
    model: str
    """How the Gaussians were trained; see `tell_model`."""


def compressed_layout(
    head: bytes, file_bytes: int, max_gaussians: int = MAX_GAUSSIANS
) -> CompressedLayout:
    """The layout of the Gaussians, by the header of a compressed PLY of `file_bytes` in all.

    Raises CorruptError, or UnsupportedError, also for more than `max_gaussians`.
    """
    header = read_ply_header(head)
    header.check_rows()
    elements = header.tables
    if not is_compressed(header):
        raise UnsupportedError(
            "PLY: not compressed; a compressed PLY has elements chunk and packed_position"
        )
    chunk, vertex, sh = elements["chunk"], elements["vertex"], elements.get("sh")
    count = check_count("PLY", vertex.count, max_gaussians)
    if chunk.count != -(-count // CHUNK_GAUSSIANS):
        raise CorruptError(f"PLY: {chunk.count} chunks for {count} Gaussians")
    wanted = [f"{end}_{suffix}" for end in ("min", "max") for suffix in (*AXES, *SCALES)]
    missing = [name for name in wanted if name not in chunk.properties]
    missing += [name for name in PACKED if name not in vertex.properties]
    if missing:
        raise CorruptError(f"PLY: no property {', '.join(missing[:4])}")
    if any(vertex.dtype[name] != np.uint32 for name in PACKED):
        raise CorruptError("PLY: a packed property is not uint")
    rest = _rest_names(sh, count)
    for element in (chunk, vertex, *([] if sh is None else [sh])):
        element.check_size(file_bytes)
    return CompressedLayout(chunk, vertex, sh, rest, trained_as(header))


def decode_compressed_ply(data: bytes, max_gaussians: int = MAX_GAUSSIANS) -> Splats:
    """The Gaussians of a compressed PLY.

    Raises CorruptError, or UnsupportedError, also for more than `max_gaussians`.
    """
    layout = compressed_layout(data, len(data), max_gaussians)
    tell_model(layout.model)
    chunks, packed = layout.chunk.rows(data), layout.vertex.rows(data)
    made = Decoded.empty(layout.vertex.count, REST_COUNTS[len(layout.rest)])
    tints = [f"{end}_{colour}" for end in ("min", "max") for colour in COLOURS]
    tinted = all(name in layout.chunk.properties for name in tints)
    for block in made.blocks():
        rows, size = packed[block], block.stop - block.start
        bounds = chunks[block.start // CHUNK_GAUSSIANS : -(-block.stop // CHUNK_GAUSSIANS)]
        position, rotation, scale, colour = (rows[name].astype(np.uint32) for name in PACKED)
        rgb = _unpack(colour, 8, 8, 8, 8)[:, :3]
        three = (_unpack(rotation, 2, 10, 10, 10)[:, 1:] - 0.5) * np.sqrt(2.0)
        with np.errstate(all="ignore"):  # infinities and NaN are refused below
            if tinted:
                rgb = _between(_bounds(bounds, size, COLOURS), rgb)
            made.means[block] = _between(_bounds(bounds, size, AXES), _unpack(position, 11, 10, 11))
            made.log_scales[block] = _between(
                _bounds(bounds, size, SCALES), _unpack(scale, 11, 10, 11)
            )
            made.sh[block, 0] = (rgb - 0.5) / SH_C0
            made.quats[block] = restore_largest(three, rotation >> np.uint32(30))
        made.logit_opacities[block] = byte_logits((colour & np.uint32(255)).astype(np.uint8))
    if layout.sh is not None:
        harmonics = layout.sh.rows(data)
        for i, name in enumerate(layout.rest):
            channel, coefficient = divmod(i, len(layout.rest) // 3)
            levels = harmonics[name] * np.float32(8 / 255) - np.float32(4)
            made.sh[:, 1 + coefficient, channel] = levels
    return made.checked("PLY")
