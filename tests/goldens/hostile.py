"""The rows of conformance/hostile.json: bytes that break a rule of FORMAT.md, or seem to.

A reader's verdict on a row is "taken", "corrupt" or "unsupported".
"""

from __future__ import annotations

import gzip
import json
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgpack
import zstandard

Row = dict[str, Any]
TAKEN, CORRUPT, UNSUPPORTED = "taken", "corrupt", "unsupported"
NOT_AN_INTEGER = (
    "a number such as 3.0 where an integer belongs: JSON libraries that cannot tell may take it"
)


def hostile_rows(stream: Path) -> list[Row]:
    """All rows; they are made from `stream`."""
    files = {
        "manifest": (stream / "manifest.json").read_bytes(),
        "index": (stream / "index.bin").read_bytes(),
        "object": (stream / "segments/1/0").read_bytes(),
    }
    return [
        *_manifests(json.loads(files["manifest"])),
        *_indexes(files["index"], len(json.loads(files["manifest"])["slots"]), stream.name),
        *_objects(files["object"]),
        *_packets(),
        *_coded_changes(),
        *_records(),
    ]


def _row(what: str, name: str, data: bytes, verdict: str, **more: object) -> Row:
    return {"what": what, "name": name, "verdict": verdict, "hex": data.hex(), **more}


# --- Section 4 ---


def _manifests(value: dict[str, Any]) -> Iterator[Row]:
    def row(name: str, verdict: str, /, **changes: object) -> Row:
        data = json.dumps(value | changes).encode()
        more = {"lenient": NOT_AN_INTEGER} if name.endswith("with a point") else {}
        return _row("manifest", name, data, verdict, **more)

    lattice, camera = value["lattice"], value["cameras"][0]

    def first_lattice(**changes: object) -> list[Any]:
        return [lattice[0] | changes, *lattice[1:]]

    yield row("as it was written", TAKEN)
    yield row("a key that no reader knows", TAKEN, colour_space="srgb")
    for version in (0, 2, 3):
        yield row(f"version {version}", UNSUPPORTED, version=version)
    yield row("version with a point", CORRUPT, version=1.0)
    for key in value:
        if key not in ("poster", "title", "capture_frame", "object_url"):
            yield row(f"{key} is null", CORRUPT, **{key: None})
            without = {name: one for name, one in value.items() if name != key}
            yield _row("manifest", f"no {key}", json.dumps(without).encode(), CORRUPT)
    for fps in (0.000999, 0, -1, 1000.5, "25"):
        yield row(f"fps {fps!r}", CORRUPT, fps=fps)
    for fps in (0.001, 1000):
        yield row(f"fps {fps}", TAKEN, fps=fps)
    yield row("num_gs is not swin_size times the slots", CORRUPT, num_gs=value["num_gs"] + 1)
    yield row("num_gs with a point", CORRUPT, num_gs=float(value["num_gs"]))
    yield row("swin_size 0", CORRUPT, swin_size=0)
    yield row("swin_size 256", CORRUPT, swin_size=256, num_gs=256 * sum(value["slots"]))
    yield row("segment_frames 0", CORRUPT, segment_frames=0)
    yield row("segment_frames 4097", CORRUPT, segment_frames=4097)
    yield row("sh_degree 4", CORRUPT, sh_degree=4)
    yield row("slots without a number", CORRUPT, slots=[], lattice=[], num_gs=0)
    yield row("slots with true", CORRUPT, slots=[True, *value["slots"][1:]])
    yield row("a layer of no slots", CORRUPT, slots=[0, sum(value["slots"])])
    yield row("fewer lattices than layers", CORRUPT, lattice=lattice[:1])
    yield row("lattices that are numbers", CORRUPT, lattice=[1] * len(lattice))
    for key, number in (
        ("colour", 9.9e-7),
        ("colour", 1.1e6),
        ("opacity_levels", 257),
        ("opacity_levels", 1),
        ("log_scale_base", -1001),
        ("log_scale_base", "0"),
        ("position_m", 0),
    ):
        yield row(f"{key} {number!r} in a lattice", CORRUPT, lattice=first_lattice(**{key: number}))
    yield row("near_m 0", CORRUPT, near_m=0)
    yield row("bounds the wrong way round", CORRUPT, bounds=value["bounds"][::-1])
    yield row("two cameras of one name", CORRUPT, cameras=[camera, camera])
    yield row("no camera", CORRUPT, cameras=[])
    yield row("a default camera that is not there", CORRUPT, default_camera="nobody's")
    yield row(
        "a camera that is scaled",
        CORRUPT,
        cameras=[camera | {"w2c": [2 * n for n in camera["w2c"]]}],
    )
    mirrored = [-camera["w2c"][0], *camera["w2c"][1:]]
    yield row("a camera that is mirrored", CORRUPT, cameras=[camera | {"w2c": mirrored}])
    yield row("a camera without a focal length", CORRUPT, cameras=[camera | {"fx_px": 0}])
    yield row("a view without a focal length", CORRUPT, view=camera | {"fx_px": 0})
    yield row("a focus of two numbers", CORRUPT, focus=[1, 2])
    yield row("a view and a focus", TAKEN, view=camera, focus=[1, 2.5, 3])
    yield row("an object URL without {layer}", CORRUPT, object_url="segments/{segment}")
    yield row("an object URL of three", CORRUPT, object_url="{segment}/{layer}/{other}")
    yield row("a title of 2001 characters", CORRUPT, title="x" * 2001)
    yield row("a poster of 256 bytes", CORRUPT, poster="x" * 256)
    yield row("a poster outside of the stream, which is ignored", TAKEN, poster="../x.jpg")
    for name, data in (
        ("no bytes", b""),
        ("not UTF-8", b"\xff\xfe"),
        ("null", b"null"),
        ("an array", b"[]"),
        ("arrays in arrays", b"[" * 20_000),
        ("NaN", b'{"version": 1, "fps": NaN}'),
        ("cut short", json.dumps(value).encode()[:-2]),
    ):
        yield _row("manifest", name, data, CORRUPT)
    count = len(value["cameras"])
    for name, depths, verdict in (
        ("one for each camera", [0.2] * count, TAKEN),
        ("none", [], TAKEN),
        ("null", None, CORRUPT),
        ("too many", [0.2] * (count + 1), CORRUPT),
        ("a zero", [0] * count, CORRUPT),
        ("a text", ["0.2"] * count, CORRUPT),
        ("true", [True] * count, CORRUPT),
    ):
        yield row(f"camera_near_m: {name}", verdict, camera_near_m=depths)


# --- Section 5 ---


def _indexes(index: bytes, num_layers: int, stream: str) -> Iterator[Row]:
    size = 60 + 84 * num_layers

    def row(name: str, data: bytes, verdict: str = CORRUPT, **more: object) -> Row:
        return _row("index", name, data, verdict, stream=f"streams/{stream}", **more)

    def changed(place: int, fmt: str, value: float) -> bytes:
        """The index with a changed field in the second record, with a correct CRC."""
        made = bytearray(index)
        struct.pack_into(fmt, made, size + place, value)
        struct.pack_into("<I", made, 2 * size - 4, zlib.crc32(made[size : 2 * size - 4]))
        return bytes(made)

    whole = len(index) // size
    yield row("as it was written", index, TAKEN, num_segments=whole)
    yield row("nothing yet", b"", TAKEN, num_segments=0)
    yield row("a record that is cut short", index[:-1], TAKEN, num_segments=whole - 1)
    yield row("a last record of zeros", index + bytes(size), TAKEN, num_segments=whole)
    yield row("a record of zeros amid others", index[:size] + bytes(size) + index[2 * size :])
    yield row("a wrong CRC", index[: size + 8] + bytes([index[size + 8] ^ 1]) + index[size + 9 :])
    yield row("a segment is missing", index[:size] + index[2 * size :])
    yield row("another first frame", changed(4, "<I", 6))
    yield row("a short segment amid others", changed(8, "<I", 4))
    yield row("a segment without frames", changed(8, "<I", 0))
    yield row("a reserved field", changed(12, "<I", 1))
    yield row("an object that is too large", changed(16, "<Q", 2**30 + 1))
    yield row("an infinite PSNR", changed(56, "<f", float("inf")))


# --- Section 6 ---


def _objects(data: bytes) -> Iterator[Row]:
    def changed(place: int, value: bytes) -> bytes:
        return data[:place] + value + data[place + len(value) :]

    count = struct.unpack_from("<I", data, 16)[0]
    assert count > 1
    yield _row("object", "as it was written", data, TAKEN)
    for name, place, value, verdict in (
        ("another magic of a skippable frame", 0, b"\x51", CORRUPT),
        ("another length of the table", 4, b"\0", CORRUPT),
        ("another magic", 8, b"X", CORRUPT),
        ("version 2", 12, b"\2", UNSUPPORTED),
        ("version 3", 12, b"\3", UNSUPPORTED),
        ("coder 1", 13, b"\1", UNSUPPORTED),
        ("coder 3", 13, b"\3", UNSUPPORTED),
        ("a reserved field", 14, b"\1", CORRUPT),
        ("no chunks", 16, struct.pack("<I", 0), CORRUPT),
        ("16385 chunks", 16, struct.pack("<I", 16385), CORRUPT),
        ("births that do not rise", 20, struct.pack("<i", 1000), CORRUPT),
        ("a packet that begins at 0", 24, struct.pack("<I", 0), CORRUPT),
        ("a packet longer than the object", 28, struct.pack("<I", 2**32 - 1), CORRUPT),
    ):
        yield _row("object", name, changed(place, value), verdict)
    yield _row("object", "cut short", data[:-1], CORRUPT)
    yield _row("object", "a byte more", data + b"\0", CORRUPT)
    yield _row("object", "half a head", data[:10], CORRUPT)


def _packets() -> Iterator[Row]:
    content = bytes(range(100))
    zstd = zstandard.ZstdCompressor(write_checksum=True).compress(content)

    def row(name: str, data: bytes, verdict: str = CORRUPT, limit_bytes: int = 1 << 16) -> Row:
        return _row("packet", name, data, verdict, limit_bytes=limit_bytes)

    yield row("as it was written", zstd, TAKEN)
    yield row("more than may be there", zstd, limit_bytes=99)
    yield row("two packets", zstd + zstd)
    yield row("a byte more", zstd + b"\0")
    yield row("cut short", zstd[:-1])
    yield row("a wrong checksum", zstd[:-1] + bytes([zstd[-1] ^ 1]))
    yield row(
        "no size",
        zstandard.ZstdCompressor(write_content_size=False, write_checksum=True).compress(content),
    )
    yield row("no checksum", zstandard.ZstdCompressor(write_checksum=False).compress(content))
    yield row("says 2 GB", bytes.fromhex("28b52ffda4000000800100007878"))
    yield row("skippable", struct.pack("<II", 0x184D2A50, 4) + b"none")
    # 98047 sequences that each copy 131074 bytes, in a frame that says 100.
    copies = bytes.fromhex("00ffffff54000034ffffffff")
    head = bytes.fromhex("28b52ffd2464") + struct.pack("<I", len(copies) << 3 | 5)[:3]
    yield row("copies far more than it says", head + copies + bytes(4))
    yield row("a gzip member", gzip.compress(content, mtime=0))
    yield row("a chunk", b"SWG1" + content)
    yield row("the first bytes alone", zstd[:4])


# --- Section 10.5 ---

Fields = tuple[tuple[int, int], ...]
"""Numbers of a bit string, each with its bits."""

THREE_PREDICTED: Fields = ((2, 5), (3, 2), (0, 5), (0, 5))
UNCHANGED: Fields = ((1, 3), *((0, 3),) * 7)
"""A group of three planes of zeros."""
GROUPS: Fields = (
    # Patterns 0 and 9: nothing, and x with the opacity. Then 9, 0, 9.
    *((int(pattern in (0, 9)), 3) for pattern in range(16)),
    *((1, 1), (0, 1), (1, 1)),
    *((4, 5), (0, 1), (1, 1), (0, 1), (0, 1)),  # x: of code 4 the values 1 and 0
    *((0, 5), (0, 1), (1, 1), (0, 1), (1, 1)),  # the opacity: of code 0 the values 0 and 2
    *UNCHANGED,
    *UNCHANGED,
    *((7 * (pattern == 2), 3) for pattern in range(8)),  # all have pattern 2
    *((0, 5), (0, 1), (0, 1), (0, 1)),
)
ONE_NEW: Fields = ((0, 5), (1, 5), (1, 1), (0, 5))
PLANES: Fields = ((0, 8), (0, 5), (0, 1)) * 13


def _coded(fields: Fields, rest: bytes = b"", flags: int = 0, zero: int = 0) -> bytes:
    bits = at = 0
    for value, count in fields:
        bits |= value << at
        at += count
    head = struct.pack("<BBBBi", 1, flags, 0, zero, 5)
    packet = head + bits.to_bytes((at + 7) // 8, "little") + rest
    return packet + struct.pack("<I", zlib.crc32(packet))


def _coded_changes() -> Iterator[Row]:
    def row(name: str, data: bytes, verdict: str = CORRUPT, limit_bytes: int = 1 << 16) -> Row:
        return _row("packet", f"coded: {name}", data, verdict, limit_bytes=limit_bytes)

    three = (*THREE_PREDICTED, *GROUPS)
    small = _coded(three)
    yield row("three predicted", small, TAKEN)
    yield row("three predicted, one byte more than may be there", small, limit_bytes=70)
    yield row("a wrong checksum", small[:-1] + bytes([small[-1] ^ 1]))
    yield row("too short", small[:11])
    yield row("a reserved flag", _coded(three, flags=8), UNSUPPORTED)
    yield row("a reserved byte", _coded(three, zero=1), UNSUPPORTED)
    yield row("one new", _coded((*ONE_NEW, *PLANES)), TAKEN)
    yield row("ends inside its planes", _coded((*ONE_NEW, *PLANES[:9])))
    yield row("ends before its planes", _coded(ONE_NEW))
    yield row("ends before its counts", _coded(()))
    yield row("no Gaussian", _coded(((0, 5),) * 3), TAKEN)
    yield row("a bit behind the planes", _coded((*ONE_NEW, *PLANES, (1, 1))))
    most = ((31, 5), ((1 << 31) - 1, 31))
    yield row("2^31 - 1 new", _coded(((0, 5), *most, (0, 5))))
    yield row("2^31 - 1 predicted", _coded((*most, (0, 5), (0, 5))))
    for name, length, count in (
        ("no pattern", 0, 16),
        ("patterns of less than a whole code", 2, 3),
        ("patterns of more than a whole code", 1, 3),
    ):
        lengths = (*((length, 3),) * count, *((0, 3),) * (16 - count))
        yield row(name, _coded((*THREE_PREDICTED, *lengths, (0, 99))))
    # Code 3 has 16 values before those of 12 ones.
    last = (*ONE_NEW, *PLANES[:36], (0, 8), (3, 5), (4095, 12))
    yield row("a byte of 255", _coded((*last, (239, 8))), TAKEN)
    yield row("a byte of 256", _coded((*last, (240, 8))))
    for name, byte, rest, verdict in (
        ("a long residual", 255, bytes(4), TAKEN),
        ("a long residual that is missing", 255, b"", CORRUPT),
        ("a residual of 256", 256, bytes(4), CORRUPT),
    ):
        x = (*((int(pattern == 1), 3) for pattern in range(16)), (3, 5), (4095, 12))
        group = (*x, (byte - 17, 8), *UNCHANGED * 3)
        yield row(name, _coded(((1, 5), (1, 1), (0, 5), (0, 5), *group), rest), verdict)


# --- Section 12 ---


def _records() -> Iterator[Row]:
    a_slice = {"kind": "slice", "birth": 1, "packets": [b"a"], "skip_map": b"m"}
    keyframe = {"kind": "keyframe", "frame": 0, "first": 0, "packets": [b"a"]}
    start = {"kind": "start", "from": 0, "num_frames": 1, "manifest": b""}

    def row(name: str, value: object, verdict: str = CORRUPT) -> Row:
        body: bytes = msgpack.packb(value)
        return _row("record", name, struct.pack("<I", len(body)) + body, verdict)

    for value in (start, a_slice, keyframe, {"kind": "end", "num_frames": 9}):
        yield row(f"{value['kind']}", value, TAKEN)
        for key in value:
            yield row(
                f"{value['kind']} without {key}", {k: v for k, v in value.items() if k != key}
            )
    yield row("error", {"kind": "error", "message": "gone"}, TAKEN)
    yield row("a key that no reader knows", keyframe | {"colour": b"red"}, TAKEN)
    above = {key: value for key, value in a_slice.items() if key != "skip_map"} | {"first": 2}
    yield row("a slice of layer 2", above, TAKEN)
    yield row(
        "a slice of layer 2 with a skip map, which is ignored", above | {"skip_map": b"m"}, TAKEN
    )
    yield row("a slice of a skip map alone", a_slice | {"packets": []}, TAKEN)
    wrong: tuple[tuple[str, object], ...] = (
        ("no map", None), ("an array", []), ("an empty map", {}), ("a number for a key", {1: 2}),
        ("another kind", {"kind": "other"}), ("a kind that is a number", {"kind": 7}),
        ("from -1", start | {"from": -1}), ("from true", start | {"from": True}),
        ("a manifest that is a text", start | {"manifest": "text"}),
        ("packets that are texts", a_slice | {"packets": ["text"]}),
        ("packets in a map", a_slice | {"packets": {}}),
        ("a birth of 41 bits", a_slice | {"birth": 1 << 40}),
        ("a birth that is a float", a_slice | {"birth": 1.0}),
        ("first that is a float", above | {"first": 1.0}),
        ("17 packets", a_slice | {"packets": [b""] * 17}),
        ("a skip map that is a text", a_slice | {"skip_map": "text"}),
        ("a skip map in an array", a_slice | {"skip_map": [b""]}),
        ("first -1", above | {"first": -1}), ("first 16", above | {"first": 16}),
        ("layers 15 and 16", above | {"first": 15, "packets": [b""] * 2}),
        ("a slice of layer 2 without packets", above | {"packets": []}),
        ("a keyframe without packets", keyframe | {"packets": []}),
        ("a keyframe with a number for a packet", keyframe | {"packets": [0]}),
        ("a keyframe of layer 16", keyframe | {"first": 16}),
        ("a keyframe of layers 15 and 16", keyframe | {"first": 15, "packets": [b""] * 2}),
        ("first false", keyframe | {"first": False}),
        ("frame -1", keyframe | {"frame": -1}), ("frame 2^31", keyframe | {"frame": 1 << 31}),
        ("num_frames 2^31", {"kind": "end", "num_frames": 1 << 31}),
        ("a message of bytes", {"kind": "error", "message": b"bytes"}),
        ("a message of 65537 bytes", {"kind": "error", "message": "x" * 65_537}),
        ("an ext type", {"kind": "end", "num_frames": msgpack.ExtType(4, b"x")}),
        ("an unknown key with a map", keyframe | {"more": {}}),
        ("9 keys", keyframe | {f"key {n}": b"" for n in range(5)}),
    )  # fmt: skip
    for name, broken in wrong:
        yield row(name, broken)
    deep = b"\x81\xa7packets" + b"\x91" * 20_000
    yield _row("record", "arrays in arrays", struct.pack("<I", len(deep)) + deep, CORRUPT)
    yield _row("record", "a length over 2^26", struct.pack("<I", 2**26 + 1), CORRUPT)
