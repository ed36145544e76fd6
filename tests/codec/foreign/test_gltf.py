"""glTF: a handmade file, axes, nodes, places of its numbers, and hostile bytes."""

from __future__ import annotations

import base64
import copy
import json
import logging
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings

from codec.errors import CodecError, CorruptError, UnsupportedError
from codec.foreign.gltf import decode_gltf, encode_glb, encode_gltf, join_glb
from codec.foreign.spz import SpzVersion, decode_spz, encode_spz
from codec.interop.formats import decode_any, read_splats
from codec.splats import Splats
from tests.support.alike import shapes
from tests.support.drawn import angles_rad, drawn_splats, same_splats
from tests.support.hostile import refused, within_bytes
from tests.support.trained_like import trained_like_splats

Json = Any
KHR = "KHR_gaussian_splatting"
HALF = np.sqrt(0.5)

# Two Gaussians of SH degree 1, table by table.
TABLES: dict[str, tuple[str, list[list[float]]]] = {
    "POSITION": ("VEC3", [[1, 2, 3], [-4, 5, 6]]),
    f"{KHR}:ROTATION": ("VEC4", [[HALF, 0, 0, HALF], [0, 0, 0, 1]]),
    f"{KHR}:SCALE": ("VEC3", [[1, np.e, np.e**2], [0, 1, 1]]),
    f"{KHR}:OPACITY": ("SCALAR", [[0.5], [1]]),
    f"{KHR}:SH_DEGREE_0_COEF_0": ("VEC3", [[0.1, 0.2, 0.3], [0, 0, 0]]),
    f"{KHR}:SH_DEGREE_1_COEF_0": ("VEC3", [[1, 2, 3], [0, 0, 0]]),
    f"{KHR}:SH_DEGREE_1_COEF_1": ("VEC3", [[4, 5, 6], [0, 0, 0]]),
    f"{KHR}:SH_DEGREE_1_COEF_2": ("VEC3", [[7, 8, 9], [0, 0, 0]]),
}


def by_hand() -> tuple[Json, bytes]:
    """The JSON and the buffer of TABLES."""
    chunk, views, accessors = b"", list[Json](), list[Json]()
    for kind, rows in TABLES.values():
        data = np.array(rows, "<f4").tobytes()
        views.append({"buffer": 0, "byteOffset": len(chunk), "byteLength": len(data)})
        accessors.append({"bufferView": len(views) - 1, "componentType": 5126, "count": 2})
        accessors[-1]["type"] = kind
        chunk += data
    about = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
    primitive = {"mode": 0, "attributes": {name: i for i, name in enumerate(TABLES)}}
    root = {
        "asset": {"version": "2.0"},
        "extensionsUsed": [KHR],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive | {"extensions": {KHR: about}}]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(chunk)}],
    }
    return root, chunk


ROOT, CHUNK = by_hand()


def made(change: Callable[[Json], object] = lambda root: None, chunk: bytes = CHUNK) -> bytes:
    """The handmade .glb with a change of its JSON."""
    root = copy.deepcopy(ROOT)
    change(root)
    return join_glb(json.dumps(root).encode(), chunk)


def primitive(root: Json) -> Json:
    return root["meshes"][0]["primitives"][0]


def test_gltf_by_hand() -> None:
    splats = decode_any(made())
    # Up and left become down and right.
    assert splats.means.tolist() == [[-1, -2, 3], [4, -5, 6]]
    assert splats.log_scales[0] == pytest.approx([0, 1, 2], abs=1e-6)
    assert splats.log_scales[1] == pytest.approx([np.log(np.finfo(np.float32).tiny), 0, 0])
    assert splats.quats[0] == pytest.approx([HALF, -HALF, 0, 0])
    assert splats.logit_opacities.tolist() == [0, 16]
    # The order of the harmonics of degree 1 is y, z, x.
    assert splats.sh[0].tolist() == [
        [np.float32(v) for v in (0.1, 0.2, 0.3)],
        [-1, -2, -3],
        [4, 5, 6],
        [-7, -8, -9],
    ]
    refused(UnsupportedError, "2 Gaussians in a frame, at most 1", decode_any, made(), "", 1)


@given(drawn_splats(logit=8.0))
@settings(max_examples=60, deadline=None)
def test_floats_come_back(splats: Splats) -> None:
    for encode in (encode_glb, encode_gltf):
        back = decode_any(encode(splats))
        if not len(splats):
            assert same_splats(back, Splats.empty())
            continue
        for name in ("means", "sh"):
            assert getattr(back, name).tobytes() == (getattr(splats, name) + 0.0).tobytes()
        assert np.abs(back.log_scales - splats.log_scales).max() < 1e-6
        assert np.abs(back.opacities - splats.opacities).max() < 2e-7
        assert angles_rad(back, splats).max() < 1e-6


def test_a_gltf_has_the_same_as_a_glb_in_one_file() -> None:
    splats = trained_like_splats(30, 2, 2)
    assert same_splats(decode_any(encode_gltf(splats)), decode_any(encode_glb(splats)))
    root = json.loads(encode_gltf(splats))
    assert root["buffers"][0]["uri"].startswith("data:application/octet-stream;base64,")
    assert decode_any(b"\xef\xbb\xbf\n" + encode_gltf(splats)).sh_degree == 2
    assert same_splats(decode_gltf(made() + b"more"), decode_any(made()))  # longer than it says


def test_nodes_place_what_they_hold() -> None:
    """Two quarter turns about y, one as a matrix and one as a quaternion, are half a turn."""

    def place(root: Json) -> None:
        root["nodes"] = [
            {"children": [1], "rotation": [0, HALF, 0, HALF], "translation": [10, 0, 0]},
            {"children": [2], "scale": [2, 2, 2]},
            {"mesh": 0, "matrix": [0, 0, -1, 0, 0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 1]},
        ]

    plain, placed = decode_any(made()), decode_any(made(place))
    # In our frame half a turn about y is the same, and 10 along x is -10.
    expected = 2 * plain.means * [-1, 1, -1] + [-10, 0, 0]
    assert placed.means == pytest.approx(expected, abs=1e-5)
    turn = np.diag([-1.0, 1.0, -1.0])
    assert shapes(placed) == pytest.approx(4 * turn @ shapes(plain) @ turn, rel=1e-4, abs=1e-5)
    assert placed.sh[0, 1:] == pytest.approx(
        plain.sh[0, 1:] * np.array([[1], [-1], [-1]]), abs=1e-5
    )


def test_every_set_of_gaussians_that_is_shown_is_read_and_meshes_are_not() -> None:
    def more(root: Json) -> None:
        triangle = {"attributes": {"POSITION": 0}}
        plain = copy.deepcopy(primitive(root))
        for name in list(plain["attributes"]):
            if "DEGREE_1" in name:
                del plain["attributes"][name]
        root["meshes"] += [{"primitives": [triangle, plain]}]
        root["nodes"] = [{"mesh": 0}, {"mesh": 1, "translation": [0, 0, 9]}, {"mesh": 0}]
        root["scenes"] = [{"nodes": [1]}, {"nodes": [0, 1]}]
        root["scene"] = 1

    splats = decode_any(made(more))
    assert sorted(splats.means[:, 2].tolist()) == [3, 6, 12, 15]
    assert splats.sh_degree == 1

    def anywhere(root: Json) -> None:
        more(root)
        del root["scenes"], root["scene"]

    assert len(decode_any(made(anywhere))) == 6


@pytest.mark.parametrize("version", list(SpzVersion))
@pytest.mark.parametrize("name", [f"{KHR}_compression_spz", f"{KHR}_compression_spz_2"])
def test_spz_inside_is_read(version: SpzVersion, name: str) -> None:
    splats = trained_like_splats(40, 3, 1)
    packed = encode_spz(splats, version)

    def pack(root: Json) -> None:
        primitive(root)["extensions"][KHR]["extensions"] = {name: {"bufferView": 0}}
        root["bufferViews"] = [{"buffer": 0, "byteLength": len(packed)}]
        root["buffers"] = [{"byteLength": len(packed)}]
        root["extensionsRequired"] = [KHR, name]

    assert same_splats(decode_any(made(pack, packed)), decode_spz(packed))


def test_logarithms_of_a_draft_are_known_by_their_sign(caplog: pytest.LogCaptureFixture) -> None:
    logs = np.array([[-1, -2, 0.5], [-3, 0, 1]], "<f4")
    start = ROOT["bufferViews"][2]["byteOffset"]
    chunk = CHUNK[:start] + logs.tobytes() + CHUNK[start + 24 :]
    with caplog.at_level(logging.WARNING):
        assert (decode_any(made(chunk=chunk)).log_scales == logs).all()
    assert "logarithms" in caplog.text


def setting(*path: Any, value: Any) -> Callable[[Json], None]:
    """A change that sets the value at `path`."""

    def change(root: Json) -> None:
        for key in path[:-1]:
            root = root[key]
        root[path[-1]] = value

    return change


def attributes(root: Json) -> Json:
    return primitive(root)["attributes"]


def within(name: str, value: Any) -> Callable[[Json], None]:
    return setting("meshes", 0, "primitives", 0, "extensions", KHR, name, value=value)


@pytest.mark.parametrize(
    ("change", "kind", "says"),
    [
        (setting("accessors", 0, "count", value=3), CorruptError, "outside of its buffer view"),
        (setting("accessors", 3, "count", value=1), CorruptError, "1 rows of KHR.*OPACITY, not 2"),
        (setting("accessors", 0, "byteOffset", value=-4), CorruptError, "byteOffset: is not in 0"),
        (setting("accessors", 0, "sparse", value={}), UnsupportedError, "sparse"),
        (setting("accessors", 0, "type", value="MAT4"), CorruptError, "is 'MAT4', not VEC3"),
        (setting("accessors", 0, "componentType", value=5130), CorruptError, "componentType"),
        (lambda r: r["accessors"][1].pop("bufferView"), UnsupportedError, "sparse or empty"),
        (setting("bufferViews", 0, "byteLength", value=1 << 30), CorruptError, "ends at"),
        (setting("bufferViews", 0, "byteStride", value=4), CorruptError, "outside of its buffer"),
        (setting("bufferViews", 0, "buffer", value=1), CorruptError, "buffers: has no item 1"),
        (setting("bufferViews", 0, "extensions", value={"X": {}}), UnsupportedError, "by 'X'"),
        (setting("buffers", 0, "byteLength", value=1 << 30), CorruptError, "bytes of 1073741824"),
        (setting("meshes", 0, "primitives", 0, "mode", value=4), CorruptError, "must be points"),
        (within("kernel", "cube"), UnsupportedError, "kernel 'cube'"),
        (within("extensions", {"X_packed": {}}), UnsupportedError, "extended by 'X_packed'"),
        (within("extensions", {f"{KHR}_compression_spz": {"bufferView": 0}}), CorruptError, "SPZ"),
        (setting("extensionsRequired", value=["X_y"]), UnsupportedError, "needs 'X_y'"),
        (setting("extensionsRequired", value=7), CorruptError, "extensionsRequired: is not a list"),
        (setting("nodes", 0, "scale", value=[1, 2, 1]), UnsupportedError, "stretches or shears"),
        (setting("nodes", 0, "translation", value=[1e39, 0, 0]), UnsupportedError, "not finite"),
        (setting("nodes", 0, "matrix", value=[0] * 15), CorruptError, "15 numbers, not 16"),
        (setting("nodes", 0, "rotation", value=[0, 0, 0, "1"]), CorruptError, "finite number"),
        (setting("nodes", 0, "children", value=[0]), CorruptError, "appears twice in the node"),
        (setting("nodes", value={}), CorruptError, "nodes: is not a list"),
        (setting("nodes", value=[7]), CorruptError, "is not a JSON object"),
        (setting("scene", value=7), CorruptError, "scenes: has no item 7"),
        (lambda r: attributes(r).pop(f"{KHR}:SH_DEGREE_1_COEF_1"), CorruptError, "DEGREE_1_COEF_1"),
        (
            lambda r: attributes(r).update({f"{KHR}:SH_DEGREE_4_COEF_0": 0}),
            UnsupportedError,
            "SH degree 4, at most 3",
        ),
        (
            lambda r: (primitive(r).pop("extensions"), r.pop("extensionsUsed")),
            CorruptError,
            "no Gaussians .*; this is a mesh",
        ),
        (
            lambda r: r.update(nodes=[{"mesh": 0}] * 5000, scenes=[{"nodes": list(range(5000))}]),
            UnsupportedError,
            "more than 4096 sets",
        ),
        (lambda r: r.update(nodes=[{}] * 70_000), UnsupportedError, "70000 nodes"),
        (
            lambda r: r.update(
                meshes=[{"primitives": [{}] * 9000}],
                nodes=[{"mesh": 0}] * 8,
                scenes=[{"nodes": list(range(8))}],
            ),
            UnsupportedError,
            "more than 65536 primitives",
        ),
        (setting("scenes", 0, "nodes", value=[0] * 1_000_000), CorruptError, "twice in the node"),
    ],
)
def test_a_bad_gltf(change: Callable[[Json], object], kind: type[CodecError], says: str) -> None:
    refused(kind, says, decode_any, made(change))


@pytest.mark.parametrize("opacity", [-0.1, 1.1, np.nan, np.inf])
def test_an_opacity_outside_of_its_range_is_refused(opacity: float) -> None:
    start = ROOT["bufferViews"][3]["byteOffset"]
    chunk = CHUNK[:start] + struct.pack("<f", opacity) + CHUNK[start + 4 :]
    refused(CorruptError, "an opacity outside", decode_any, made(chunk=chunk))


def test_a_small_file_does_not_become_large_by_repetition() -> None:
    """4000 nodes each use one buffer of 80000 bytes, as 20000 rows, for every attribute."""
    count = 20_000

    def repeat(root: Json) -> None:
        root["nodes"] = [{"mesh": 0}] * 4000
        root["scenes"] = [{"nodes": list(range(4000))}]
        root["bufferViews"] = [{"buffer": 0, "byteLength": 4 * count}]
        kinds = {"SCALAR": 0, "VEC3": 1, "VEC4": 2}
        root["accessors"] = [
            {"bufferView": 0, "componentType": 5120, "count": count, "type": kind} for kind in kinds
        ]
        names = primitive(root)["attributes"]
        primitive(root)["attributes"] = {name: kinds[TABLES[name][0]] for name in names}
        root["buffers"] = [{"byteLength": 4 * count}]

    data = made(repeat, bytes(4 * count))
    with within_bytes(32 << 20), pytest.raises(CorruptError, match="claims"):
        decode_any(data)


def test_small_numbers_are_brought_to_their_range() -> None:
    """Rotations as signed bytes, opacities as shorts, rows with a gap between them."""
    extra = struct.pack("<4b4x4b4x", 127, 0, 0, -128, 0, 127, 0, 0) + struct.pack("<2H", 65535, 0)

    def shrink(root: Json) -> None:
        start = len(CHUNK)
        root["buffers"][0]["byteLength"] = start + len(extra)
        root["bufferViews"] += [
            {"buffer": 0, "byteOffset": start, "byteLength": 16, "byteStride": 8},
            {"buffer": 0, "byteOffset": start + 16, "byteLength": 4},
        ]
        signed = {"bufferView": 8, "componentType": 5120, "type": "VEC4"}
        unsigned = {"bufferView": 9, "componentType": 5123, "type": "SCALAR"}
        root["accessors"] += [
            kind | {"count": 2, "normalized": True} for kind in (signed, unsigned)
        ]
        attributes = primitive(root)["attributes"]
        attributes |= {f"{KHR}:ROTATION": 8, f"{KHR}:OPACITY": 9}
        root["extensionsRequired"] = ["KHR_mesh_quantization"]

    splats = decode_any(made(shrink, CHUNK + extra))
    assert splats.quats.tolist() == [[-1, -1, 0, 0], [0, 0, -1, 0]]
    assert splats.logit_opacities.tolist() == [16, -16]


def outside(uri: str) -> Json:
    root = copy.deepcopy(ROOT)
    root["buffers"][0]["uri"] = uri
    return root


def test_a_buffer_may_be_a_file_beside(tmp_path: Path) -> None:
    (tmp_path / "my numbers.bin").write_bytes(CHUNK + b"more")
    (tmp_path / "a.gltf").write_text(json.dumps(outside("my%20numbers.bin")))
    assert same_splats(read_splats(tmp_path / "a.gltf"), decode_any(made()))
    alone = json.dumps(outside("a.bin")).encode()
    refused(CorruptError, r"another file, 'a\.bin', which is not given", decode_any, alone)
    encoded = base64.b64encode(CHUNK).decode()
    for kind in ("application/octet-stream", "application/gltf-buffer", ""):
        data = json.dumps(outside(f"data:{kind};base64,{encoded}")).encode()
        assert same_splats(decode_any(data), decode_any(made()))
        # JSON has two ways to write a slash.
        assert same_splats(decode_any(data.replace(b"/", b"\\/")), decode_any(made()))


OUTSIDE = (
    *("../secret.bin", "..%2Fsecret.bin", "sub/secret.bin", "..\\secret.bin", "/etc/passwd"),
    *("file:///etc/passwd", "http://127.0.0.1/a.bin", "C:secret.bin", "a%00.bin", "a\ud800"),
    *("", ".."),
)


@pytest.mark.parametrize(
    ("uri", "kind", "says"),
    [
        *((uri, UnsupportedError, "is not the name of a file beside") for uri in OUTSIDE),
        ("none.bin", CorruptError, r"none\.bin is missing"),
        ("short.bin", CorruptError, "4 bytes of"),
        ("data:;base64,A", CorruptError, "not base64"),
        ("data:;base64,\u00e9", CorruptError, "not base64"),
        ("data:#0", CorruptError, "0 bytes of"),
    ],
)
def test_places_not_looked_at(uri: str, kind: type[CodecError], says: str, tmp_path: Path) -> None:
    (tmp_path / "secret.bin").write_bytes(CHUNK)
    folder = tmp_path / "folder"
    (folder / "sub").mkdir(parents=True)
    (folder / "sub" / "secret.bin").write_bytes(CHUNK)
    (folder / "short.bin").write_bytes(b"four")
    (folder / "a.gltf").write_text(json.dumps(outside(uri)))
    refused(kind, rf"a\.gltf: .*{says}", read_splats, folder / "a.gltf")


@pytest.mark.parametrize(
    ("data", "kind", "says"),
    [
        (b"glTF", CorruptError, "inside its header"),
        (struct.pack("<4sII", b"glTF", 1, 12), UnsupportedError, "version 1"),
        (made()[:-1], CorruptError, "ends after"),
        (struct.pack("<4sII", b"glTF", 2, 12), CorruptError, "has no JSON"),
        (made().replace(b"JSON", b"NOSJ"), CorruptError, "chunk 'JSON' is missing"),
        (made().replace(b"BIN\0", b"BON\0"), CorruptError, "chunk 'BIN.* is missing"),
        (join_glb(b"[]", b""), CorruptError, "not a JSON object"),
        (b"{" * 100_000, CorruptError, "is not JSON"),
        (b'{"a": ' + b"[" * 100_000, CorruptError, "is not JSON"),
        (b'{"a": "' + b"a" * (5 << 20) + b'"}', CorruptError, "bytes of JSON"),
        (b'{"a": ' + b"9" * 5000 + b"}", CorruptError, "is not JSON"),
    ],
)
def test_a_bad_container_is_refused(data: bytes, kind: type[CodecError], says: str) -> None:
    refused(kind, says, decode_any, data)
