"""Exported files read by gsply, splat-transform, the PlayCanvas engine; and theirs, read here."""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from codec.foreign.spz import SpzVersion
from codec.interop.formats import (
    SplatFormat,
    encode_splats,
    export_stream,
    read_splats,
    write_splats,
)
from codec.lattice.lattice import Lattice
from codec.similarity import half_turned
from codec.slice import Slice
from codec.slots.slotlayout import SlotLayout
from codec.splats import SH_C0, Splats
from codec.stream import StreamReader, StreamWriter
from tests.support.alike import largest_errors, shapes
from tests.support.drawn import angles_rad, same_splats
from tests.support.slots.slot_streams import slot_manifest
from tests.support.trained_like import trained_like_splats

HERE = Path(__file__).parent
MODULES = HERE / "node_modules"
NODE = shutil.which("node")
LOCAL = MODULES / ".bin" / "splat-transform"
SPLAT_TRANSFORM = str(LOCAL) if NODE and LOCAL.exists() else shutil.which("splat-transform")
gsply: Any = None
with contextlib.suppress(ImportError):
    gsply = importlib.import_module("gsply")

needs_gsply = pytest.mark.skipif(gsply is None, reason="gsply is missing: scripts/setup dev")
needs_gsply_sog = pytest.mark.skipif(
    gsply is None or importlib.util.find_spec("imagecodecs") is None,
    reason="gsply[sogs] is missing: scripts/setup dev",
)
needs_splat_transform = pytest.mark.skipif(
    SPLAT_TRANSFORM is None, reason="splat-transform is missing: npm, then scripts/setup dev"
)
needs_modules = pytest.mark.skipif(
    NODE is None or not (MODULES / "gltf-validator").is_dir(),
    reason="the modules of tests/codec/interop are missing: npm, then scripts/setup dev",
)
deep = pytest.mark.deep
degrees = pytest.mark.parametrize(
    "sh_degree", [pytest.param(0, marks=deep), 1, pytest.param(2, marks=deep), 3]
)
versions = pytest.mark.parametrize(
    "version", [SpzVersion.V2, pytest.param(SpzVersion.V3, marks=deep), SpzVersion.V4]
)

close = np.testing.assert_allclose

# The real harmonics in order, each named by the axes of its product.
HARMONICS = ["1", *"yzx", "xy", "yz", "zz", "xz", "xx"]
HARMONICS += ["xxy", "xyz", "yzz", "zzz", "xzz", "xxz", "xxx"]


def shown(tmp_path: Path, sh_degree: int) -> tuple[Path, Splats]:
    """A stream of one frame, and its Gaussians; their values are in the range of all formats."""
    splats = trained_like_splats(400, 5, sh_degree)
    made = Splats(
        splats.means,
        np.clip(splats.log_scales, -9.9, 5),
        splats.quats,
        # The logit of an opacity rounded to exactly 0 or 1 is infinite in other programs.
        np.clip(splats.logit_opacities, -5, 5),
        splats.sh,
    )
    lattice = Lattice.suiting(made)
    manifest = slot_manifest(SlotLayout(1, (len(made),), sh_degree, (lattice,), 1))
    with StreamWriter.create(tmp_path / "stream", manifest, exact=True) as writer:
        writer.append(Slice(0, made, np.zeros(len(made), np.uint8)))
    reader = StreamReader(tmp_path / "stream")
    return tmp_path / "stream", reader.active_splats(0, reader.manifest.num_layers)


def exported(
    tmp_path: Path, sh_degree: int, format: SplatFormat, version: SpzVersion | None = None
) -> tuple[Path, Splats]:
    """A frame as a file, and its Gaussians, in the order of the file except for SOG."""
    stream, splats = shown(tmp_path, sh_degree)
    [path] = export_stream(stream, tmp_path / f"frame.{format}", 0, None, None, None, version)
    if format is SplatFormat.SPLAT:
        importance = splats.log_scales.astype(np.float64).sum(axis=1) + np.log(splats.opacities)
        splats = splats.take(np.argsort(-importance, kind="stable"))
    return path, splats


def in_order(found: Splats, wanted: Splats) -> Splats:
    """`found` in the order of `wanted`, matched by position."""
    nearest = cKDTree(found.means).query(wanted.means)[1]
    assert sorted(nearest) == list(range(len(wanted)))
    return found.take(nearest)


def assert_within(
    found: Splats,
    wanted: Splats,
    format: SplatFormat,
    harmonic: float = 0.51 / 128,
    angle_rad: float = 0.005,
) -> None:
    """Asserts that `found` is `wanted`, within the precision of `format`."""
    assert len(found) == len(wanted)
    if format is SplatFormat.PLY:
        assert same_splats(found, wanted)
        return
    spz = format is SplatFormat.SPZ
    # Positions are in 1 / 4096 m in SPZ, else float32; sizes in 1 / 16 of a logarithm.
    close(found.means, wanted.means, rtol=2e-7, atol=0.5 / 4096 + 1e-6 if spz else 0)
    close(found.log_scales, wanted.log_scales, rtol=0, atol=0.5 / 16 + 1e-5 if spz else 1e-5)
    # Three components in 9 bits of 1 / sqrt(2), or four in 8 bits, of which readers differ by one.
    assert angles_rad(found, wanted).max() < (angle_rad if spz else 0.03)
    close(found.opacities, wanted.opacities, rtol=0, atol=1 / 255)
    dc_step = 1 / (255 * (0.15 if spz else SH_C0))
    inside = np.abs(wanted.sh[:, 0] * SH_C0) < 0.5 if not spz else np.ones((len(wanted), 3), bool)
    dc_error = np.abs(found.sh[:, 0] - wanted.sh[:, 0])[inside]
    assert dc_error.max() < 0.51 * dc_step
    if spz:
        assert found.sh.shape == wanted.sh.shape
        close(found.sh[:, 1:], wanted.sh[:, 1:], rtol=0, atol=harmonic)


def assert_within_sog(found: Splats, wanted: Splats, roundings: int = 1) -> None:
    """Asserts that `found` is `wanted` within SOG's precision; truncation takes 2 roundings."""
    found = in_order(found, wanted)
    logs = np.sign(wanted.means) * np.log1p(np.abs(wanted.means))
    step = np.ptp(logs, axis=0).max() / 65535
    # A step of the logarithm is a step of 1 + |p| in the position.
    away = np.abs(found.means - wanted.means) / (1 + np.abs(wanted.means))
    assert away.max() < roundings * 0.51 * step + 1e-6
    close(found.log_scales, wanted.log_scales, rtol=0, atol=0.1)
    assert angles_rad(found, wanted).max() < roundings * 0.017
    close(found.opacities, wanted.opacities, rtol=0, atol=roundings * 0.51 / 255)
    close(found.sh[:, 0], wanted.sh[:, 0], rtol=0, atol=0.05)
    assert found.sh.shape == wanted.sh.shape
    # A palette of 256 rows for 400 Gaussians, whose harmonics have no pattern.
    away = found.sh[:, 1:] - wanted.sh[:, 1:]
    assert not away.size or np.sqrt((away**2).mean()) < 0.03


def gsply_splats(path: Path) -> Splats:
    """The Gaussians that gsply reads from a file."""
    reads = {".spz": "read_spz", ".sog": "sogread", ".ply": "plyread"}
    read = getattr(gsply, reads[path.suffix])(path)
    count = len(read.means)
    parts = [read.sh0.reshape(count, 1, 3)]
    if read.shN is not None and read.shN.size:
        parts.append(read.shN.reshape(count, -1, 3))
    arrays = [read.means, read.scales, read.quats, read.opacities.reshape(-1)]
    arrays.append(np.concatenate(parts, axis=1))
    return Splats(*(np.array(array, np.float32) for array in arrays))


ANGLES_RAD = {SpzVersion.V2: 0.24, SpzVersion.V3: 0.005, SpzVersion.V4: 0.005}
"""Largest errors. In version 2, w is computed from x, y and z in 8 bits, and inexact if small."""


def transformed(path: Path, out: Path) -> Path:
    """Converts `path` to `out` with splat-transform; returns `out`."""
    assert SPLAT_TRANSFORM is not None
    words = [SPLAT_TRANSFORM, "-q", "-w", "-g", "cpu", str(path), str(out)]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr or done.stdout
    return out


def read_by_gsply(path: Path) -> Splats:
    found = gsply_splats(path)
    # gsply keeps the axes of SPZ, y up and z back.
    return half_turned(found, "x") if path.suffix == ".spz" else found


def read_by_splat_transform(path: Path) -> Splats:
    found = read_splats(transformed(path, path.with_name("theirs.ply")))
    # From version 3 on it keeps the axes of SPZ too, whatever the file names them.
    return half_turned(found, "x") if path.suffix == ".spz" else found


READERS = [
    pytest.param(read_by_gsply, marks=needs_gsply_sog, id="gsply"),
    pytest.param(read_by_splat_transform, marks=needs_splat_transform, id="splat-transform"),
]
readers = pytest.mark.parametrize("read", READERS)


@pytest.mark.parametrize(
    ("read", "format"),
    [
        pytest.param(*reader.values, format, marks=reader.marks, id=f"{reader.id} {format}")
        for reader in READERS
        for format in (SplatFormat.PLY, SplatFormat.SPLAT, SplatFormat.SOG)
        if reader.id != "gsply" or format is not SplatFormat.SPLAT
    ],
)
@degrees
def test_others_read_what_is_exported(
    read: Callable[[Path], Splats], format: SplatFormat, sh_degree: int, tmp_path: Path
) -> None:
    path, splats = exported(tmp_path, sh_degree, format)
    if format is SplatFormat.SOG:
        assert_within_sog(read(path), splats)
    else:
        assert_within(read(path), splats, format)


@readers
@degrees
@versions
def test_others_read_the_spz(
    read: Callable[[Path], Splats], version: SpzVersion, sh_degree: int, tmp_path: Path
) -> None:
    path, splats = exported(tmp_path, sh_degree, SplatFormat.SPZ, version)
    assert_within(read(path), splats, SplatFormat.SPZ, angle_rad=ANGLES_RAD[version])


@needs_gsply
@degrees
@pytest.mark.parametrize("version", [3, 4])
def test_the_spz_of_gsply_is_read_alike(version: int, sh_degree: int, tmp_path: Path) -> None:
    path, splats = exported(tmp_path, sh_degree, SplatFormat.PLY)
    gsply.write_spz(tmp_path / "theirs.spz", gsply.plyread(path), version=version)
    # gsply writes the given Gaussians without turning them.
    found = half_turned(read_splats(tmp_path / "theirs.spz"), "x")
    assert_within(found, splats, SplatFormat.SPZ)


@needs_splat_transform
@degrees
@pytest.mark.parametrize("kind", ["spz", "sog", "glb", "compressed.ply"])
def test_what_splat_transform_writes_is_read(kind: str, sh_degree: int, tmp_path: Path) -> None:
    path, splats = exported(tmp_path, sh_degree, SplatFormat.PLY)
    found = read_splats(transformed(path, tmp_path / f"theirs.{kind}"))
    match kind:
        case "spz":
            # It rounds harmonics to 8 bits, then degree 1 to five of these, the others to four.
            most, found = (8 + 0.51) / 128, half_turned(found, "x")  # it wrote y down
            assert_within(in_order(found, splats), splats, SplatFormat.SPZ, most)
        case "sog":
            assert_within_sog(found, splats, 2)  # it truncates where others round
        case "glb":
            assert_same_shown(found, splats)
        case "compressed.ply":  # by either reader
            back = transformed(tmp_path / "theirs.compressed.ply", tmp_path / "back.ply")
            for a, b in zip(found.arrays, read_splats(back).arrays, strict=True):
                assert np.abs(a - b).max() < 0.001


def assert_same_shown(found: Splats, wanted: Splats) -> None:
    """Asserts that both are the same Gaussians in float32, independent of the order of axes."""
    assert (found.means == wanted.means).all()
    assert (found.sh == wanted.sh).all()
    close(found.opacities, wanted.opacities, rtol=0, atol=1e-6)
    close(found.log_scales, wanted.log_scales, rtol=0, atol=1e-6)
    largest = np.exp(2 * wanted.log_scales.max(axis=1))[:, None, None]
    assert np.abs((shapes(found) - shapes(wanted)) / largest).max() < 1e-5


def run_node(script: str, *words: Path) -> str:
    assert NODE is not None
    done = subprocess.run(
        [NODE, str(HERE / script), *map(str, words)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@needs_modules
@degrees
def test_the_playcanvas_engine_reads_the_glb(sh_degree: int, tmp_path: Path) -> None:
    path, splats = exported(tmp_path, sh_degree, SplatFormat.GLB)
    run_node("readglb.mjs", path, tmp_path / "columns")
    names, _, columns = (tmp_path / "columns").read_bytes().partition(b"\n")
    table = dict(
        zip(json.loads(names), np.frombuffer(columns, "<f4").reshape(-1, 400), strict=True)
    )

    def named(*keys: str) -> np.ndarray[Any, Any]:
        return np.stack([table[key] for key in keys], axis=1)

    count = splats.sh.shape[1] - 1
    rest = [[f"f_rest_{c * count + k}" for c in range(3)] for k in range(count)]
    # The engine has y up, x to the left, linear sizes and opacities.
    found = Splats(
        named("x", "y", "z") * np.array([-1, -1, 1], np.float32),
        np.log(named("scale_0", "scale_1", "scale_2")),
        named("rot_0", "rot_1", "rot_2", "rot_3") * np.array([1, -1, -1, 1], np.float32),
        np.log(table["opacity"] / (1 - table["opacity"])),
        np.stack([named(*keys) for keys in [["f_dc_0", "f_dc_1", "f_dc_2"], *rest]], axis=1)
        * np.array([(-1) ** sum(n.count(a) for a in "xy") for n in HARMONICS], np.float32)[
            : count + 1, None
        ],
    )
    assert_same_shown(in_order(found, splats), splats)


@needs_modules
@pytest.mark.parametrize("format", [SplatFormat.GLB, SplatFormat.GLTF])
@pytest.mark.parametrize("count", [0, 400])
def test_the_khronos_validator_is_content(format: SplatFormat, count: int, tmp_path: Path) -> None:
    path = tmp_path / f"frame.{format}"
    path.write_bytes(encode_splats(trained_like_splats(count, 5, 1), format))
    said = json.loads(run_node("validate.mjs", path))
    # The validator knows neither the extension nor the names of its attributes.
    unknown = {"UNSUPPORTED_EXTENSION", "MESH_PRIMITIVE_INVALID_ATTRIBUTE", "NODE_EMPTY"}
    assert {message["code"] for message in said} <= unknown
    named = [m["pointer"] for m in said if m["code"] == "MESH_PRIMITIVE_INVALID_ATTRIBUTE"]
    assert all("KHR_gaussian_splatting:" in pointer for pointer in named)


needs_ksplat = pytest.mark.skipif(
    NODE is None or not (HERE / "node_modules" / "@mkkellogg").is_dir(),
    reason="@mkkellogg/gaussian-splats-3d is missing: npm, then scripts/setup dev",
)
COUNT = 900
LARGEST = {
    # Errors of the KINDS: f16 from level 1 on; the library truncates colours to bytes.
    0: (0, 1e-6, 1e-6, 0.004, 0.004),
    1: (0.2, 0.001, 0.002, 0.004, 0.004),
    2: (0.2, 0.001, 0.002, 0.004, 0.004),
}


@needs_ksplat
@needs_splat_transform
@pytest.mark.parametrize("degree", [0, 1, 2])
@pytest.mark.parametrize("level", list(LARGEST))
def test_splat_transform_reads_a_ksplat_alike(level: int, degree: int, tmp_path: Path) -> None:
    assert NODE is not None
    source = trained_like_splats(COUNT, 2, degree)
    inside = np.flatnonzero(np.abs(source.means).max(axis=1) < 4)  # floaters have only f16
    source = source.take(inside)
    write_splats(tmp_path / "a.ply", source, SplatFormat.PLY)
    # After records of 33 bytes, the library itself cannot read a second section.
    section_size = 0 if (level, degree) == (2, 1) else 250
    words = [NODE, HERE / "makeksplat.mjs", "a.ply", "a.ksplat", degree, level, section_size]
    subprocess.run([str(w) for w in words], cwd=tmp_path, check=True)
    ours = read_splats(tmp_path / "a.ksplat")
    theirs = read_splats(transformed(tmp_path / "a.ksplat", tmp_path / "b.ply"))
    # For an opacity of 0 or 1, the two readers use different finite logits.
    for a, b in zip(ours.arrays[:3], theirs.arrays[:3], strict=True):
        assert np.abs(a - b).max() < 1e-6
    assert np.abs(ours.opacities - theirs.opacities).max() < 0.001
    assert np.abs(ours.sh - theirs.sh).max() < 1e-6
    errors = largest_errors(ours, source)
    assert len(ours) == len(source)
    assert (errors <= LARGEST[level]).all()
