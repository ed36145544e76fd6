"""Drawing a capture in its own axes."""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np
import pytest
from matplotlib.font_manager import findfont, fontManager
from matplotlib.ft2font import FT2Font
from matplotlib.text import Text
from PIL import Image

from codec.arrays import Doubles
from codec.camera import Camera, look_at, rotation_about
from tests.support.footage.checking import checked, said
from tests.support.tiny_capture import write_dynamic3dgs, write_dynerf
from trainer.capture.capture import Capture
from trainer.capture.layout import open_capture
from trainer.rig.rigdrawing import axis_name, draw_capture, drawn_axes, families_for


def test_picture_shows_cameras_and_points_and_appears_whole(tmp_path: Path) -> None:
    write_dynamic3dgs(tmp_path / "c")
    rng = np.random.default_rng(3)
    xyz = rng.normal(0, 0.4, (500, 3)) - (0, 1, 0)
    xyz[0] = 1e6
    rgb = np.tile([200, 0, 200], (500, 1))
    np.savez(tmp_path / "c/init_pt_cld.npz", data=np.hstack([xyz, rgb / 255]))
    target = tmp_path / "new/picture.png"
    lines = checked(tmp_path / "c", check=target)
    assert said(lines, "picture") == str(target)
    assert [entry.name for entry in target.parent.iterdir()] == ["picture.png"]
    with Image.open(target) as image:
        assert image.format == "PNG"
        pixels = np.array(image.convert("RGB")).astype(int)
    for colour, least in (((31, 95, 191), 300), ((217, 72, 15), 100), ((200, 0, 200), 500)):
        assert (np.abs(pixels - colour).max(axis=-1) < 12).sum() > least
    before = target.read_bytes()
    draw_capture(open_capture(tmp_path / "c"), target)
    assert target.read_bytes() == before


def camera_at(pose: Doubles) -> Camera:
    return Camera("cam00", 64, 36, 50.0, 50.0, 32.0, 18.0, pose)


def test_odd_rigs_are_drawn_too(tmp_path: Path) -> None:
    write_dynerf(tmp_path / "c")
    capture = open_capture(tmp_path / "c")
    still, flipped = np.eye(4), np.diag([-1.0, -1.0, 1.0, 1.0])
    downward = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    for poses in ([still], [still, still], [still, flipped], [downward, downward]):
        cameras = tuple(replace(capture.cameras[0], camera=camera_at(p)) for p in poses)
        axes = drawn_axes([c.camera for c in cameras])
        assert np.allclose(axes @ axes.T, np.eye(3))
        assert np.linalg.det(axes) == pytest.approx(1)
        draw_capture(replace(capture, cameras=cameras), tmp_path / "odd.png")


def test_the_axes_are_the_captures_own() -> None:
    for tops, names in (
        ((0.0, -1.0, 0.0), ["x", "z", "-y"]),  # OpenCV
        ((0.1, 0.2, 0.95), ["x", "y", "z"]),
        ((0.0, 1.0, 0.3), ["x", "-z", "y"]),  # OpenGL
        ((-1.0, 0.5, 0.0), ["y", "-z", "-x"]),
    ):
        up = np.array(tops)
        aside = np.cross(up, (0.3, 0.5, -0.7))
        axes = drawn_axes([camera_at(look_at(s * aside, np.zeros(3), up)) for s in (1.0, -1.0)])
        assert [axis_name(row) for row in axes] == names
        assert np.linalg.det(axes) == pytest.approx(1)  # no mirror image


def texts_of(capture: Capture, path: Path) -> str:
    """All text in the picture."""
    with patch("matplotlib.figure.Figure.savefig", autospec=True) as saved:
        saved.side_effect = lambda figure, *_, **__: figure.canvas.draw()
        with suppress(FileNotFoundError):  # nothing was written
            draw_capture(capture, path)
    (figure,) = saved.call_args.args[:1]
    return "|".join(text.get_text() for text in figure.findobj(Text))


def test_its_numbers_are_the_captures_in_an_unknown_unit_and_a_tilt_is_told(tmp_path: Path) -> None:
    write_dynamic3dgs(tmp_path / "c")
    capture = open_capture(tmp_path / "c")
    texts = texts_of(capture, tmp_path / "rig.png")
    for wanted in ("from above: along y", "from the side: along z", "x (units)", "y (units)"):
        assert wanted in texts
    told = [text.replace("\N{MINUS SIGN}", "-") for text in texts.split("|")]
    numbers = [float(text) for text in told if re.fullmatch(r"-?\d+(\.\d+)?", text)]
    assert min(numbers) < -2  # cameras are 1 to 2 above the floor, where y is below 0
    assert "degrees off" not in texts
    tilt = np.eye(4)
    tilt[:3, :3] = rotation_about(np.array([1.0, 0.0, 0.0]), np.radians(35))
    cameras = tuple(
        replace(c, camera=replace(c.camera, w2c=c.camera.w2c @ tilt)) for c in capture.cameras
    )
    texts = texts_of(replace(capture, cameras=cameras), tmp_path / "rig.png")
    assert re.search(r"up, as the cameras are held, is 35 degrees off -y", texts)


def named(capture: Capture, names: list[str]) -> Capture:
    cameras = tuple(
        replace(c, camera=replace(c.camera, name=name))
        for c, name in zip(capture.cameras, names, strict=True)
    )
    return replace(capture, cameras=cameras)


def test_names_that_no_font_has_become_numbers(tmp_path: Path) -> None:
    write_dynamic3dgs(tmp_path / "c")
    names = ["カメラ1", "左", "相机$x$", "cam_4"]
    capture = named(open_capture(tmp_path / "c"), names)
    with patch("trainer.rig.rigdrawing.fontManager", SimpleNamespace(ttflist=[])):
        texts = texts_of(capture, tmp_path / "rig.png").split("|")
        with patch("trainer.run.check.open_capture", lambda *_: capture):
            lines = checked(tmp_path / "c", check=tmp_path / "rig.png")
    assert {"0", "1", "2", "3"} <= set(texts)
    assert not set(texts) & set(names)
    assert "0 カメラ1, 1 左, 2 相机$x$, 3 cam_4" in said(lines, "labels")


def test_letters_that_matplotlibs_own_font_lacks_are_taken_from_another(tmp_path: Path) -> None:
    missing = "𝕏ﷺ\N{CJK UNIFIED IDEOGRAPH-5DE6}"
    assert families_for(["cam01", "Überblick"]) == ["DejaVu Sans"]
    others = [entry for entry in fontManager.ttflist if entry.name == "STIXGeneral"]
    letters = FT2Font(others[0].fname).get_charmap().keys()
    own = FT2Font(findfont("DejaVu Sans")).get_charmap().keys()
    only_there = chr(min(letters - own))
    write_dynamic3dgs(tmp_path / "c")
    capture = named(open_capture(tmp_path / "c"), [only_there, "b", "c", "$d^2"])
    with patch("trainer.rig.rigdrawing.fontManager", SimpleNamespace(ttflist=others)):
        assert families_for([only_there]) == ["DejaVu Sans", "STIXGeneral"]
        assert families_for([missing]) is None
        assert draw_capture(capture, tmp_path / "rig.png")
