"""The window itself, on an X server without a screen."""

from __future__ import annotations

import io
import re
from pathlib import Path

import glfw
import numpy as np
import pytest
from PIL import Image

from codec.framerange import FrameRange
from codec.stream import StreamReader
from codec.stream.captions import Captions
from codec.tracks.streamtracks import add_captions
from player.config import PlayConfig
from player.playout.conductor import Conductor
from player.playout.timeline import FrameRecord
from player.render.renderer import GlVersion
from player.show import window
from player.show.overlay import BAR_PX, text_panel
from player.view.path import Size
from tests.player.show.windowed import Acts, Person
from tests.support.commands import run
from tests.support.hosted_streams import static_host, write_stream
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.trained_updates import trained_like_layout
from tests.support.sounding import add_clicks


@pytest.mark.parametrize(
    ("num_frames", "loop", "version"), [(40, 1, GlVersion.AUTO), (5, 9, GlVersion.V43)]
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
        while len(seen) <= 7:
            seen.add(person.conductor._newest)
            yield

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
    stream = write_busy_stream(tmp_path / "s", 40, trained_like_layout(100, 2, 5), fps=4.0)

    def acts(person: Person) -> Acts:
        between: set[bytes] = set()
        frame = None
        while len(between) < 3:  # different pictures while no other frame has come
            if person.conductor._newest is not frame:
                frame, between = person.conductor._newest, set()
            between.add(person.pictures[-1].tobytes())
            yield

    person.watches(PlayConfig(str(stream), rate=0.1), acts)


def test_the_poster_shows_before_the_first_frame(
    person: Person, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    poll = Conductor.poll  # which has no frame yet
    monkeypatch.setattr(Conductor, "poll", lambda self: poll(self) if person.pictures else [])
    stream, poster = write_stream(tmp_path / "s", 30, poster="poster.png"), io.BytesIO()
    Image.new("RGB", (64, 48), "red").save(poster, "PNG")
    (stream / "poster.png").write_bytes(poster.getvalue())

    def acts(person: Person) -> Acts:
        yield from person.until(lambda: len(person.pictures) >= 3)

    with static_host(tmp_path) as host:
        size, blue = Size(400, 100), (0.0, 0.0, 1.0)
        person.watches(PlayConfig(f"{host}/s", size=size, background=blue), acts)
    first, last = person.pictures[0], person.pictures[-1]
    assert [first[50, 200].tolist(), first[50, 2].tolist()] == [[255, 0, 0], [0, 0, 255]]
    assert last[50, 200].tolist() != [255, 0, 0]


def test_without_a_display_one_line_says_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    done = run("swings-play", write_stream(tmp_path / "s", 5))
    assert done.returncode == 1
    assert done.stderr.startswith("swings-play: cannot open a window")
    assert "--capture" in done.stderr
    assert done.stderr.count("\n") == 1


FRAMES = 60


@pytest.fixture(scope="module")
def stream(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_stream(tmp_path_factory.mktemp("keys") / "s", FRAMES)


def config(stream: Path, **more: object) -> PlayConfig:
    return PlayConfig(str(stream), size=Size(320, 240), mute=True, **more)  # type: ignore[arg-type]


def test_time_stands_steps_and_is_sought(stream: Path, person: Person, tmp_path: Path) -> None:
    def acts(person: Person) -> Acts:
        moving = person.seen
        yield from person.until(lambda: person.differs(moving) > 0.01)
        person.presses(glfw.KEY_SPACE)
        yield from person.rests()
        still = person.seen
        person.presses(glfw.KEY_PERIOD)
        yield from person.until(lambda: person.differs(still) > 0.001)
        person.presses(glfw.KEY_COMMA)
        # The same picture, although it was requested again.
        yield from person.until(lambda: person.differs(still) == 0)
        person.presses(glfw.KEY_RIGHT)
        yield from person.rests()
        assert person.differs(still) > 0.01
        person.presses(glfw.KEY_LEFT)
        yield from person.until(lambda: person.differs(still) == 0)
        person.presses(glfw.KEY_HOME)
        yield from person.rests()
        first = person.seen
        person.presses(glfw.KEY_END)
        yield from person.rests()
        last = person.seen
        assert person.differs(first) > 0.01
        person.presses(glfw.KEY_SPACE)  # at the end: restarts
        yield from person.until(lambda: person.differs(last) > 0.01)

    summary = person.watches(config(stream, report=tmp_path / "r.json"), acts)
    frames = [one.record.frame for one in summary.journal.frames.all()]
    assert FRAMES - 1 in frames
    assert frames.count(0) >= 3  # at the start, by Home, and after the end
    # The shown frames: a step forward, one back, a second forward and back.
    back = next(n for n in range(len(frames)) if frames[n + 1] < frames[n]) + 1
    stood = frames[back]
    assert frames[back - 2 : back + 3] == [stood, stood + 1, stood, stood + 30, stood]


def test_captions_show_and_a_key_hides_them(person: Person, tmp_path: Path) -> None:
    stream = write_stream(tmp_path / "s", FRAMES)
    (tmp_path / "in.vtt").write_text("WEBVTT\n\n00:00.000 --> 01:00.000\nWWWW WWWW\n")
    add_captions(stream, tmp_path / "in.vtt", Captions("en", "English"))

    def acts(person: Person) -> Acts:
        person.presses(glfw.KEY_SPACE)
        person.presses(glfw.KEY_C)  # none
        yield from person.rests()
        hidden = person.seen
        person.presses(glfw.KEY_C)
        yield from person.until(lambda: person.differs(hidden) > 0.001)
        yield from person.rests()
        height_px, width_px = hidden.shape[:2]
        rows, columns = np.nonzero((person.seen != hidden).any(axis=2))
        assert rows.min() > (height_px + BAR_PX) / 2
        assert abs(columns.min() + columns.max() - width_px) < 12, "in the middle"
        person.presses(glfw.KEY_C)
        yield from person.until(lambda: person.differs(hidden) == 0)

    person.watches(config(stream, captions="en"), acts)


def test_the_bar_seeks_to_where_it_is_dragged_and_a_background_shows(
    stream: Path, person: Person
) -> None:
    def acts(person: Person) -> Acts:
        person.presses(glfw.KEY_SPACE)
        yield from person.rests()
        corners = person.seen[[0, 0, -1, -1], [0, -1, 0, -1]].astype(int)
        # The other corners may be behind the rim of a Gaussian.
        assert np.abs(corners - [0xFF, 0x66, 0x33]).max(axis=1).min() <= 8
        # A Gaussian that hides it.
        assert (person.seen[:, :, 0] < 100).any()
        y_px = 240 - BAR_PX // 2
        person.drags(glfw.MOUSE_BUTTON_LEFT, (160, y_px), (80, y_px), (240, y_px))
        yield from person.rests()
        bar = person.pictures[-1][-BAR_PX:].astype(int)
        blue = (bar[:, :, 2] - bar[:, :, 0] > 60).any(axis=0)  # the played part
        assert blue[160]
        assert not blue[280]
        assert abs(person.conductor.state().frame - 3 * FRAMES // 4) < FRAMES // 20

    person.watches(config(stream, background=(1.0, 0.4, 0.2)), acts)


def test_mouse_and_keys_move_the_camera(
    stream: Path, person: Person, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = [""]
    show = lambda lines: said.append(lines[-1]) or text_panel(lines)  # type: ignore[func-returns-value]  # noqa: E731
    monkeypatch.setattr(window, "text_panel", show)
    left, right = glfw.MOUSE_BUTTON_LEFT, glfw.MOUSE_BUTTON_RIGHT

    def acts(person: Person) -> Acts:
        person.presses(glfw.KEY_SPACE)
        yield from person.rests()
        before = person.seen
        for key in (glfw.KEY_I, glfw.KEY_H):  # how it stands, and what keys do
            shown = person.seen
            person.presses(key)
            yield from person.until(lambda shown=shown: person.differs(shown) > 0.05)  # type: ignore[misc]
        person.presses(glfw.KEY_H)
        person.drags(left, (200, 90))
        yield from person.until(lambda: re.fullmatch(r"pointer on( -?\d+\.\d{3}){3}", said[-1]))
        seen = StreamReader(stream).manifest.camera().fitted(320, 240)
        point = np.array(said[-1].split()[2:], np.float64)
        np.testing.assert_allclose(seen.project(point)[:2], (200, 90), atol=1)
        person.presses(glfw.KEY_I)
        yield from person.until(lambda: person.differs(before) == 0)
        for act in ("pan", "wheel", "fly", "turn"):
            person.presses(glfw.KEY_R)
            yield from person.until(lambda: person.differs(before) == 0)
            if act == "wheel":
                person.scrolls(1)
            elif act == "fly":
                yield from person.flies(glfw.KEY_W)
            else:
                person.drags(right if act == "pan" else left, (100, 100), (140, 100), (160, 90))
            yield from person.rests()
            assert person.differs(before) > 0.05, act

    person.watches(config(stream), acts)


def test_rate_loop_and_full_screen_by_keys(stream: Path, person: Person, tmp_path: Path) -> None:
    frames, report = FrameRange(50, 60), tmp_path / "r.json"

    def acts(person: Person) -> Acts:
        conductor = person.conductor
        person.presses(glfw.KEY_L)
        person.presses(glfw.KEY_RIGHT_BRACKET)
        person.presses(glfw.KEY_RIGHT_BRACKET)
        assert conductor.state().rate == 2.0
        person.presses(glfw.KEY_BACKSPACE)
        assert conductor.state().rate == 1.0
        assert conductor.state().loops
        person.presses(glfw.KEY_F)
        yield from person.until(lambda: person.pictures[-1].shape[:2] == (480, 640))
        person.presses(glfw.KEY_ESCAPE)
        yield from person.until(lambda: person.pictures[-1].shape[:2] == (240, 320))
        plays = conductor._number + 2
        yield from person.until(lambda: conductor._number >= plays)
        person.presses(glfw.KEY_ESCAPE)
        yield from person.until(lambda: False)  # until the window closes

    summary = person.watches(config(stream, frames=frames, report=report), acts)
    assert summary.num_plays >= 3
    assert {one.record.frame for one in summary.journal.frames.all()} == {*range(50, 60)}


def test_sound_plays_in_the_window_and_is_muted(person: Person, tmp_path: Path) -> None:
    stream = write_stream(tmp_path / "s", FRAMES)
    add_clicks(stream, range(0, FRAMES, 10))

    def acts(person: Person) -> Acts:
        moving = person.seen
        for key in (glfw.KEY_M, glfw.KEY_UP, glfw.KEY_DOWN, glfw.KEY_M):
            person.presses(key)
        yield from person.until(lambda: person.differs(moving) > 0.01)

    summary = person.watches(PlayConfig(str(stream), volume=0.3), acts)
    assert summary.sound is not None
    assert summary.sound.failed_segments == 0
