"""Every WebGL program of the bundle, which is what viewers get."""

from __future__ import annotations

from pathlib import Path

import pytest

from codec.tools.static import export_static
from tests.support.slots.moving_updates import write_moving_stream
from tests.support.slots.updates import small_layout
from tests.support.web.chromium import Page
from tests.support.web.site import player_host, watch

PROGRAMS = Path(__file__).with_name("programs.js")

NUM_PROGRAMS = {1: 7, 3: 8}
"""By degree of the harmonics: splats, depths, the screen, two that expand what arrives, two that
draw between frames, and from degree 2 on one for colours."""


@pytest.mark.parametrize("sh_degree", NUM_PROGRAMS)
def test_every_program_compiles_without_a_word(page: Page, tmp_path: Path, sh_degree: int) -> None:
    layout = small_layout(1, (60, 40), sh_degree, 4)
    write_moving_stream(tmp_path / "stream", 60, layout)
    export_static(tmp_path / "stream", tmp_path / "static")
    with player_host(tmp_path) as url:
        watch(page, f"{url}/player/watch.html?src=../static&autoplay=0", scripts=(PROGRAMS,))
        page.run("player.renderer.depthAt(player.view.camera, 80, 60)")
        page.run("element.playbackRate = 0.1; element.play()")
        page.wait(f"window.numPrograms() >= {NUM_PROGRAMS[sh_degree]}")
        found = page.run("return window.complaintsOfPrograms()")
        assert found == [""] * NUM_PROGRAMS[sh_degree]
        page.wait("player.renderer.inbetween !== null")
