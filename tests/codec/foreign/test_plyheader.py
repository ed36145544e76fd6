"""Headers of PLY files in all variants that programs write."""

from __future__ import annotations

import pytest

from codec.errors import CorruptError
from codec.foreign.plyheader import (
    BINARY,
    MAX_HEADER_BYTES,
    TEXT,
    read_ply_elements,
    read_ply_header,
)

MESH = (
    "ply",
    f"format {TEXT} 1.0",
    "comment caf\u00e9",
    "element vertex 70000000",
    "property double x",
    "property uchar red",
    "element edge 5",
    "element face 2",
    "property uchar material",
    "property list uchar int vertex_indices",
    "element more 1",
    "property float quality",
    "end_header",
    "",
)


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
def test_a_mesh_has_tables_up_to_its_first_list(newline: str) -> None:
    data = newline.join(MESH).encode()
    bare = f"ply{newline}format {BINARY}{newline}end_header{newline}"  # without a version
    assert read_ply_header(bare.encode()).layout == BINARY
    header = read_ply_header(data + b"1 2\n3\n")
    assert (header.layout, header.has_list) == (TEXT, True)
    assert list(header.tables) == ["vertex", "edge"]
    vertex = header.tables["vertex"]
    assert vertex.properties == ("x", "red")
    assert (vertex.count, vertex.dtype.itemsize, vertex.offset) == (70_000_000, 9, len(data))
    assert header.tables["edge"].offset == vertex.end == len(data) + 9 * vertex.count


@pytest.mark.parametrize(
    ("before", "after", "says"),
    [
        ("ply", "plY", "does not start with a line `ply`"),
        ("caf\u00e9", "\udce9", "the header is not text"),
        ("vertex 7", "vertex 7e", "has '7e0000000' rows, which is not a count"),
        ("double x", "quad x", "header line 'property quad x'"),
        ("double x", "double x y", "header line 'property double x y'"),
        ("uchar red", "uchar x", "element vertex names a property twice"),
        ("element more", "element edge", "two elements are called edge"),
        ("element vertex 70000000\n", "", "header line 'property double x'"),
        ("comment", "remark", "header line 'remark"),
        ("end_header", "end_headers", "header line 'end_headers'"),
        ("comment", "comment " + MAX_HEADER_BYTES * "x", "no end_header in the first 65536 bytes"),
    ],
)
def test_a_bad_header_is_refused_with_the_reason(before: str, after: str, says: str) -> None:
    text = "\n".join(MESH).replace(before, after, 1)
    for read in (read_ply_header, read_ply_elements):
        with pytest.raises(CorruptError, match=says):
            read(text.encode("utf-8", "surrogateescape"))
