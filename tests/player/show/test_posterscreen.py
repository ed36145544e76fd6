"""The poster: it shows first, with its own aspect ratio, and never causes a failure."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from player.show.posterscreen import MAX_SIDE_PX, read_picture
from tests.support.commands import ROOT
from tests.support.hosted_streams import static_host, write_stream
from tests.support.screen.xserver import x_server

# Plays in a window; prints colours of its first pictures in the middle and on the left.
PLAY = """
import json, sys
import glfw, moderngl, numpy as np
from player.config import PlayConfig
from player.run.playback import play
from player.view.path import Size

shown = []
swap = glfw.swap_buffers

def swap_buffers(window):
    width, height = glfw.get_framebuffer_size(window)
    data = moderngl.get_context().screen.read((0, 0, width, height), components=3, alignment=1)
    picture = np.frombuffer(data, np.uint8).reshape(height, width, 3)[::-1]
    shown.append([picture[height // 2, width // 2].tolist(), picture[height // 2, 2].tolist()])
    swap(window)
    if len(shown) == 3:
        glfw.set_window_should_close(window, True)

glfw.swap_buffers = swap_buffers
play(PlayConfig(sys.argv[1], size=Size(400, 100), background=(0.0, 0.0, 1.0)))
print(json.dumps(shown))
"""


def poster(mode: str = "RGB", size: tuple[int, int] = (64, 48), kind: str = "PNG") -> bytes:
    file = io.BytesIO()
    Image.new(mode, size, "red" if mode != "L" else 128).save(file, kind)
    return file.getvalue()


@pytest.mark.parametrize("hosted", [True, False])
def test_the_poster_shows_before_the_first_frame(tmp_path: Path, hosted: bool) -> None:
    stream = write_stream(tmp_path / "s", 30, poster="poster.png")
    (stream / "poster.png").write_bytes(poster())
    with x_server() as display, static_host(tmp_path) as host:
        done = subprocess.run(
            [sys.executable, "-c", PLAY, f"{host}/s" if hosted else str(stream)],
            cwd=ROOT,
            env={**os.environ, "DISPLAY": display},
            capture_output=True,
            text=True,
            timeout=60,
        )
    assert done.returncode == 0, done.stderr
    shown = json.loads(done.stdout)
    assert shown[0] == [[255, 0, 0], [0, 0, 255]]
    assert shown[-1][0] != [255, 0, 0]


@pytest.mark.parametrize("mode", ["RGB", "L", "RGBA", "P"])
def test_a_picture_is_read_in_any_mode(mode: str) -> None:
    picture = read_picture(poster(mode))
    assert picture is not None
    assert (picture.mode, picture.size) == ("RGBA", (64, 48))


def test_what_is_too_large_is_not_decoded() -> None:
    assert read_picture(poster("L", (MAX_SIDE_PX + 1, 1))) is None
    assert read_picture(poster("L", (MAX_SIDE_PX, 1))) is not None


def test_only_formats_of_posters_are_read() -> None:
    assert read_picture(poster(kind="GIF")) is None
    assert read_picture(poster(kind="JPEG")) is not None


@given(st.binary(max_size=100), st.integers(0, 400), st.sampled_from(["PNG", "JPEG", "WEBP"]))
def test_any_bytes_are_a_picture_or_none(junk: bytes, at: int, kind: str) -> None:
    whole = poster(kind=kind)
    read_picture(whole[:at] + junk + whole[at + len(junk) :])
    read_picture(junk)


def test_a_stream_without_one_has_none() -> None:
    assert read_picture(None) is None
    assert np.asarray(read_picture(poster()))[0, 0].tolist() == [255, 0, 0, 255]
