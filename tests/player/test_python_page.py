"""What docs/PYTHON.md shows runs as it stands there."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
import textwrap
from dataclasses import replace
from pathlib import Path

import pytest

from tests.support.commands import ENTRY, ROOT, command, environment
from tests.support.tiny_capture import write_dynerf
from tests.support.tiny_stream import tiny_manifest, write_tiny

HAS_VISER = importlib.util.find_spec("viser") is not None

PAGE = (ROOT / "docs" / "PYTHON.md").read_text(encoding="utf-8")
BLOCKS = [
    textwrap.dedent(block)
    for block in re.findall(r"(?:(?<=\n\n)|^)((?: {4}.*\n|\n(?= {4}))+)", PAGE)
]
SCRIPTS = [block for block in BLOCKS if re.match("(from|import) ", block)]
COMMANDS = [line for block in BLOCKS if block not in SCRIPTS for line in block.splitlines()]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With my-capture and my-stream."""
    root = tmp_path_factory.mktemp("page")
    cameras = tuple(write_dynerf(root / "my-capture", num_frames=40))
    manifest = replace(tiny_manifest(), cameras=cameras, default_camera=cameras[1].name)
    write_tiny(root / "my-stream", 40, manifest)
    return root


def test_the_page_is_understood() -> None:
    assert len(SCRIPTS) == 5
    assert len(COMMANDS) == 6
    assert sum("viser" in block for block in [*SCRIPTS, *COMMANDS]) == 2


@pytest.mark.parametrize("script", SCRIPTS, ids=range(len(SCRIPTS)))
def test_a_script_runs(folder: Path, script: str) -> None:
    if "viser" in script and not HAS_VISER:
        pytest.skip("viser is not installed (extra viser)")
    done = subprocess.run(
        [sys.executable, "-W", "error::ResourceWarning", "-c", script],
        cwd=folder,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert (done.returncode, done.stderr) == (0, "")
    named = re.findall(r'"([a-z]+\.[a-z]+)"', script)
    assert all((folder / name).stat().st_size > 100 for name in named)


@pytest.mark.parametrize("line", COMMANDS)
def test_a_command_runs(folder: Path, line: str) -> None:
    name, *words = line.split()
    assert name in ENTRY
    if "--viser" in words:
        pytest.skip("runs until it is ended; test_viserview.py runs it")
    done = subprocess.run(
        command(name, *words),
        cwd=folder,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    written = [word for word in words if word.endswith((".png", ".mp4"))]
    assert len(written) == 1
    assert (folder / written[0]).stat().st_size > 100
