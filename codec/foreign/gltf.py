"""glTF 2.0 with KHR_gaussian_splatting (ratified 2026), .glb and .gltf, in and out.

A primitive of points with the extension is a set of Gaussians. Its attributes:

    POSITION                          VEC3
    KHR_gaussian_splatting:ROTATION   VEC4    unit quaternion x, y, z, w
                          :SCALE      VEC3    standard deviations, linear
                          :OPACITY    SCALAR  0..1
                          :SH_DEGREE_d_COEF_n VEC3, RGB, all n of 0 .. 2 d; degree 0 at least
    COLOR_0                           VEC4    for programs that show points; not read

Frame: y up; a model faces +z. That is the PLY's RDF after half a turn about z, which is how other
writers have it. Nodes may move, turn, mirror and scale evenly what they hold. In drafts SCALE
was a logarithm: a value below 0, which is not allowed now, gives such a file away.

KHR_gaussian_splatting_compression_spz and .._spz_2 (drafts) put an SPZ file in the place of the
attributes; they are read, not written.

Numbers lie in buffers, views of them and accessors (glTF 2.0, section 3.6). A .glb is a header, a
chunk of JSON and a chunk of bytes, which is the first buffer. A .gltf is the JSON by itself; its
buffers are data URIs, or files beside it.
"""

from __future__ import annotations

import base64
import json
import re
import struct
import urllib.parse
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from codec.arrays import Doubles, Floats
from codec.camera import rotation_of
from codec.errors import CorruptError, InvalidError, UnsupportedError
from codec.similarity import Similarity, half_turned
from codec.splats import MAX_SH_DEGREE, SH_C0, Splats, sh_count

from .bounds import (
    MAX_GAUSSIANS,
    check_count,
    check_ratio,
    clipped_bytes,
    opacity_bytes,
    unit_quats,
    whole_rows,
)
from .jsonfields import MAX_JSON_BYTES, Fields
from .modelfolder import is_plain_name
from .notes import notes
from .ply import SURE_LOGIT
from .splat import LARGEST_SCALE, SMALLEST_SCALE
from .spz import decode_spz, spz_header

MAGIC = b"glTF"
SPACE = b"\xef\xbb\xbf \t\r\n"
"""Bytes that may stand before JSON, a byte order mark included."""
HEADER = struct.Struct("<4sII")
CHUNK = struct.Struct("<I4s")
JSON_CHUNK, BIN_CHUNK = b"JSON", b"BIN\0"
GLB_VERSION = 2
MOST = 1 << 53
"""Largest whole number of JSON that every program reads alike."""

COMPONENTS: dict[int, np.dtype[Any]] = {
    5120: np.dtype("<i1"),
    5121: np.dtype("<u1"),
    5122: np.dtype("<i2"),
    5123: np.dtype("<u2"),
    5125: np.dtype("<u4"),
    5126: np.dtype("<f4"),
}
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
MAX_STRIDE = 252
_DATA_URI = re.compile(rb'"data:[\w/.+-]*;base64,([A-Za-z0-9+/=]*)"')

Beside = Callable[[str], bytes]
"""Gives the bytes of the file of a name, without a folder, that lies beside the one that is read.
Raises a CodecError."""


def nothing_beside(name: str) -> bytes:
    """For a file that has no place: it has no other beside it."""
    raise CorruptError(f"glTF: its buffer is in another file, {name[:40]!r}, which is not given")


def split_glb(data: bytes) -> tuple[bytes, memoryview]:
    """The JSON and the bytes of a .glb; no bytes if it has one chunk only. Raises CorruptError, or
    UnsupportedError."""
    if len(data) < HEADER.size:
        raise CorruptError("glTF: ends inside its header")
    _, version, file_bytes = HEADER.unpack_from(data)
    if version != GLB_VERSION:
        raise UnsupportedError(f"glTF: a container of version {version}, not {GLB_VERSION}")
    if file_bytes > len(data):
        raise CorruptError(f"glTF: ends after {len(data)} bytes of {file_bytes}")
    chunks = []
    at = HEADER.size
    for kind in (JSON_CHUNK, BIN_CHUNK):
        if at + CHUNK.size > file_bytes:
            break
        size, found = CHUNK.unpack_from(data, at)
        at += CHUNK.size
        if found != kind or size > file_bytes - at:
            raise CorruptError(f"glTF: the chunk {kind.decode()[:4]!r} is missing or cut off")
        chunks.append(memoryview(data)[at : at + size])
        at += size
    if not chunks:
        raise CorruptError("glTF: has no JSON")
    return bytes(chunks[0]), chunks[1] if len(chunks) > 1 else memoryview(b"")


def join_glb(text: bytes, chunk: bytes) -> bytes:
    """The .glb of some JSON and the bytes of the first buffer."""
    text += b" " * (-len(text) % 4)
    chunk += bytes(-len(chunk) % 4)
    parts = [CHUNK.pack(len(text), JSON_CHUNK), text]
    if chunk:
        parts += [CHUNK.pack(len(chunk), BIN_CHUNK), chunk]
    size = HEADER.size + sum(map(len, parts))
    return b"".join([HEADER.pack(MAGIC, GLB_VERSION, size), *parts])


def is_gltf(head: bytes) -> bool:
    """Whether a file that begins with `head` may be a .glb or .gltf."""
    return head.startswith(MAGIC) or head.lstrip(SPACE).startswith(b"{")


def check_glb(head: bytes, file_bytes: int) -> None:
    """Raises CorruptError for a .glb of `file_bytes` whose JSON is cut off or too long to parse."""
    if head.startswith(MAGIC) and len(head) >= HEADER.size + CHUNK.size:
        size, _ = CHUNK.unpack_from(head, HEADER.size)
        if size > min(MAX_JSON_BYTES, file_bytes - HEADER.size - CHUNK.size):
            raise CorruptError(f"glTF: {size} bytes of JSON in a file of {file_bytes}")


@dataclass(slots=True)
class Document:
    """A glTF file: its JSON, and its numbers when they are asked for."""

    root: Fields
    _chunk: memoryview
    _payloads: list[bytes]
    """The base64 of data URIs, taken out before the JSON is parsed: it is short then."""
    _beside: Beside
    _loaded: dict[int, memoryview] = field(default_factory=dict)

    @staticmethod
    def read(data: bytes, beside: Beside) -> Document:
        """The document of a .glb or .gltf. Raises CorruptError, or UnsupportedError."""
        chunk, payloads = memoryview(b""), list[bytes]()
        if data.startswith(MAGIC):
            text, chunk = split_glb(data)
        else:

            def taken(found: re.Match[bytes]) -> bytes:
                payloads.append(found[1])
                return b'"data:#%d"' % (len(payloads) - 1)

            text = _DATA_URI.sub(taken, data)
        return Document(Fields.parse(text, "glTF"), chunk, payloads, beside)

    @property
    def num_bytes(self) -> int:
        """Size of the numbers that are loaded so far."""
        return len(self._chunk) + sum(map(len, self._loaded.values()))

    def _buffer(self, index: int) -> memoryview:
        if index not in self._loaded:
            fields = self.root.item("buffers", index)
            size = fields.integer("byteLength", most=MOST)
            content = self._content(fields, index)
            if len(content) < size:
                raise CorruptError(f"{fields.where}: {len(content)} bytes of {size}")
            self._loaded[index] = content[:size]
        return self._loaded[index]

    def _content(self, fields: Fields, index: int) -> memoryview:
        if "uri" not in fields:
            if index:
                raise CorruptError(f"{fields.where}: has no uri")
            return self._chunk
        uri = fields.text("uri")
        if uri.startswith("data:"):
            return memoryview(self._decoded(uri, fields.where))
        name = urllib.parse.unquote(uri)
        if not is_plain_name(name):
            raise UnsupportedError(
                f"{fields.where}: {uri[:40]!r} is not the name of a file beside this one"
            )
        return memoryview(self._beside(name))

    def _decoded(self, uri: str, where: str) -> bytes:
        place = re.fullmatch(r"data:#(\d{1,9})", uri)
        encoded: str | bytes = uri.partition(",")[2]
        if place is not None and int(place[1]) < len(self._payloads):
            encoded = self._payloads[int(place[1])]
        try:
            return base64.b64decode(encoded, validate=True)
        except ValueError as error:
            raise CorruptError(f"{where}: the data URI is not base64") from error

    def view(self, index: int) -> tuple[memoryview, int]:
        """The bytes of a buffer view, and how many lie between two rows; 0 if they are packed.

        Raises CorruptError, or UnsupportedError for a view that an extension replaces.
        """
        fields = self.root.item("bufferViews", index)
        if "extensions" in fields:
            names = ", ".join(fields.fields("extensions").values)[:80]
            raise UnsupportedError(f"{fields.where}: is packed by {names!r}")
        buffer = self._buffer(fields.integer("buffer", most=MOST))
        start = fields.integer("byteOffset", 0, most=MOST)
        size = fields.integer("byteLength", most=MOST)
        if start + size > len(buffer):
            raise CorruptError(f"{fields.where}: ends at {start + size} of {len(buffer)} bytes")
        return buffer[start : start + size], fields.integer("byteStride", 0, most=MAX_STRIDE)

    def _rows(self, index: int, kind: str) -> npt.NDArray[Any]:
        """(count, width of `kind`) numbers as they are in the buffer, a view of it."""
        fields = self.root.item("accessors", index)
        if "sparse" in fields or "bufferView" not in fields:
            raise UnsupportedError(f"{fields.where}: is sparse or empty, which is not read here")
        if fields.text("type") != kind:
            raise CorruptError(f"{fields.where}: is {fields.text('type')[:20]!r}, not {kind}")
        component = COMPONENTS.get(fields.integer("componentType", most=MOST))
        if component is None:
            raise CorruptError(f"{fields.where}: has an unknown componentType")
        view, stride = self.view(fields.integer("bufferView", most=MOST))
        count, width = fields.integer("count", most=MOST), WIDTHS[kind]
        start = fields.integer("byteOffset", 0, most=MOST)
        row_bytes = width * component.itemsize
        stride = stride or row_bytes
        if stride < row_bytes or (count and start + stride * (count - 1) + row_bytes > len(view)):
            raise CorruptError(f"{fields.where}: reaches outside of its buffer view")
        if not count:
            return np.empty((0, width), component)
        return np.ndarray((count, width), component, view, start, (stride, component.itemsize))

    def count(self, index: int, kind: str) -> int:
        """The rows of an accessor, which are there. Raises as `accessor` does."""
        return len(self._rows(index, kind))

    def accessor(self, index: int, kind: str) -> Floats:
        """(count, width of `kind`) numbers, those that say so brought to 0..1 or -1..1.

        Raises CorruptError, also for rows outside of the view; or UnsupportedError.
        """
        rows = self._rows(index, kind)
        with np.errstate(invalid="ignore"):  # NaN is refused with the Gaussians that have it
            values = rows.astype(np.float32)
        if self.root.item("accessors", index).flag("normalized") and rows.dtype.kind != "f":
            values /= np.float32(np.iinfo(rows.dtype).max)
            np.maximum(values, -1, out=values)
        return values


EXTENSION = "KHR_gaussian_splatting"
SPZ_EXTENSIONS = (f"{EXTENSION}_compression_spz", f"{EXTENSION}_compression_spz_2")
KNOWN = (EXTENSION, *SPZ_EXTENSIONS, "KHR_mesh_quantization")
COLOUR_SPACE, LINEAR_COLOUR_SPACE = "srgb_rec709_display", "lin_rec709_display"
POINTS, TRIANGLES = 0, 4
MAX_NODES = 1 << 16
MAX_SHOWN = 1 << 16
"""Primitives that nodes show, Gaussians or not: a few of each can be named very often."""
MAX_SETS = 4096
"""Sets of Gaussians among them: each costs time, however small it is."""
MAX_GLB_BYTES = (1 << 32) - 1
PLAIN_BYTES = 56
"""Size of a Gaussian of SH degree 0 in memory."""
SPZ_HEAD_BYTES = 1 << 12
"""Bytes read of an SPZ file for its header."""


def _matrix(node: Fields) -> Doubles:
    """(4, 4) what a node does to what it holds."""
    if "matrix" in node:
        return np.array(node.numbers("matrix", 16)).reshape(4, 4).T
    matrix = np.eye(4)
    x, y, z, w = node.numbers("rotation", 4, (0, 0, 0, 1))
    scale = np.array(node.numbers("scale", 3, (1, 1, 1)))
    with np.errstate(all="ignore"):  # what is not finite is refused by Similarity
        matrix[:3, :3] = rotation_of(np.array([w, x, y, z])) * scale
    matrix[:3, 3] = node.numbers("translation", 3, (0, 0, 0))
    return matrix


def _children(node: Fields) -> list[int]:
    return node.integers("children", most=MOST)


def _roots(root: Fields) -> list[int]:
    """The nodes to begin with: those of the scene, or all that have no parent."""
    if root.size("scenes"):
        return root.item("scenes", root.integer("scene", 0, most=MOST)).integers("nodes", most=MOST)
    children = {child for node in root.items("nodes") for child in _children(node)}
    return [index for index in range(root.size("nodes")) if index not in children]


def _instances(root: Fields) -> Iterator[tuple[Fields, Doubles]]:
    """Each primitive that is shown, and the (4, 4) matrix from its frame to that of the scene."""
    num_nodes, num_shown = root.size("nodes"), 0
    if num_nodes > MAX_NODES:
        raise UnsupportedError(f"glTF: {num_nodes} nodes, at most {MAX_NODES}")
    waiting, seen = [(_roots(root), np.eye(4))], set[int]()
    while waiting:
        indices, above = waiting.pop()
        for index in indices:
            if index in seen:
                raise CorruptError(f"glTF.nodes[{index}]: appears twice in the node tree")
            seen.add(index)
            node = root.item("nodes", index)
            with np.errstate(all="ignore"):
                matrix = above @ _matrix(node)
            waiting.append((_children(node), matrix))
            if "mesh" in node:
                mesh = root.item("meshes", node.integer("mesh", most=MOST))
                num_shown += mesh.size("primitives")
                if num_shown > MAX_SHOWN:
                    raise UnsupportedError(f"glTF: more than {MAX_SHOWN} primitives are shown")
                yield from ((primitive, matrix) for primitive in mesh.items("primitives"))


class _Primitive:
    """A set of Gaussians in the document."""

    def __init__(self, document: Document, fields: Fields, matrix: Doubles) -> None:
        """Raises CorruptError, or UnsupportedError."""
        self._document, self._fields, self._matrix = document, fields, matrix
        self._where = fields.where
        about = fields.fields("extensions").fields(EXTENSION)
        kernel = about.text("kernel", "ellipse")
        if kernel != "ellipse":
            raise UnsupportedError(
                f"{fields.where}: kernel {kernel[:40]!r}; this program reads 'ellipse'"
            )
        if fields.integer("mode", TRIANGLES, most=MOST) != POINTS:
            raise CorruptError(f"{fields.where}: Gaussians must be points (mode {POINTS})")
        if about.text("colorSpace", COLOUR_SPACE) == LINEAR_COLOUR_SPACE:
            notes().say("has linear colours: shown as they are, they may look too dark")
        more = about.fields("extensions").values if "extensions" in about else {}
        packed = [name for name in SPZ_EXTENSIONS if name in more]
        if len(packed) < len(more):
            raise UnsupportedError(f"{fields.where}: extended by {', '.join(more)[:80]!r}")
        self._spz: memoryview | None = None
        if packed:
            view = about.fields("extensions").fields(packed[0]).integer("bufferView", most=MOST)
            self._spz, _ = document.view(view)
            self.count = spz_header(bytes(self._spz[:SPZ_HEAD_BYTES]), len(self._spz)).count
        else:
            self.count = document.count(self._accessor("POSITION"), "VEC3")

    def _accessor(self, name: str) -> int:
        return self._fields.fields("attributes").integer(name, most=MOST)

    def _values(self, name: str, kind: str) -> Floats:
        values = self._document.accessor(self._accessor(name), kind)
        if len(values) != self.count:
            raise CorruptError(f"{self._where}: {len(values)} rows of {name}, not {self.count}")
        return values

    def splats(self) -> Splats:
        """The Gaussians, in our frame. Raises a CodecError."""
        splats = self._plain() if self._spz is None else decode_spz(bytes(self._spz))
        if (self._matrix == np.eye(4)).all():
            return splats
        turn = np.diag([-1.0, -1.0, 1.0, 1.0])  # half a turn about z, from frame to frame and back
        with np.errstate(all="ignore"):  # what is not finite is refused by Similarity
            matrix = turn @ self._matrix @ turn
        try:
            return Similarity.of(matrix).moved(splats)
        except InvalidError as error:
            raise UnsupportedError(f"{self._where}: the node above: {error}") from error

    def _plain(self) -> Splats:
        means = self._values("POSITION", "VEC3")
        quats = self._values(f"{EXTENSION}:ROTATION", "VEC4")
        names = self._fields.fields("attributes").values
        degree = max(
            [d for d in range(MAX_SH_DEGREE + 2) if f"{EXTENSION}:SH_DEGREE_{d}_COEF_0" in names],
            default=0,
        )
        if degree > MAX_SH_DEGREE:
            raise UnsupportedError(f"{self._where}: SH degree {degree}, at most {MAX_SH_DEGREE}")
        sh = np.empty((self.count, sh_count(degree), 3), np.float32)
        for index, name in enumerate(_harmonic_names(degree)):
            sh[:, index] = self._values(name, "VEC3")
        with np.errstate(all="ignore"):  # NaN is refused here or below
            logits, log_scales = self._logits(), self._log_scales()
        splats = whole_rows(self._where, means, log_scales, quats[:, [3, 0, 1, 2]], logits, sh)
        return half_turned(splats, "z")

    def _logits(self) -> Floats:
        opacities = self._values(f"{EXTENSION}:OPACITY", "SCALAR")[:, 0].astype(np.float64)
        if not ((opacities >= 0) & (opacities <= 1)).all():
            raise CorruptError(f"{self._where}: an opacity outside of 0..1")
        logits = np.log(opacities) - np.log1p(-opacities)
        clipped: Floats = np.clip(logits, -SURE_LOGIT, SURE_LOGIT).astype(np.float32)
        return clipped

    def _log_scales(self) -> Floats:
        scales = self._values(f"{EXTENSION}:SCALE", "VEC3")
        if (scales < 0).any():
            notes().say("stores logarithms as SCALE, as drafts of its extension did")
            return scales
        # A flat Gaussian may have a scale of exactly 0, which has no logarithm.
        return np.log(np.maximum(scales, np.float32(SMALLEST_SCALE)))


def decode_gltf(
    data: bytes, max_gaussians: int = MAX_GAUSSIANS, beside: Beside = nothing_beside
) -> Splats:
    """All Gaussians of the scene of a .glb or .gltf; meshes beside them are passed over.

    Raises CorruptError, or UnsupportedError, also for more than `max_gaussians`, and for a node
    that stretches its Gaussians.
    """
    document = Document.read(data, beside)
    root = document.root
    strange = [name for name in root.texts("extensionsRequired") if name not in KNOWN]
    if strange:
        raise UnsupportedError(f"glTF: needs {', '.join(strange)[:80]!r}, which is not read here")
    primitives: list[_Primitive] = []
    count = 0
    for fields, matrix in _instances(root):
        if "extensions" not in fields or EXTENSION not in fields.fields("extensions"):
            continue
        if len(primitives) == MAX_SETS:
            raise UnsupportedError(f"glTF: more than {MAX_SETS} sets of Gaussians")
        primitives.append(_Primitive(document, fields, matrix))
        count = check_count("glTF", count + primitives[-1].count, max_gaussians)
    if not primitives and EXTENSION not in root.texts("extensionsUsed"):
        raise CorruptError(f"glTF: no Gaussians ({EXTENSION}); this is a mesh")
    check_ratio("glTF", PLAIN_BYTES * count, len(data) + document.num_bytes)
    parts = [primitive.splats() for primitive in primitives]
    degree = max((part.sh_degree for part in parts), default=0)
    return Splats.concatenate([part.with_degree(degree) for part in parts] or [Splats.empty()])


def _harmonic_names(sh_degree: int) -> list[str]:
    """The attributes of all coefficients, in our order, which is the specification's."""
    return [
        f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{n}"
        for degree in range(sh_degree + 1)
        for n in range(2 * degree + 1)
    ]


def _attributes(splats: Splats) -> dict[str, np.ndarray[Any, Any]]:
    """The tables of `splats`, turned to the frame of glTF, by the names of their attributes."""
    splats = half_turned(splats, "z")
    with np.errstate(over="ignore", under="ignore"):
        scales = np.exp(splats.log_scales.astype(np.float64))
    colours = clipped_bytes((0.5 + SH_C0 * splats.sh[:, 0].astype(np.float64)) * 255)
    tables: dict[str, np.ndarray[Any, Any]] = {
        "POSITION": splats.means,
        "COLOR_0": np.column_stack([colours, opacity_bytes(splats.opacities)]),
        f"{EXTENSION}:ROTATION": unit_quats(splats.quats)[:, [1, 2, 3, 0]].astype("<f4"),
        f"{EXTENSION}:SCALE": np.clip(scales, SMALLEST_SCALE, LARGEST_SCALE).astype("<f4"),
        f"{EXTENSION}:OPACITY": splats.opacities[:, None],
    }
    for index, name in enumerate(_harmonic_names(splats.sh_degree)):
        tables[name] = splats.sh[:, index]
    return tables


def _document(splats: Splats) -> tuple[dict[str, Any], bytes]:
    """The JSON of `splats`, but for where its buffer is, and the buffer."""
    root: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "swings"},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "Gaussians"}],
    }
    if not len(splats):  # glTF has no accessor without rows
        return root, b""
    views, accessors = list[Any](), list[Any]()
    parts, attributes = list[bytes](), dict[str, int]()
    offset = 0
    for name, table in _attributes(splats).items():
        data = np.ascontiguousarray(table).tobytes()
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": len(data), "target": 34962})
        accessor: dict[str, Any] = {"bufferView": len(accessors), "count": len(table)}
        accessor["componentType"] = 5121 if table.dtype == np.uint8 else 5126
        accessor["type"] = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[table.shape[1]]
        if name == "COLOR_0":
            accessor["normalized"] = True
        if name == "POSITION":
            accessor |= {"min": table.min(axis=0).tolist(), "max": table.max(axis=0).tolist()}
        attributes[name] = len(accessors)
        accessors.append(accessor)
        parts.append(data)
        offset += len(data)
    about = {"kernel": "ellipse", "colorSpace": COLOUR_SPACE}
    primitive = {"attributes": attributes, "mode": POINTS, "extensions": {EXTENSION: about}}
    root["nodes"][0]["mesh"] = 0
    root |= {"meshes": [{"primitives": [primitive]}], "accessors": accessors, "bufferViews": views}
    return root, b"".join(parts)


def _text(root: dict[str, Any], buffer: bytes, uri: str | None) -> bytes:
    if buffer:
        place = {} if uri is None else {"uri": uri}
        root["buffers"] = [{"byteLength": len(buffer)} | place]
    return json.dumps(root, separators=(",", ":"), allow_nan=False).encode()


def encode_glb(splats: Splats) -> bytes:
    """The .glb of `splats`: every number but opacities and sizes as it is, and these as float32.

    Raises InvalidError for more than 4 GB.
    """
    root, buffer = _document(splats)
    if len(buffer) > MAX_GLB_BYTES - (1 << 20):
        raise InvalidError(f"glTF: {len(buffer)} bytes; a .glb has at most {MAX_GLB_BYTES}")
    return join_glb(_text(root, buffer, None), buffer)


def encode_gltf(splats: Splats) -> bytes:
    """The .gltf of `splats`, which keeps its numbers in itself as a data URI: one file, a third
    larger than a .glb."""
    root, buffer = _document(splats)
    uri = "data:application/octet-stream;base64," + base64.b64encode(buffer).decode()
    return _text(root, buffer, uri)
