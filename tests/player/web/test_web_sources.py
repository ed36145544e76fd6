"""The browser player as an npm package: its checks, its unit tests, and what npm would ship."""

from __future__ import annotations

from pathlib import Path

import pytest

from scripts.webmodules import modules
from tests.support.web.nodeprocess import packed_once, run_npm


@pytest.mark.parametrize("script", ["stale", "size", "unit"])
def test_its_own_checks_and_tests_pass(script: str) -> None:
    """The bundle is what the sources give, and small enough for a first picture; and the tests of
    modules that need neither a page nor Python. `npm run check` is part of scripts/check."""
    run_npm(script)


def test_what_npm_would_ship_is_whole_and_has_types(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """publint, attw, and consumers in TypeScript; see `npm run package`."""
    assert packed_once(tmp_path_factory).suffix == ".tgz"


@pytest.mark.parametrize("path", modules(), ids=lambda path: path.name)
def test_what_is_generated_is_not_stale(path: Path) -> None:
    assert path.read_text(encoding="utf-8") == modules()[path], "stale: run scripts/webmodules"
