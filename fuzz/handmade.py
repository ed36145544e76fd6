"""Small handmade .4dgs and .splat4d files, for the seeds of fuzz/foreignseed.py."""

from __future__ import annotations

import json
import struct
import zlib

import numpy as np
import numpy.typing as npt
import zstandard

MAGIC = b"\x894DGS1\r\n"
CHANNELS = {0: 3, 1: 3, 2: 1, 3: 3, 4: 3, 5: 1, 6: 3, 7: 1, 8: 1, 9: 1, 10: 1, 13: 1}
STEPS = (0.01, 0.02, 0.001, 1 / 255, 1 / 255, 0.1, 0.004, 0.02)
"""Steps of position, ln size, rotation, colour, opacity, motion, time and ln sigma."""

Numbers = npt.ArrayLike


def zigzag(numbers: Numbers) -> npt.NDArray[np.int64]:
    wide = np.asarray(numbers, np.int64)
    return (wide << 1) ^ (wide >> 63)


def planes(numbers: Numbers, width: int) -> bytes:
    return np.asarray(numbers).astype(f"<u{width}").reshape(-1, 1).view(np.uint8).T.tobytes()


def stream(kind: int, numbers: Numbers, codec: int = 0) -> bytes:
    """An attribute stream of (N, channels) numbers, in two bytes each."""
    rows = np.asarray(numbers, np.int64)
    rows = rows.reshape(len(rows), -1)
    raw = planes(zigzag(rows), 2)
    body = zlib.compress(raw) if codec == 0 else zstandard.compress(raw)
    head = (kind, 2, 0, codec, rows.shape[1], len(rows), len(body))
    return struct.pack("<BBBBBIQ", *head) + body


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def block(content: bytes) -> bytes:
    return struct.pack("<Q", len(content)) + content


def record(kind: int, content: bytes) -> bytes:
    return struct.pack("<BQ", kind, len(content)) + content


def header(sh_degree: int = 0) -> bytes:
    fields = struct.pack("<dQd", 1.0, 2, 0.05) + text("keyframe-delta")
    tail = struct.pack("<6dBB", *[0.0] * 6, sh_degree, 0) + text("")
    return record(1, text("") + text("") + fields + tail)


def grids() -> bytes:
    steps = struct.pack("<11dB", 1.0, 2.0, 3.0, *STEPS, 1)
    return record(3, text("uniform-v1") + steps + text(""))


def windows(*spans: tuple[float, float]) -> bytes:
    return record(
        4, struct.pack("<I", len(spans)) + b"".join(struct.pack("<2d", *s) for s in spans)
    )


def packed(content: bytes, codec: str = "") -> bytes:
    body = {"": content, "deflate": zlib.compress(content)}.get(codec, content)
    return text(codec) + struct.pack("<Q", len(content)) + block(body)


def keyframe(t0: float, t1: float, count: int, streams: bytes, codec: str = "") -> bytes:
    return record(5, struct.pack("<2d2I", t0, t1, 0, count) + packed(streams, codec))


def delta(
    span: tuple[float, float],
    reference: int,
    groups: tuple[bytes, bytes, bytes],
    counts: tuple[int, int, int],
    codec: str = "",
) -> bytes:
    head = struct.pack("<2dIBQQH3I", *span, 0, 1, reference, reference, 1, *counts)
    return record(16, head + packed(b"".join(map(block, groups)), codec))


def fourdgs(*records: bytes) -> bytes:
    return MAGIC + b"".join(records) + record(2, bytes(20)) + MAGIC


def splat4d_stream(kind: int, role: int, numbers: Numbers, width: int = 2) -> tuple[bytes, bytes]:
    """The head and the payload of a stream."""
    flat = np.asarray(numbers).ravel()
    body = zstandard.compress(planes(flat, width))
    return struct.pack("<BBBII", kind, role, width, flat.size, len(body)), body


def splat4d() -> bytes:
    """A .splat4d of three frames with three Gaussians; everything of the middle one changes."""
    static = b"".join(splat4d_stream(9, 2, [0b10100000], 1)) * 5
    for name in ([10, -20, 30, 1, 0, 0, 1, 0, 0], [-30, -40, -50, *[0] * 6]):
        static += b"".join(splat4d_stream(9, 2, zigzag(name)))
    for values in ([255, 0, 128] * 3, [255, 100, 200], [255, 128, 128, 128] * 3):
        static += b"".join(splat4d_stream(9, 2, values, 1))
    keys = ([6, 0, 0], [100, 10, 0, 0], [50, 60, 70], [0], [-9, -9, -9])
    streams = [splat4d_stream(kind, 0, zigzag(key)) for kind, key in enumerate(keys)]
    for kind, key in enumerate(keys):
        streams.append(splat4d_stream(kind, 1, zigzag([1] * (2 * len(key))), 1))
    chunk = struct.pack("<H", len(streams)) + b"".join(
        b"".join(s) for s in zip(*streams, strict=True)
    )
    room = 1000
    fields = {
        **{"n": 3, "t": 3, "fps": 20.0, "gop": 30},
        "steps": {
            **{"pos": 0.5, "rot": 1, "rgb": 1, "alpha": 1, "scale_log": 0.2},
            **{"base_pos": 0.25, "base_scale_log": 0.1},
        },
        "static_section": {"offset": room, "len": len(static)},
        "gops": [{"offset": room + len(static), "len": len(chunk), "f0": 0, "f1": 2}],
    }
    said = json.dumps(fields).encode().ljust(room - 12)
    return b"SP4D" + struct.pack("<HHI", 1, 0, room - 12) + said + static + chunk
