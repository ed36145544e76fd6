"""The generated parts of the browser player's sources are not stale."""

from __future__ import annotations

from pathlib import Path

import pytest

from scripts.webmodules import modules


@pytest.mark.parametrize("path", modules(), ids=lambda path: path.name)
def test_what_is_generated_is_not_stale(path: Path) -> None:
    assert path.read_text(encoding="utf-8") == modules()[path], "stale: run scripts/webmodules"
