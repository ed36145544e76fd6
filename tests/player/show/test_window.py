"""The window itself, on an X server without a screen."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path

import glfw
import pytest
from PIL import Image

from player.config import PlayConfig
from player.playout.conductor import Conductor
from player.playout.timeline import FrameRecord
from player.render.renderer import GlVersion
from player.view.path import Size
from tests.player.show.windowed import Acts, Person
from tests.support.commands import ROOT
from tests.support.hosted_streams import static_host, write_stream
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.trained_updates import trained_like_layout


@pytest.mark.parametrize(
    ("num_frames", "loop", "version"),
    [(40, 1, GlVersion.AUTO), (5, 9, GlVersion.AUTO), (5, 9, GlVersion.V43)],
)
def test_a_window_plays_resizes_and_closes(
    person: Person, tmp_path: Path, num_frames: int, loop: int, version: GlVersion
) -> None:
    def acts(person: Person) -> Acts:
        assert person.pictures[0].shape == (48, 64, 3)
        yield from person.until(lambda: len(person.pictures) >= 4)
        glfw.set_window_size(person.window, 100, 90)
        yield from person.until(lambda: person.pictures[-1].shape == (90, 100, 3))
        seen = set[FrameRecord | None]()
        yield from person.until(lambda: seen.add(person.conductor._newest) or len(seen) > 7)

    stream = write_stream(tmp_path / "s", num_frames)
    summary = person.watches(
        PlayConfig(str(stream), report=tmp_path / "r.json", loop=loop, gl=version), acts
    )
    assert min(picture.max() for picture in person.pictures) > 100
    assert len({picture.tobytes() for picture in person.pictures}) > 5
    name = f"OpenGL {version}" if version is not GlVersion.AUTO else "OpenGL"
    assert summary.renderer is not None
    assert summary.renderer.startswith(name)
    shown = summary.journal.frames.all()
    frames = [(one.record.play, one.record.frame) for one in shown]
    assert frames == [divmod(n, num_frames) for n in range(len(frames))]
    assert len(frames) > 5
    undrawn = [one for one in shown if one.drawn_s is None]
    assert len(undrawn) == summary.journal.undrawn_frames < len(frames)


def test_slowed_down_there_are_pictures_between_the_frames(person: Person, tmp_path: Path) -> None:
    stream = write_busy_stream(tmp_path / "s", 40, trained_like_layout(100, 2, 5), fps=8.0)

    def acts(person: Person) -> Acts:
        yield from person.until(lambda: person.conductor.state().frame >= 1)
        frame, before = person.conductor.state().frame, len(person.pictures)
        yield from person.until(lambda: len(person.pictures) >= before + 8)
        # More pictures than frames, and all different.
        assert person.conductor.state().frame < frame + 7
        assert len({one.tobytes() for one in person.pictures[before:]}) > 4

    person.watches(PlayConfig(str(stream), rate=0.1), acts)


@pytest.mark.parametrize("hosted", [True, False])
def test_the_poster_shows_before_the_first_frame(
    person: Person, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, hosted: bool
) -> None:
    poll = Conductor.poll  # which has no frame yet
    monkeypatch.setattr(Conductor, "poll", lambda self: poll(self) if person.pictures else [])
    stream, poster = write_stream(tmp_path / "s", 30, poster="poster.png"), io.BytesIO()
    Image.new("RGB", (64, 48), "red").save(poster, "PNG")
    (stream / "poster.png").write_bytes(poster.getvalue())

    def acts(person: Person) -> Acts:
        yield from person.until(lambda: len(person.pictures) >= 3)

    with static_host(tmp_path) as host:
        source = f"{host}/s" if hosted else str(stream)
        size, blue = Size(400, 100), (0.0, 0.0, 1.0)
        person.watches(PlayConfig(source, size=size, background=blue), acts)
    first, last = person.pictures[0], person.pictures[-1]
    assert [first[50, 200].tolist(), first[50, 2].tolist()] == [[255, 0, 0], [0, 0, 255]]
    assert last[50, 200].tolist() != [255, 0, 0]


def test_without_a_display_one_line_says_what_to_do(tmp_path: Path) -> None:
    stream = write_stream(tmp_path / "s", 5)
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    done = subprocess.run(
        [sys.executable, "-m", "player", str(stream)],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 1
    assert done.stderr.startswith("swings-play: cannot open a window")
    assert "--capture" in done.stderr
    assert done.stderr.count("\n") == 1
