"""swings-play --background in files: any colour behind the Gaussians, or an alpha channel."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from codec.arrays import Bytes, Floats
from codec.errors import InvalidError
from codec.splats import Splats
from codec.stream import StreamReader
from player import Scene
from player.config import PlayConfig
from player.render.cpu import render_splats
from player.render.renderer import RendererKind
from player.run.playback import play
from player.run.stills import draw_frames
from player.show.background import Colour
from player.show.sink import to_bytes
from player.view.path import Moment

FRAME, WHITE, BLUE = 9, (1.0, 1.0, 1.0), (0.2, 0.4, 1.0)
SH_C0 = 0.28209479177387814


def colours_and_cover(stream: Path) -> tuple[Floats, Floats]:
    """The frame on black, and the coverage of each pixel, which is the picture of white
    Gaussians."""
    reader = StreamReader(stream)
    splats = reader.active_splats(FRAME, reader.manifest.num_layers)
    white = np.zeros_like(splats.sh)
    white[:, 0] = 0.5 / SH_C0
    bare = Splats(*splats.arrays[:-1], white)
    camera, near_m = reader.manifest.camera(None), reader.manifest.near_m
    cover = render_splats(bare, camera, near_m)[..., :1]
    assert 0.2 < float(cover.mean()) < 0.95  # both extremes are rare
    return render_splats(splats, camera, near_m), cover


def before(stream: Path, background: Colour) -> Bytes:
    """The frame in front of a background, computed here."""
    colours, cover = colours_and_cover(stream)
    return to_bytes((colours + (1 - cover) * background).astype(np.float32))


def config(stream: Path, out: Path, background: Colour | None, **more: Any) -> PlayConfig:
    cpu = RendererKind.CPU
    return PlayConfig(str(stream), capture=out, background=background, renderer=cpu, **more)


def read(path: Path) -> Bytes:
    return np.asarray(Image.open(path))


def assert_same(found: Bytes, expected: Bytes) -> None:
    assert found.shape == expected.shape
    assert int(np.abs(found.astype(int) - expected).max()) <= 1  # rounding


def test_stills_and_captures_stand_before_any_colour(stream: Path, tmp_path: Path) -> None:
    expected = before(stream, BLUE)
    draw_frames(config(stream, tmp_path / "still.png", BLUE, still=Moment(FRAME)))
    assert_same(read(tmp_path / "still.png"), expected)
    play(config(stream, tmp_path / "all", WHITE))
    assert_same(read(tmp_path / "all" / f"frame_{FRAME:05d}.png"), before(stream, WHITE))
    draw_frames(config(stream, tmp_path / "turn", BLUE, still=Moment(FRAME), turntable=0.1))
    assert_same(read(tmp_path / "turn" / "frame_00000.png"), expected)


def test_a_transparent_png_composited_elsewhere_is_the_picture_on_that_colour(
    stream: Path, tmp_path: Path
) -> None:
    draw_frames(config(stream, tmp_path / "out.png", None, still=Moment(FRAME)))
    play(config(stream, tmp_path / "all", None))
    out = tmp_path / "all" / f"frame_{FRAME:05d}.png"
    assert_same(read(tmp_path / "out.png"), read(out))
    image = Image.open(out)
    assert image.mode == "RGBA"
    colours, cover = colours_and_cover(stream)
    assert_same(read(out)[..., 3:], to_bytes(cover))
    # Pillow's own "over" uses straight alpha, like every program that reads PNG, and straight
    # alpha cannot represent colours brighter than their alpha.
    sayable = (colours <= cover).all(axis=-1)
    assert sayable.mean() > 0.8
    for background in (WHITE, BLUE, (0.0, 0.0, 0.0)):
        ground = Image.new("RGBA", image.size, tuple(round(255 * part) for part in background))
        shown = np.asarray(Image.alpha_composite(ground, image))[..., :3].astype(int)
        exact = before(stream, background)
        assert int(np.abs(shown - exact)[sayable].max()) <= 2


def test_opengl_covers_what_the_cpu_covers(stream: Path) -> None:
    pytest.importorskip("moderngl")
    with Scene.open(stream, renderer="cpu") as by_cpu, Scene.open(stream, renderer="gl") as by_gl:
        for background in (None, BLUE):
            expected = by_cpu.render(FRAME, background=background)
            try:
                found = by_gl.render(FRAME, background=background)
            except InvalidError:
                pytest.skip("OpenGL does not work here")
            assert expected.shape[2] == (4 if background is None else 3)
            if background is None:  # premultiplied: nearly transparent pixels have any colour
                expected, found = expected * expected[..., 3:], found * found[..., 3:]
            np.testing.assert_allclose(found, expected, atol=4e-3)
