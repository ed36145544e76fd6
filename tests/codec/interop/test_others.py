"""What is exported, read by the programs of others: gsply and PlayCanvas' splat-transform.

Neither is a dependency; where one is not installed its tests are skipped with the command that
installs it.
"""

from __future__ import annotations

import contextlib
import importlib
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from codec.interop.exporting import export_stream
from codec.interop.formats import SplatFormat, read_splats
from codec.interop.ply import encode_ply
from codec.profiles.profile import Profile
from codec.sequence.importing import ImportOptions, import_stream
from codec.splats import SH_C0, Splats
from codec.stream import StreamReader
from tests.support.drawn import angles_rad, same
from tests.support.trained_like import trained_like_splats

SPLAT_TRANSFORM = shutil.which("splat-transform")
gsply: Any = None
with contextlib.suppress(ImportError):
    gsply = importlib.import_module("gsply")

needs_gsply = pytest.mark.skipif(gsply is None, reason="gsply is missing: pip install gsply")
needs_splat_transform = pytest.mark.skipif(
    SPLAT_TRANSFORM is None,
    reason="splat-transform is missing: npm install -g @playcanvas/splat-transform",
)
degrees = pytest.mark.parametrize("sh_degree", [0, 1, 2, 3])
formats = pytest.mark.parametrize("format", list(SplatFormat))

# The real harmonics in order, by the axes that each is a product of.
HARMONICS = ["1", *"yzx", "xy", "yz", "zz", "xz", "xx"]
HARMONICS += ["xxy", "xyz", "yzz", "zzz", "xzz", "xxz", "xxx"]
# SPZ has y up and z back: half a turn about x, by which what is odd in y and z changes sign.
TURN = np.array([1, -1, -1], np.float32)
TURN_QUATERNION = np.array([1, 1, -1, -1], np.float32)
TURN_SH = np.array([(-1) ** sum(name.count(a) for a in "yz") for name in HARMONICS], np.float32)


def shown(tmp_path: Path, sh_degree: int) -> tuple[Path, Splats]:
    """A stream of one frame, and what that shows; within what all formats can hold."""
    splats = trained_like_splats(400, 5, sh_degree)
    made = Splats(
        splats.means,
        np.clip(splats.log_scales, -9.9, 5),
        splats.quats,
        # An opacity of exactly 0 or 1, to which 8 bits may round, becomes infinite elsewhere.
        np.clip(splats.logit_opacities, -5, 5),
        splats.sh,
    )
    (tmp_path / "model.ply").write_bytes(encode_ply(made))
    import_stream(tmp_path / "model.ply", tmp_path / "stream", ImportOptions(profile=Profile.RAW))
    reader = StreamReader(tmp_path / "stream")
    return tmp_path / "stream", reader.active_splats(0, reader.manifest.num_layers)


def exported(tmp_path: Path, sh_degree: int, format: SplatFormat) -> tuple[Path, Splats]:
    """A frame as a file, and what it shows, in the order of the file."""
    stream, splats = shown(tmp_path, sh_degree)
    [path] = export_stream(stream, tmp_path / f"frame.{format}", 0, None, None, None)
    if format is SplatFormat.SPLAT:
        importance = splats.log_scales.astype(np.float64).sum(axis=1) + np.log(splats.opacities)
        splats = splats.take(np.argsort(-importance, kind="stable"))
    return path, splats


def assert_within(
    found: Splats, wanted: Splats, format: SplatFormat, harmonic: float = 0.51 / 128
) -> None:
    """That `found` is `wanted`, as precisely as `format` holds it."""
    assert len(found) == len(wanted)
    if format is SplatFormat.PLY:
        assert same(found, wanted)
        return
    spz = format is SplatFormat.SPZ
    close = np.testing.assert_allclose
    # Positions are in 1 / 4096 m in SPZ, else float32; sizes in 1 / 16 of a logarithm.
    close(found.means, wanted.means, rtol=2e-7, atol=0.5 / 4096 + 1e-6 if spz else 0)
    close(found.log_scales, wanted.log_scales, rtol=0, atol=0.5 / 16 + 1e-5 if spz else 1e-5)
    # Three components in 9 bits of 1 / sqrt(2), or four in 8 bits, of which readers differ by one.
    assert angles_rad(found, wanted).max() < (0.005 if spz else 0.03)
    close(found.opacities, wanted.opacities, rtol=0, atol=1 / 255)
    dc_step = 1 / (255 * (0.15 if spz else SH_C0))
    inside = np.abs(wanted.sh[:, 0] * SH_C0) < 0.5 if not spz else np.ones((len(wanted), 3), bool)
    dc_error = np.abs(found.sh[:, 0] - wanted.sh[:, 0])[inside]
    assert dc_error.max() < 0.51 * dc_step
    if spz:
        assert found.sh.shape == wanted.sh.shape
        close(found.sh[:, 1:], wanted.sh[:, 1:], rtol=0, atol=harmonic)


def gsply_splats(path: Path) -> Splats:
    """What gsply reads."""
    read = gsply.read_spz(path) if path.suffix == ".spz" else gsply.plyread(path)
    count = len(read.means)
    parts = [read.sh0.reshape(count, 1, 3)]
    if read.shN is not None and read.shN.size:
        parts.append(read.shN.reshape(count, -1, 3))
    arrays = [read.means, read.scales, read.quats, read.opacities.reshape(-1)]
    arrays.append(np.concatenate(parts, axis=1))
    return Splats(*(np.array(array, np.float32) for array in arrays))


def turned(splats: Splats) -> Splats:
    """`splats` from the frame of SPZ, which gsply leaves as it is, to ours."""
    return Splats(
        splats.means * TURN,
        splats.log_scales,
        splats.quats * TURN_QUATERNION,
        splats.logit_opacities,
        splats.sh * TURN_SH[: splats.sh.shape[1], None],
    )


@needs_gsply
@degrees
def test_gsply_reads_the_ply_bit_by_bit(sh_degree: int, tmp_path: Path) -> None:
    path, splats = exported(tmp_path, sh_degree, SplatFormat.PLY)
    assert_within(gsply_splats(path), splats, SplatFormat.PLY)


@needs_gsply
@degrees
def test_gsply_reads_the_spz(sh_degree: int, tmp_path: Path) -> None:
    path, splats = exported(tmp_path, sh_degree, SplatFormat.SPZ)
    assert path.read_bytes()[:8] == b"NGSP\4\0\0\0"
    assert_within(turned(gsply_splats(path)), splats, SplatFormat.SPZ)


@needs_gsply
@degrees
@pytest.mark.parametrize("version", [3, 4])
def test_the_spz_that_gsply_writes_is_read_alike(
    version: int, sh_degree: int, tmp_path: Path
) -> None:
    stream, splats = shown(tmp_path, sh_degree)
    [path] = export_stream(stream, tmp_path / "frame.ply", 0, None, None, None)
    gsply.write_spz(tmp_path / "theirs.spz", gsply.plyread(path), version=version)
    # It writes what it is given, without turning it.
    assert_within(turned(read_splats(tmp_path / "theirs.spz")), splats, SplatFormat.SPZ)


def transformed(path: Path, out: Path) -> Path:
    """`path` as splat-transform writes it again."""
    assert SPLAT_TRANSFORM is not None
    done = subprocess.run(
        [SPLAT_TRANSFORM, "-q", "-w", str(path), str(out)],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr or done.stdout
    return out


@needs_splat_transform
@degrees
@formats
def test_splat_transform_reads_what_is_exported(
    format: SplatFormat, sh_degree: int, tmp_path: Path
) -> None:
    path, splats = exported(tmp_path, sh_degree, format)
    found = read_splats(transformed(path, tmp_path / "theirs.ply"))
    assert_within(found, splats, format)


@needs_splat_transform
@degrees
def test_the_spz_that_splat_transform_writes_is_read_alike(sh_degree: int, tmp_path: Path) -> None:
    path, splats = exported(tmp_path, sh_degree, SplatFormat.PLY)
    found = read_splats(transformed(path, tmp_path / "theirs.spz"))
    # They come in another order: each is the one that lies where it belongs.
    away = np.abs(splats.means[:, None] - found.means[None]).max(axis=2)
    nearest = away.argmin(axis=1)
    assert sorted(nearest) == list(range(len(splats)))
    # It rounds harmonics to 8 bits, then the first to five of these and the others to four.
    assert_within(found.take(nearest), splats, SplatFormat.SPZ, (8 + 0.51) / 128)
