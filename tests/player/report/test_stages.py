"""The times of a frame's stages: all frames, in a table and a picture."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from PIL import Image
from rich.console import Console

from codec.errors import InvalidError
from codec.framerange import FrameRange
from player.__main__ import run
from player.config import PlayConfig
from player.render.renderer import GlVersion, RendererKind
from player.report.stageplot import write_stage_plot
from player.report.stages import profile
from tests.support.hosted_streams import write_stream
from tests.support.screen.opengl import GL_VERSIONS


@pytest.fixture
def stream(tmp_path: Path) -> Path:
    return write_stream(tmp_path / "s", 7)


@pytest.mark.parametrize("version", GL_VERSIONS)
def test_every_frame_goes_through_every_stage(version: GlVersion, stream: Path) -> None:
    found = profile(PlayConfig(str(stream), gl=version))
    assert [one.frame for one in found.frames] == list(range(7))
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
    assert "3 frames" in told
    assert "overall" in told
    with Image.open(picture) as drawn:
        assert drawn.size[0] > 500


def test_the_table_adds_up(stream: Path, tmp_path: Path) -> None:
    picture = tmp_path / "one.png"
    one = FrameRange(0, 1)
    found = profile(PlayConfig(str(stream), renderer=RendererKind.CPU, frames=one, profile=picture))
    console = Console(width=100, record=True, file=io.StringIO())
    console.print(found.table())
    row = next(line for line in console.export_text().splitlines() if "median" in line)
    stages_ms = [float(cell) for cell in row.replace("│", " ").split()[1:]]
    assert sum(stages_ms[:-1]) == pytest.approx(stages_ms[-1], abs=0.04)
    write_stage_plot(picture, found)
    assert picture.is_file()


def test_what_does_not_go_with_a_profile_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidError, match="a stream in a folder; http://h is a URL"):
        PlayConfig("http://h", profile=tmp_path / "p.png")
    with pytest.raises(InvalidError, match="--loop cannot be combined with --profile"):
        PlayConfig("s", profile=tmp_path / "p.png", loop=2)
    with pytest.raises(InvalidError, match="there is no folder"):
        PlayConfig("s", profile=tmp_path / "no" / "p.png")
    with pytest.raises(InvalidError, match=r"--gl 4\.3 cannot be combined with --renderer cpu"):
        PlayConfig("s", capture=tmp_path / "o.mp4", renderer=RendererKind.CPU, gl=GlVersion.V43)
