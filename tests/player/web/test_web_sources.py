"""The sources of the browser player: their types (`tsc --checkJs`, strict) and their style."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from scripts.webmodules import modules

HERE = Path(__file__).parent
SCRIPTS = json.loads((HERE / "package.json").read_text())["scripts"]


@pytest.mark.parametrize("name", sorted(SCRIPTS))
def test_the_sources(name: str) -> None:
    if shutil.which("npm") is None or not (HERE / "node_modules").is_dir():
        pytest.skip("needs Node.js with npm: apt-get install npm, then scripts/setup dev")
    command = ["npm", "run", "--silent", name]
    done = subprocess.run(command, cwd=HERE, capture_output=True, text=True, timeout=200)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("path", modules(), ids=lambda path: path.name)
def test_what_is_generated_is_not_stale(path: Path) -> None:
    assert path.read_text(encoding="utf-8") == modules()[path], "stale: run scripts/webmodules"
