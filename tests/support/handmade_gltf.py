"""A handmade glTF file of two Gaussians, for tests to change."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from typing import Any

import numpy as np

from codec.foreign.gltfbuffers import join_glb

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
