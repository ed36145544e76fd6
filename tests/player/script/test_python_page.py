"""The code of docs/PYTHON.md runs as written."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
import textwrap
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

import codec
from player import Scene
from tests.support.commands import ROOT, environment
from tests.support.tiny_capture import write_dynerf
from tests.support.tiny_stream import tiny_manifest, write_tiny

HAS_GSPLAT = importlib.util.find_spec("gsplat") is not None and torch.cuda.is_available()

STAND_IN = """
import torch
from codec.camera import Camera
from tests.support.reference_render import render_reference


def rasterization(
    *, means, quats, scales, opacities, colors, sh_degree, viewmats, Ks, width, height, near_plane
):
    given = means, quats, scales, opacities, colors, viewmats, Ks
    count, harmonics = len(means), (sh_degree + 1) ** 2
    assert [(*t.shape,) for t in given] == [
        (count, 3), (count, 4), (count, 3), (count,), (count, harmonics, 3), (1, 4, 4), (1, 3, 3)
    ]
    assert {t.dtype for t in given} == {torch.float32}
    assert ((0 < opacities) & (opacities < 1)).all()
    assert (scales > 0).all()
    k = Ks[0].double().numpy()
    camera = Camera(
        "given", width, height, k[0, 0], k[1, 1], k[0, 2], k[1, 2], viewmats[0].double().numpy()
    )
    picture = render_reference(
        means, scales.log(), quats, torch.logit(opacities), colors, camera, near_plane
    )
    return picture[None], None, {}
"""
"""A replacement for gsplat; its arguments must have the same meaning as for gsplat."""

PAGE = (ROOT / "docs" / "PYTHON.md").read_text(encoding="utf-8")
BLOCKS = [
    textwrap.dedent(block)
    for block in re.findall(r"(?:(?<=\n\n)|^)((?: {4}.*\n|\n(?= {4}))+)", PAGE)
]
SCRIPTS = [block for block in BLOCKS if re.match("(from|import) ", block)]
(GSPLAT,) = [script for script in SCRIPTS if "gsplat" in script]
OTHERS = [script for script in SCRIPTS if script is not GSPLAT]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with my-capture and my-stream."""
    root = tmp_path_factory.mktemp("page")
    cameras = tuple(write_dynerf(root / "my-capture", num_frames=40))
    manifest = replace(tiny_manifest(), cameras=cameras, default_camera=cameras[1].name)
    write_tiny(root / "my-stream", 40, manifest)
    return root


@pytest.mark.parametrize("script", OTHERS, ids=range(len(OTHERS)))
def test_a_script_runs(folder: Path, script: str) -> None:
    run_script(script, folder)


def run_script(script: str, folder: Path, **variables: str) -> None:
    done = subprocess.run(
        [sys.executable, "-W", "error::ResourceWarning", "-c", script],
        cwd=folder,
        env={**environment(), **variables},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert (done.returncode, done.stderr) == (0, "")
    named = re.findall(r'"([a-z]+\.[a-z]+)"', script)
    assert all((folder / name).stat().st_size > 100 for name in named)


needs_gsplat = pytest.mark.skipif(not HAS_GSPLAT, reason="gsplat and a GPU are needed")


@pytest.mark.parametrize("gsplat", ["a stand-in", pytest.param("itself", marks=needs_gsplat)])
def test_what_gsplat_is_given_means_to_it_what_it_means_to_us(
    folder: Path, tmp_path: Path, gsplat: str
) -> None:
    variables = {}
    if gsplat != "itself":
        (tmp_path / "gsplat.py").write_text(STAND_IN)
        path = f"{tmp_path}:{environment()['PYTHONPATH']}"
        variables = {"PYTHONPATH": path, "CUDA_VISIBLE_DEVICES": ""}
    run_script(GSPLAT, folder, **variables)
    with Image.open(folder / "gsplat.png") as image:
        drawn = np.asarray(image, np.float32) / 255
    with Scene.open(folder / "my-stream", renderer="cpu") as scene:
        ours = scene.render(30).clip(0, 1)
    assert ours.std() > 0.05
    assert 10 * np.log10(1 / np.mean((drawn - ours) ** 2)) > 45


def test_the_arrays_are_what_the_table_says(folder: Path) -> None:
    assert len(SCRIPTS) == len(BLOCKS) == 7
    rows = dict(re.findall(r"^\| `(\w+)` \| \(([^)]*)\)", PAGE, re.MULTILINE))
    with codec.open_stream(folder / "my-stream") as stream:
        splats = stream.frame(30)
    sizes = {"N": len(splats), "K": splats.sh.shape[1]}
    assert len(rows) == 5
    for name, shape in rows.items():
        array = getattr(splats, name)
        assert array.dtype == np.float32
        said = [one.strip() for one in shape.split(",") if one.strip()]
        assert array.shape == tuple(sizes.get(one) or int(one) for one in said), name
    assert splats.opacities == pytest.approx(1 / (1 + np.exp(-splats.logit_opacities)), abs=1e-6)
