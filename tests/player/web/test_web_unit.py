"""The modules of player/web that need no page, tested beside them by Node alone:
`node --test player/web/test/*.test.mjs`."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from tests.support.waiting import BOUND_S
from tests.support.web.nodeprocess import NODE

FOLDER = Path(__file__).parents[3] / "player" / "web" / "test"


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.test.mjs")), ids=lambda path: path.name)
def test_the_modules_of_the_player(path: Path) -> None:
    if NODE is None:
        pytest.skip("needs Node.js: apt-get install nodejs")
    command = [NODE, "--test", "--test-reporter=spec", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=5 * BOUND_S)
    assert done.returncode == 0, done.stdout + done.stderr
