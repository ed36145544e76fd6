"""The times of a frame's stages: all frames, in a table and a picture."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image

from codec.framerange import FrameRange
from player.__main__ import run
from player.config import PlayConfig
from player.render.renderer import GlVersion, RendererKind
from player.report.stages import profile
from tests.support.screen.opengl import GL_VERSIONS


@pytest.mark.parametrize("version", GL_VERSIONS)
def test_every_frame_goes_through_every_stage(version: GlVersion, stream: Path) -> None:
    found = profile(PlayConfig(str(stream), gl=version))
    assert [one.frame for one in found.frames] == list(range(13))
    assert found.renderer.startswith(f"OpenGL {version}")
    # The first frame has a whole window of Gaussians.
    assert found.frames[0].new_gs > found.frames[1].new_gs > 0
    assert all(min(one.stages_ms) > 0 for one in found.frames)


def test_a_part_is_measured_on_the_cpu_and_told(
    stream: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    picture = tmp_path / "p.png"
    frames = FrameRange(2, 5)
    run(PlayConfig(str(stream), renderer=RendererKind.CPU, frames=frames, profile=picture))
    told = capsys.readouterr().out
    assert "3 frames" in " ".join(told.split())  # a long path makes the title two lines
    assert "overall" in told
    with Image.open(picture) as drawn:
        assert drawn.size[0] > 500
