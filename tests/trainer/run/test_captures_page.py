"""The code of docs/CAPTURES.md runs as written, and its captures equal the filmed ones."""

from __future__ import annotations

import contextlib
import re
import shutil
import textwrap
from pathlib import Path

import numpy as np
import pytest
import tyro

from tests.support.commands import ROOT, run_ok
from tests.support.suite.once import made_once
from trainer.capture.capture import Capture
from trainer.capture.layout import open_capture
from trainer.capture.layouts import TITLES
from trainer.run.config import TrainConfig
from trainer.score.evaluate import EvaluateConfig

PAGE = (ROOT / "docs" / "CAPTURES.md").read_text(encoding="utf-8")
BLOCKS = [
    textwrap.dedent(block)
    for block in re.findall(r"(?:(?<=\n\n)|^)((?: {4}.*\n|\n(?= {4}))+)", PAGE)
]
WRITTEN = (
    "as-nerfstudio", "as-pictures", "as-colmap", "as-dynamic3dgs", "as-dynerf", "as-easymocap",
    "as-calibrated", "as-solved",
)  # fmt: skip


def is_script(block: str) -> bool:
    return block.startswith(("from ", "import "))


CHECK = "swings-train footage --check rig.png"
OTHERS = [
    line
    for block in BLOCKS
    if not is_script(block)
    for line in block.splitlines()
    if line.startswith(("swings-train", "swings-eval")) and line != CHECK
]
"""Commands that no script waits for."""


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which the page was run, from top to bottom, without OTHERS."""

    def make(root: Path) -> None:
        with contextlib.chdir(root):
            for block in BLOCKS:
                if is_script(block):
                    exec(compile(block, "docs/CAPTURES.md", "exec"), {"__name__": "__main__"})
                    continue
                for line in block.splitlines():
                    if line not in OTHERS:
                        run_line(line)

    return made_once(tmp_path_factory, "captures page", make)


def run_line(line: str) -> None:
    name, *words = line.split()
    pictures = [Path(word) for word in words if word.endswith(".png")]
    told = run_ok(name, *words)
    assert "warning" not in told, f"{line}: {told}"
    assert all(picture.stat().st_size > 10_000 for picture in pictures)


def test_the_other_commands_are_understood() -> None:
    for name, *words in map(str.split, OTHERS):
        if name == "swings-eval":
            assert tyro.cli(EvaluateConfig, args=words).stream == Path("my-stream")
        else:
            assert str(tyro.cli(TrainConfig, args=words).capture) in WRITTEN


@pytest.mark.deep
def test_the_other_commands_run(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder, tmp_path / "page")
    with contextlib.chdir(tmp_path / "page"):
        for line in OTHERS:
            Path("rig.png").unlink(missing_ok=True)
            run_line(line)


def test_the_page_is_understood() -> None:
    assert sum(map(is_script, BLOCKS)) == len(WRITTEN) - 1  # one script writes two
    assert sum(len(block.splitlines()) for block in BLOCKS if not is_script(block)) == 12
    # The text has nothing like a command, because it would not be run.
    assert not re.findall(r"`swings-\w+ ", PAGE)
    pages = [PAGE, *((ROOT / name).read_text("utf-8") for name in ("README.md", "docs/GUIDE.md"))]
    assert not [title for title in TITLES.values() for page in pages if title not in page]


@pytest.mark.parametrize("name", WRITTEN)
def test_what_a_script_wrote_is_what_was_filmed(folder: Path, name: str) -> None:
    footage, capture = open_capture(folder / "footage"), open_capture(folder / name)
    assert capture.num_frames == footage.num_frames == 3
    assert capture.fps == (None if name == "as-colmap" else 30.0)
    assert [capture.cameras[i].camera.name for i in capture.held_out] == ["cam04"]
    for index, entry in enumerate(footage.cameras):
        read = capture.cameras[index].camera
        assert read.name == entry.camera.name
        np.testing.assert_allclose(read.w2c, entry.camera.w2c, atol=1e-9)
        np.testing.assert_allclose(read.intrinsics, entry.camera.intrinsics, atol=1e-9)
        assert np.array_equal(picture_of(capture, index), picture_of(footage, index))
        masks = capture.cameras[index].masks
        assert (masks is not None) == (name in ("as-pictures", "as-dynerf"))
        if masks is not None:
            assert masks.read(1).sum() == 54 * 94
    if name in ("as-nerfstudio", "as-calibrated", "as-solved"):
        assert capture.points is None
        return
    assert capture.points is not None
    assert footage.points is not None
    np.testing.assert_allclose(capture.points.xyz, footage.points.xyz, atol=1e-6)
    assert np.array_equal(capture.points.rgb, footage.points.rgb)


def picture_of(capture: Capture, index: int) -> np.ndarray:
    source = capture.open_images(index)
    picture = source.read(2)
    source.close()
    return picture
