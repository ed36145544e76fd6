""".ksplat files from the library of the format, and SOG folders of splat-transform, read here and
by splat-transform."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from codec.foreign.bundle import encode_bundle
from codec.foreign.sog import decode_sog
from codec.interop.formats import SplatFormat, read_splats, write_splats
from codec.sequence.importing import ImportOptions, import_stream
from codec.stream import StreamReader
from tests.support.alike import largest_errors
from tests.support.drawn import same_splats
from tests.support.trained_like import trained_like_splats

HERE = Path(__file__).parent
NODE = shutil.which("node")
SPLAT_TRANSFORM = HERE / "node_modules" / ".bin" / "splat-transform"
needs_splat_transform = pytest.mark.skipif(
    NODE is None or not SPLAT_TRANSFORM.exists(),
    reason="splat-transform is missing: npm, then scripts/setup dev",
)
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


def transformed(path: Path, out: Path) -> Path:
    words = [SPLAT_TRANSFORM, "-q", "-w", "-g", "cpu", path, out]
    done = subprocess.run([str(w) for w in words], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr or done.stdout
    return out


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


@needs_splat_transform
@pytest.mark.parametrize("degree", [0, pytest.param(3, marks=pytest.mark.deep)])
def test_a_sog_folder_of_splat_transform_is_a_bundle(degree: int, tmp_path: Path) -> None:
    write_splats(tmp_path / "a.ply", trained_like_splats(300, 1, degree), SplatFormat.PLY)
    for number in range(2):
        folder = tmp_path / "frames" / f"frame_{number}"
        folder.mkdir(parents=True)
        if not number:
            transformed(tmp_path / "a.ply", folder / "meta.json")
        else:
            shutil.copytree(folder.with_name("frame_0"), folder, dirs_exist_ok=True)
    # It clusters harmonics at random, so that its bundle would differ.
    data = encode_bundle({path.name: path.read_bytes() for path in folder.iterdir()})
    bundle = decode_sog(data)
    assert same_splats(read_splats(folder), bundle)
    assert same_splats(read_splats(folder / "meta.json"), bundle)
    # A single file is a still model, several are a sequence.
    import_stream(folder, tmp_path / "still", ImportOptions())
    import_stream(tmp_path / "frames", tmp_path / "moving", ImportOptions(fps=10))
    for name, frames in (("still", 1), ("moving", 2)):
        reader = StreamReader(tmp_path / name)
        assert reader.num_frames == frames
        assert len(reader.active_splats(frames - 1, 4)) == len(bundle)
