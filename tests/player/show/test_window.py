"""The window itself, on an X server without a screen."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.commands import ROOT
from tests.support.hosted_streams import write_stream
from tests.support.screen.xserver import x_server
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.trained_updates import trained_like_layout

# Plays in a window, records its pixels, turns the view by mouse and key events and closes it.
PLAY = """
import json, sys
from pathlib import Path

import glfw
import moderngl
import numpy as np

from player.config import PlayConfig
from player.run.playback import play
from player.render.renderer import GlVersion

shown = []
swap = glfw.swap_buffers

def swap_buffers(window):
    width, height = glfw.get_framebuffer_size(window)
    context = moderngl.get_context()
    data = context.screen.read((0, 0, width, height), components=3, alignment=1)
    picture = np.frombuffer(data, np.uint8).reshape(height, width, 3)[::-1]
    shown.append((width, height, int(picture.max()), picture.tobytes()))
    swap(window)
    if len(shown) == 4:
        glfw.set_window_size(window, 100, 90)
    if len(shown) == 12:
        glfw.set_window_should_close(window, True)

glfw.swap_buffers = swap_buffers
version, rate = GlVersion(sys.argv[4]), float(sys.argv[5])
summary = play(
    PlayConfig(sys.argv[1], report=Path(sys.argv[2]), loop=int(sys.argv[3]), gl=version, rate=rate)
)
print(json.dumps({
    "sizes": [s[:2] for s in shown],
    "brightest": [s[2] for s in shown],
    "different": len({s[3] for s in shown}),
    "renderer": summary.renderer,
}))
"""


@pytest.fixture
def display() -> Iterator[str]:
    with x_server() as name:
        yield name


@pytest.mark.parametrize(
    ("num_frames", "loop", "version"), [(40, 1, "auto"), (5, 9, "auto"), (5, 9, "4.3")]
)
def test_a_window_plays_resizes_and_closes(
    display: str, tmp_path: Path, num_frames: int, loop: int, version: str
) -> None:
    stream = write_stream(tmp_path / "s", num_frames)
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            PLAY,
            str(stream),
            str(tmp_path / "r.json"),
            str(loop),
            version,
            "1",
        ],
        cwd=ROOT,
        env={**os.environ, "DISPLAY": display},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["sizes"][0] == [64, 48]
    assert told["sizes"][-1] == [100, 90]
    assert min(told["brightest"]) > 100
    assert told["different"] > 5
    assert told["renderer"].startswith(f"OpenGL {version}" if version != "auto" else "OpenGL")
    summary = json.loads((tmp_path / "r.json").read_text())
    frames = [(f["play"], f["frame"]) for f in summary["frames"]]
    assert frames == [divmod(n, num_frames) for n in range(len(frames))]
    assert len(frames) > 5
    undrawn = [f for f in summary["frames"] if f["drawn_s"] is None]
    assert len(undrawn) == summary["totals"]["undrawn_frames"] < len(frames)


def test_slowed_down_there_are_pictures_between_the_frames(display: str, tmp_path: Path) -> None:
    stream = write_busy_stream(tmp_path / "s", 40, trained_like_layout(100, 2, 5), fps=8.0)
    done = subprocess.run(
        [sys.executable, "-c", PLAY, str(stream), str(tmp_path / "r.json"), "1", "auto", "0.25"],
        cwd=ROOT,
        env={**os.environ, "DISPLAY": display},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    frames = json.loads((tmp_path / "r.json").read_text())["frames"]
    assert told["different"] > len(frames) + 3


def test_without_a_display_one_line_says_what_to_do(tmp_path: Path) -> None:
    stream = write_stream(tmp_path / "s", 5)
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    done = subprocess.run(
        [sys.executable, "-m", "player", str(stream)],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 1
    assert done.stderr.startswith("swings-play: cannot open a window")
    assert "--capture" in done.stderr
    assert done.stderr.count("\n") == 1
