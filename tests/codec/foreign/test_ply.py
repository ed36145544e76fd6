"""PLY and compressed PLY: headers, handmade bytes, round trips."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings

from codec.errors import CodecError, CorruptError, UnsupportedError
from codec.foreign.ply import (
    BINARY,
    MAX_HEADER_BYTES,
    TEXT,
    decode_ply,
    encode_ply,
    read_ply_header,
)
from codec.interop.formats import decode_any
from codec.splats import SH_C0, Splats
from tests.support.drawn import drawn_splats, same_splats
from tests.support.hostile import refused
from tests.support.trained_like import trained_like_splats


def header(*elements: str, layout: str = "binary_little_endian") -> bytes:
    return "\n".join(["ply", f"format {layout} 1.0", *elements, "end_header", ""]).encode()


Columns = dict[str, np.ndarray[Any, Any]]


def floats(*names: str) -> list[str]:
    return [f"property float {name}" for name in names]


REQUIRED = (
    *("x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"),
    *("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
)


GAUSSIANS = ("element vertex 0", *floats(*REQUIRED))


def with_rest(count: int) -> bytes:
    return header(*GAUSSIANS, *floats(*(f"f_rest_{i}" for i in range(count))))


@given(drawn_splats(position=1e30, log_scale=(-80, 80), logit=80, harmonic=1e20))
@settings(max_examples=60, deadline=None)
def test_ply_gives_back_every_bit(splats: Splats) -> None:
    assert same_splats(decode_any(encode_ply(splats)), splats)


def test_ply_is_written_in_the_order_of_the_reference_implementation() -> None:
    splats = Splats(
        np.array([[1, 2, 3]], np.float32),
        np.array([[4, 5, 6]], np.float32),
        np.array([[7, 8, 9, 10]], np.float32),
        np.array([11], np.float32),
        # coefficient k of channel c is 100 k + c
        (100 * np.arange(4)[:, None] + np.arange(3)).astype(np.float32)[None],
    )
    names = [
        *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"),
        *(f"f_rest_{i}" for i in range(9)),
        *("opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
    ]
    values = [1, 2, 3, 0, 0, 0, 0, 1, 2]
    values += [100, 200, 300, 101, 201, 301, 102, 202, 302]
    values += [11, 4, 5, 6, 7, 8, 9, 10]
    expected = header("element vertex 1", *floats(*names)) + struct.pack("<26f", *values)
    assert encode_ply(splats) == expected
    assert same_splats(decode_ply(expected), splats)


def test_ply_goes_by_name_whatever_else_there_is() -> None:
    names = list(reversed(REQUIRED))
    data = header(
        "comment hand-made",
        "element camera 2",
        "property uchar kind",
        "property double focal",
        "element vertex 2",
        "property uchar red",
        *(f"property double {name}" for name in names),
        "element face 0",
        "property uint first",
    )
    data += bytes(2 * 9)
    data += struct.pack("<B14d", 255, *range(1, 15)) + struct.pack("<B14d", 255, *range(21, 35))
    splats = decode_ply(data.replace(b"\n", b"\r\n", 3))
    assert len(splats) == 2
    assert splats.means.tolist() == [[14, 13, 12], [34, 33, 32]]
    assert splats.sh.tolist() == [[[11, 10, 9]], [[31, 30, 29]]]
    assert splats.logit_opacities.tolist() == [8, 28]
    assert splats.log_scales[0].tolist() == [7, 6, 5]
    assert splats.quats[0].tolist() == [4, 3, 2, 1]


@pytest.mark.parametrize(
    ("data", "kind", "says"),
    [
        (header(*GAUSSIANS, layout="ascii"), UnsupportedError, "ascii"),
        (header(*GAUSSIANS, layout="binary_big_endian"), UnsupportedError, "big_endian"),
        (header("element face 0"), CorruptError, "no element vertex"),
        (header("element vertex 3", *floats("x", "y", "z")), CorruptError, "are points"),
        (header("element vertex 3", *floats("x"), layout="ascii"), CorruptError, "are points"),
        (header(*GAUSSIANS[:-1]), CorruptError, "no property rot_3$"),
        (header(*GAUSSIANS[:4], *GAUSSIANS[5:]), CorruptError, "no property f_dc_0$"),
        (header("element vertex 16777217"), CorruptError, "at most 16777216"),
        (header("element vertex 16777216", *floats(*REQUIRED)), CorruptError, "ends after"),
        (header("element vertex 1", "property list uchar int i"), UnsupportedError, "list"),
        (with_rest(1), UnsupportedError, "1 properties f_rest"),
        (with_rest(72), UnsupportedError, "72 properties f_rest"),
    ],
)
def test_a_bad_ply_is_refused(data: bytes, kind: type[CodecError], says: str) -> None:
    refused(kind, says, decode_ply, data)


def test_infinite_logits_are_nearly_transparent_and_opaque() -> None:
    splats = trained_like_splats(3)
    data = bytearray(encode_ply(splats))
    row_bytes = 17 * 4
    at = 9 * 4  # opacity: after position, normal and colour
    for row, logit in ((1, np.inf), (2, -np.inf)):
        struct.pack_into("<f", data, len(data) - (3 - row) * row_bytes + at, logit)
    logits = decode_ply(bytes(data)).logit_opacities
    assert logits.tolist() == [splats.logit_opacities[0], 16.0, -16.0]


def test_a_few_that_are_not_finite_are_left_out(caplog: pytest.LogCaptureFixture) -> None:
    splats = trained_like_splats(5)
    data = bytearray(encode_ply(splats))
    data[-3 * 17 * 4 : -3 * 17 * 4 + 4] = struct.pack("<f", -np.inf)  # x of the third of five
    # A signalling NaN, of which numpy warns in every operation.
    data[-16:] = bytes([1, 0, 0xA0, 0x7F]) * 4
    assert same_splats(decode_ply(bytes(data)), splats.take(np.array([0, 1, 3])))
    assert "left out: 2 of 5 Gaussians, the first is number 2;" in caplog.text
    data[-68:-64] = bytes([0, 0, 0xC0, 0x7F])
    data[-136:-132] = bytes([0, 0, 0xC0, 0x7F])
    refused(CorruptError, r"3 of 5 Gaussians, the first is number 2\)", decode_ply, bytes(data))
    data = bytearray(encode_ply(splats.take(slice(0, 1))))
    data[-16:] = bytes(16)
    refused(CorruptError, "zero quaternion", decode_ply, bytes(data))


def table(columns: Columns, *comments: str) -> bytes:
    """A PLY of these columns."""
    kinds = [(name, column.dtype) for name, column in columns.items()]
    rows = np.array(list(zip(*columns.values(), strict=True)), kinds)
    types = {"<f4": "float", "<f8": "double", "|u1": "uchar"}
    lines = [f"property {types[column.dtype.str]} {name}" for name, column in columns.items()]
    start = (*(f"comment {text}" for text in comments), f"element vertex {len(rows)}")
    return header(*start, *lines) + rows.tobytes()


ROWS: Columns = dict(
    zip(REQUIRED, np.random.default_rng(0).normal(size=(14, 6)).astype("<f4"), strict=True)
)


def test_what_other_trainers_write(caplog: pytest.LogCaptureFixture) -> None:
    plain = decode_ply(table(ROWS))
    # Without the third size: 2D Gaussians.
    flat = decode_ply(table({n: column for n, column in ROWS.items() if n != "scale_2"}))
    assert (flat.log_scales[:, :2] == plain.log_scales[:, :2]).all()
    assert (flat.log_scales[:, 2] < plain.log_scales[:, :2].min(axis=1) - 4).all()
    assert "2D Gaussians (two sizes) are read as flat ones" in caplog.text
    tints = {f"f_dc_{i}": name for i, name in enumerate(("red", "green", "blue"))}
    named = {tints.get(name, name): column for name, column in ROWS.items()}
    dyed = {name: np.full(6, 51 * n, np.uint8) for n, name in enumerate(tints.values())}
    tinted = decode_ply(table(named | dyed))
    assert 0.5 + SH_C0 * tinted.sh[:, 0] == pytest.approx(np.tile([0, 0.2, 0.4], (6, 1)), abs=1e-6)
    # A filter that the sizes lack.
    widened = decode_ply(table(ROWS | {"filter_3D": np.full(6, 0.5, "<f4")}))
    sizes, wider = np.exp(plain.log_scales), np.sqrt(np.exp(2 * plain.log_scales) + 0.25)
    assert np.exp(widened.log_scales) == pytest.approx(wider, rel=1e-6)
    kept = plain.opacities * sizes.prod(axis=1) / wider.prod(axis=1)
    assert widened.opacities == pytest.approx(kept, rel=1e-5)
    # Positions of a survey, in doubles.
    offsets = {"x": 448_250.0, "y": 5_411_932.0, "z": 0.0}
    far = {name: ROWS[name].astype("<f8") + offset for name, offset in offsets.items()}
    means = decode_ply(table(ROWS | far)).means
    assert means - means[0] == pytest.approx(plain.means - plain.means[0], abs=1e-4)
    assert "(448000, 5412000, 0) m is taken away" in caplog.text
    decode_ply(table(ROWS | {f"scale_{i}": np.full(6, 0.01 + i, "<f4") for i in range(2)}))
    assert "they look like metres" not in caplog.text
    decode_ply(table(ROWS | {f"scale_{i}": np.full(6, 0.01 + i / 9, "<f4") for i in range(3)}))
    assert "they look like metres" in caplog.text


@pytest.mark.parametrize(
    ("comments", "says"),
    [
        (("SplatRenderMode: mip",), "opacity compensation"),
        (("antialiased 1",), "opacity compensation"),
        (("antialiased 1", "SplatRenderMode: default"), None),
        (("antialiased 0",), None),
        (("SplatRenderMode: 2dgs",), "2D Gaussians"),
        (("SplatRenderMode: new",), "trained as 'new', which is not known"),
    ],
)
def test_how_it_was_trained(
    comments: tuple[str, ...], says: str | None, caplog: pytest.LogCaptureFixture
) -> None:
    lines = "".join(f"comment {text}\n" for text in comments)
    for data in (table(ROWS, *comments), compressed().replace(b"el", lines.encode() + b"el", 1)):
        caplog.clear()
        decode_any(data)
        assert (says or "") in caplog.text
        assert len(caplog.messages) == (says is not None)


CHUNK = [
    *("min_x", "min_y", "min_z", "max_x", "max_y", "max_z"),
    *("min_scale_x", "min_scale_y", "min_scale_z", "max_scale_x", "max_scale_y", "max_scale_z"),
]
TINTS = ["min_r", "min_g", "min_b", "max_r", "max_g", "max_b"]
PACKED = [f"property uint packed_{name}" for name in ("position", "rotation", "scale", "color")]


def compressed(tints: bool = True, harmonics: int = 0, num_chunks: int = 1) -> bytes:
    """Two Gaussians; x -1..1, y 0..10, z 5..5, ln s -8..0, tints 0..1 or -1..3."""
    data = header(
        f"element chunk {num_chunks}",
        *floats(*CHUNK, *(TINTS if tints else [])),
        "element vertex 2",
        *PACKED,
        *(["element sh 2"] if harmonics else []),
        *(f"property uchar f_rest_{i}" for i in range(harmonics)),
    )
    bounds = [-1, 0, 5, 1, 10, 5, -8, -8, -8, 0, 0, 0, *([-1] * 3 + [3] * 3 if tints else [])]
    data += struct.pack(f"<{len(bounds)}f", *bounds) * num_chunks
    # x lowest, y highest, z in between; w largest and x = 1/sqrt(2) (code 1023), y, z about 0
    data += struct.pack(
        "<4I",
        0 << 21 | 1023 << 11 | 1024,
        0 << 30 | 1023 << 20 | 511 << 10 | 512,
        2047 << 21 | 0 << 11 | 2047,
        255 << 24 | 0 << 16 | 51 << 8 | 102,
    )
    # y (2) is left out: w, x, z follow
    data += struct.pack("<4I", 2047 << 21, 2 << 30 | 0 << 20 | 512 << 10 | 511, 0, 255)
    return data + bytes(range(2 * harmonics))


def test_compressed_ply_without_tints_and_with_harmonics() -> None:
    splats = decode_any(compressed(tints=False, harmonics=24))
    assert splats.sh.shape == (2, 9, 3)
    assert 0.5 + SH_C0 * splats.sh[0, 0] == pytest.approx([1, 0, 0.2], abs=1e-6)
    # Gaussian 1, green (second of three blocks of eight), coefficient 3 above degree 0
    assert splats.sh[1, 3, 1] == pytest.approx((24 + 8 + 2) * 8 / 255 - 4, abs=1e-6)


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (compressed(num_chunks=2), "2 chunks for 2"),
        (compressed()[:-1], "ends after"),
        (compressed(harmonics=9)[:-1], "ends after"),
        (compressed().replace(b"float max_scale_z", b"float max_other_z"), "max_scale_z"),
        (compressed().replace(b"uint packed_color", b"float packed_color"), "not uint"),
        (compressed(harmonics=9).replace(b"sh 2", b"sh 1"), "not 2 rows"),
        (compressed(harmonics=9).replace(b"uchar f_rest_4", b"ushort f_rest_4"), "of uchar"),
    ],
)
def test_a_bad_compressed_ply_is_refused_with_the_reason(data: bytes, says: str) -> None:
    refused(CorruptError, says, decode_any, data)


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
    for read in (read_ply_header, decode_ply):
        refused(CorruptError, says, read, text.encode("utf-8", "surrogateescape"))
