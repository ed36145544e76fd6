"""A simulated user of the window: keys and mouse through an X server, and the resulting pixels."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np
import pytest

from codec.stream.captions import Captions
from codec.tools.streamcaptions import add_captions
from player.show.overlay import BAR_PX
from tests.support.commands import ROOT
from tests.support.hosted_streams import write_stream
from tests.support.screen.xserver import Person, Pixels, x_server
from tests.support.sounding import add_clicks

FRAMES = 300
SIZE = "320x240"


@contextmanager
def playing(stream: Path, report: Path, *options: str) -> Iterator[Person]:
    """A user in front of a window that plays `stream`; escape must end it."""
    with x_server() as display:
        command = [sys.executable, "-m", "player", str(stream), "--size", SIZE]
        process = subprocess.Popen(
            [*command, "--report", str(report), *options],
            cwd=ROOT,
            env={**os.environ, "DISPLAY": display},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            with closing(Person(display, "swings:")) as person:
                person.wait_for(lambda: person.sees().max() > 50)
                yield person
                person.presses("Escape")
                out, err = process.communicate(timeout=30)
                # A test machine may have no sound device.
                err = re.sub("swings-play: WARNING .*: playing without sound: .*\n", "", err)
                assert (process.returncode, err) == (0, ""), out + err
        finally:
            process.kill()
            process.communicate()


@pytest.fixture(scope="module")
def stream(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_stream(tmp_path_factory.mktemp("keys") / "s", FRAMES)


def scene(seen: Pixels) -> Pixels:
    """The picture without the strip of the bar."""
    return seen[:-BAR_PX]


def differ(one: Pixels, other: Pixels) -> float:
    """Share of the scene's pixels that differ."""
    return float((scene(one) != scene(other)).any(axis=2).mean())


def frames_of(report: Path) -> list[int]:
    return [shown["frame"] for shown in json.loads(report.read_text())["frames"]]


def test_time_stands_steps_and_is_sought(stream: Path, tmp_path: Path) -> None:
    report = tmp_path / "r.json"
    with playing(stream, report) as person:
        moving = person.sees()
        person.wait_for(lambda: differ(moving, person.sees()) > 0.01)
        person.presses("space")
        still = person.sees_rest()
        person.presses("period")
        person.wait_for(lambda: differ(still, person.sees()) > 0.001)
        person.presses("comma")
        # The same picture, although it was requested again.
        person.wait_for(lambda: differ(still, person.sees()) == 0)
        person.presses("Right")
        after = person.sees_rest()
        assert differ(still, after) > 0.01
        person.presses("Left")
        person.wait_for(lambda: differ(still, person.sees()) == 0)
        person.presses("Home")
        first = person.sees_rest()
        person.presses("End")
        last = person.sees_rest()
        assert differ(first, last) > 0.01
        person.presses("space")  # at the end: restarts
        person.wait_for(lambda: differ(last, person.sees()) > 0.01)
    frames = frames_of(report)
    assert FRAMES - 1 in frames
    assert frames.count(0) >= 3  # at the start, by Home, and after the end
    # The shown frames: a step forward, one back, a second forward and back.
    back = next(n for n in range(len(frames)) if frames[n + 1] < frames[n]) + 1
    stood = frames[back]
    assert frames[back - 2 : back + 3] == [stood, stood + 1, stood, stood + 30, stood]


def test_captions_show_and_a_key_hides_them(tmp_path: Path) -> None:
    stream = write_stream(tmp_path / "s", FRAMES)
    (tmp_path / "in.vtt").write_text("WEBVTT\n\n00:00.000 --> 01:00.000\nWWWW WWWW\n")
    add_captions(stream, tmp_path / "in.vtt", Captions("en", "English"))
    with playing(stream, tmp_path / "r.json", "--captions", "en") as person:
        person.presses("space")
        shown = person.sees_rest()
        person.presses("c")
        person.wait_for(lambda: differ(shown, person.sees()) > 0.001)
        hidden = person.sees_rest()
        rows, columns = np.nonzero((shown != hidden).any(axis=2))
        height_px, width_px = shown.shape[:2]
        assert rows.min() > height_px / 2
        assert rows.max() < height_px - BAR_PX
        assert abs(columns.min() + columns.max() - width_px) < 12, "in the middle"
        person.presses("c")
        person.wait_for(lambda: differ(shown, person.sees()) == 0)


def test_the_bar_seeks_to_where_it_is_dragged(stream: Path, tmp_path: Path) -> None:
    report = tmp_path / "r.json"
    with playing(stream, report) as person:
        person.presses("space")
        person.sees_rest()
        width_px, height_px = person.size_px
        y_px = height_px - BAR_PX // 2
        person.drags(1, (width_px // 2, y_px), (width_px // 4, y_px), (3 * width_px // 4, y_px))
        there = person.sees_rest()
        bar = there[-BAR_PX:].astype(int)
        blue = (bar[:, :, 2] - bar[:, :, 0] > 60).any(axis=0)  # the played part
        assert blue[width_px // 2]
        assert not blue[7 * width_px // 8]
    assert abs(frames_of(report)[-1] - 3 * FRAMES // 4) < FRAMES // 20


def test_the_mouse_and_keys_move_the_camera_and_r_brings_it_back(
    stream: Path, tmp_path: Path
) -> None:
    with playing(stream, tmp_path / "r.json") as person:
        person.presses("space")
        person.points(5, 5)
        before = person.sees_rest()

        def moved_by(act: str) -> None:
            seen = person.sees_rest()
            assert differ(before, seen) > 0.05, act
            person.presses("r")
            person.wait_for(lambda: differ(before, person.sees()) == 0)

        person.drags(1, (100, 100), (140, 100), (160, 90))
        moved_by("turn")
        person.drags(3, (100, 100), (140, 100))
        moved_by("pan")
        person.drags(4, (100, 100))
        moved_by("wheel")
        person.holds("w", 0.5)
        moved_by("fly")


def test_where_the_camera_went_plays_again(stream: Path, tmp_path: Path) -> None:
    recorded = tmp_path / "path.json"
    with playing(stream, tmp_path / "r.json", "--record", str(recorded)) as person:
        person.presses("space")
        person.drags(1, (100, 100), (140, 100), (160, 90))
        person.points(5, 5)
        turned = person.sees_rest()
    last = json.loads(recorded.read_text())[-1]["frame"]
    options = ("--camera", str(recorded), "--frames", f"{last}:{FRAMES}")
    with playing(stream, tmp_path / "r2.json", *options) as person:
        person.presses("space")
        person.presses("Home")
        person.points(5, 5)
        again = person.sees_rest()
    apart = np.abs(scene(turned).astype(int) - scene(again).astype(int))
    assert np.quantile(apart, 0.99) <= 2  # within half a pixel


def test_the_overlays_say_how_it_stands_and_what_keys_do(stream: Path, tmp_path: Path) -> None:
    with playing(stream, tmp_path / "r.json") as person:
        person.presses("space")
        before = person.sees_rest()
        person.presses("i")
        person.wait_for(lambda: differ(before, person.sees()) > 0.05)
        info = person.sees()
        person.presses("h")
        person.wait_for(lambda: differ(info, person.sees()) > 0.05)
        person.presses("h")
        person.presses("i")
        person.wait_for(lambda: differ(before, person.sees()) == 0)


def test_the_background_shows_where_nothing_is_in_front_of_it(stream: Path, tmp_path: Path) -> None:
    with playing(stream, tmp_path / "r.json", "--background", "3366ff") as person:
        person.presses("space")
        person.points(5, 5)
        seen = person.sees_rest()
        corners = seen[[0, 0, -1, -1], [0, -1, 0, -1]].astype(int)
        # The other corners may be behind the rim of a Gaussian.
        assert np.abs(corners - [0x33, 0x66, 0xFF]).max(axis=1).min() <= 8
        # A Gaussian that hides it.
        assert (scene(seen)[:, :, 2] < 100).any()


def test_rate_and_loop_by_keys(stream: Path, tmp_path: Path) -> None:
    report = tmp_path / "r.json"
    with playing(stream, report, "--frames", "280:300") as person:
        person.presses("l")
        for _ in range(3):
            person.presses("bracketright")
        time.sleep(1.5)
    frames = np.array(frames_of(report))
    anew = int((np.diff(frames) < 0).sum())
    # A turn lasts 20 frames: 0.67 s as filmed, 0.17 s at four times that.
    assert anew >= 4
    assert set(frames.tolist()) == set(range(280, 300))


def test_full_screen_fills_the_screen_and_escape_leaves_it(stream: Path, tmp_path: Path) -> None:
    with playing(stream, tmp_path / "r.json") as person:
        assert person.size_px == (320, 240)
        person.presses("f")
        person.wait_for(lambda: person.size_px == (640, 480))
        person.presses("Escape")
        person.wait_for(lambda: person.size_px == (320, 240))


def test_sound_plays_in_the_window_and_is_muted(tmp_path: Path) -> None:
    stream = write_stream(tmp_path / "s", FRAMES)
    add_clicks(stream, range(0, FRAMES, 10))
    report = tmp_path / "r.json"
    with playing(stream, report, "--volume", "0.3") as person:
        moving = person.sees()
        for key in ("m", "Up", "Down", "m"):
            person.presses(key)
        person.wait_for(lambda: differ(moving, person.sees()) > 0.01)
    sound = json.loads(report.read_text())["sound"]
    assert sound["failed_segments"] == 0
    with playing(stream, report, "--mute") as person:
        person.wait_for(lambda: person.sees().max() > 50)
    assert json.loads(report.read_text())["sound"] is None
