"""Places of a glTF's numbers: containers, separate files, accessors; and forbidden places."""

from __future__ import annotations

import base64
import copy
import json
import struct
from pathlib import Path

import pytest

from codec.errors import CodecError, CorruptError, UnsupportedError
from codec.foreign.gltfbuffers import join_glb
from codec.interop.formats import decode_any, read_splats
from tests.support.drawn import same_splats
from tests.support.handmade_gltf import CHUNK, KHR, ROOT, Json, made, primitive


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
    with pytest.raises(kind, match=rf"a\.gltf: .*{says}"):
        read_splats(folder / "a.gltf")


def test_bytes_without_a_place_have_no_file_beside() -> None:
    with pytest.raises(CorruptError, match=r"another file, 'a\.bin', which is not given"):
        decode_any(json.dumps(outside("a.bin")).encode())


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
    with pytest.raises(kind, match=says):
        decode_any(data)
