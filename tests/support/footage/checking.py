"""Output of swings-train --check for a capture, without a process of its own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from trainer.run.check import check_capture
from trainer.run.config import TrainConfig


def checked(path: Path, **settings: Any) -> list[str]:
    """The lines of output; without `check` nothing is drawn."""
    return check_capture(TrainConfig(path, stream=path / "unused", **settings))


def said(lines: list[str], what: str) -> str:
    """Text of the only line of this name."""
    (found,) = all_said(lines, what)
    return found


def all_said(lines: list[str], what: str) -> list[str]:
    """Text of each line of this name."""
    return [line[12:] for line in lines if line[:12].rstrip() == what]
