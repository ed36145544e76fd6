"""What several files of this folder train."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.suite.once import made_once
from tests.support.tiny_capture import write_dynerf


@pytest.fixture(scope="session")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture of four cameras and six frames, as dynerf."""

    def make(folder: Path) -> None:
        write_dynerf(folder / "capture", num_cameras=4, num_frames=6)

    return made_once(tmp_path_factory, "capture of runs", make) / "capture"
