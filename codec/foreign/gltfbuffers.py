"""The numbers of a glTF file: buffers, views of them, accessors (glTF 2.0, section 3.6).

A .glb is a header, a chunk of JSON and a chunk of bytes, which is the first buffer. A .gltf is the
JSON by itself; its buffers are data URIs, or files beside it.
"""

from __future__ import annotations

import base64
import re
import struct
import urllib.parse
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from codec.arrays import Floats
from codec.errors import CorruptError, UnsupportedError

from .jsonfields import MAX_JSON_BYTES, Fields
from .modelfolder import is_plain_name

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
