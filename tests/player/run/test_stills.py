"""swings-play --still: one frame as a picture or a turn around it, and never a partial file."""

from __future__ import annotations

import json
import math
import signal
import socket
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from codec.framerange import FrameRange
from codec.stream import StreamReader
from player import Scene
from player.config import CameraPathName, PlayConfig
from player.render.cpu import render_splats
from player.render.renderer import RendererKind
from player.run.playback import play
from player.run.stills import draw_frames
from player.show.sink import to_bytes
from player.view.path import Moment, Size, orbit
from tests.support.commands import run_ok, started, unhurried
from tests.support.hosted_streams import served, write_stream
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout
from tests.support.waiting import BOUND_S, wait_until

CPU = RendererKind.CPU


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("library")
    write_stream(root / "whole", 13)
    write_busy_stream(root / "slots", 40, small_layout(4, (60, 60), 0, 15))
    for path in root.iterdir():
        with Scene.open(path, renderer="cpu") as scene:
            scene.render(0)  # compiles here, because a process with a full disk cannot cache it
    return root


@pytest.mark.parametrize("camera", ["default", "camera:c1", "orbit"])
def test_a_still_is_the_frame_of_a_capture(library: Path, tmp_path: Path, camera: str) -> None:
    config = PlayConfig(
        str(library / "slots"),
        camera=CameraPathName(camera),
        size=Size(50, 40),
        layers=1,
        renderer=CPU,
        capture=tmp_path / "all",
    )
    play(config)
    still = replace(config, still=Moment(31), capture=tmp_path / "still.png")
    line = draw_frames(still)
    assert line.startswith("a picture of frame 31 of ")
    assert line.endswith(f"slots, 50x40, by CPU: {tmp_path}/still.png")
    frame, still_frame = tmp_path / "all" / "frame_00031.png", tmp_path / "still.png"
    with Image.open(frame) as expected, Image.open(still_frame) as found:
        np.testing.assert_array_equal(np.asarray(found), np.asarray(expected))


@pytest.mark.parametrize("kind", ["depth", "mask"])
def test_depth_and_mask_are_grey_pngs(library: Path, tmp_path: Path, kind: str) -> None:
    options = ("--still", 9, "--renderer", "cpu", "--picture", kind, "--capture")
    run_ok("swings-play", library / "whole", *options, tmp_path / "still.png")
    with Scene.open(library / "whole", renderer="cpu") as scene:
        depth_m = np.nan_to_num(scene.depth(9))
        alpha = scene.render(9, background=None)[:, :, 3]
    found = np.asarray(Image.open(tmp_path / "still.png"))
    expected = to_bytes(alpha) if kind == "mask" else np.rint(1000 * depth_m).astype(np.uint16)
    assert found.dtype == expected.dtype
    np.testing.assert_array_equal(found, expected)
    assert ((depth_m > 0) == (alpha >= 0.5)).mean() > 0.99
    told = run_ok(
        *("swings-play", library / "whole", *options[2:], tmp_path / "all", "--frames", "9:10")
    )
    assert told.startswith(f"1 pictures of {kind} of ")
    (film,) = (tmp_path / "all").iterdir()
    assert film.name == "frame_00009.png"
    assert film.read_bytes() == (tmp_path / "still.png").read_bytes()


def test_a_turntable_goes_once_around_and_the_frame_stands(library: Path, tmp_path: Path) -> None:
    config = PlayConfig(
        str(library / "whole"),
        still=Moment(7),
        turntable=0.2,
        capture=tmp_path / "turn",
        renderer=CPU,
    )
    assert draw_frames(config).startswith("6 pictures of frame 7 of ")
    reader = StreamReader(library / "whole")
    manifest, splats = reader.manifest, reader.active_splats(7, 3)
    path = orbit(manifest, manifest.camera(), FrameRange(0, 6), 2 * math.pi)
    names = sorted(file.name for file in (tmp_path / "turn").iterdir())
    assert names == [f"frame_{n:05d}.png" for n in range(6)]
    for number, name in enumerate(names):
        expected = to_bytes(render_splats(splats, path(number), manifest.near_m))
        found = np.asarray(Image.open(tmp_path / "turn" / name))
        np.testing.assert_array_equal(found, expected)


def test_a_signal_ends_the_wait_for_a_host_that_is_silent(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        url = f"http://127.0.0.1:{listener.getsockname()[1]}/s"
        words = (url, "--still", 3, "--capture", tmp_path / "out.png")
        process = started("swings-play", *words)
        connection, _ = listener.accept()
        with connection:
            assert connection.recv(4) == b"GET "
            process.send_signal(signal.SIGTERM)
            assert unhurried(process.communicate(timeout=BOUND_S)[1]) == ""
    assert process.returncode == 128 + signal.SIGTERM
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("capture", "number"), [("out.mp4", signal.SIGTERM), ("pictures", signal.SIGINT)]
)
def test_a_signal_writes_the_report_and_no_half_video(
    tmp_path: Path, capture: str, number: signal.Signals
) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    write_stream(tmp_path / "library" / "long", 300)
    out, report = folder / capture, folder / "report.json"
    if capture == "out.mp4":
        out.write_bytes(b"what was there before")
    options = ["--size", "32x24", "--renderer", "cpu", "--link", "20M,2ms", "--loop", "9"]
    with served(tmp_path / "library") as server:
        options += ["--capture", str(out), "--report", str(report)]
        player = started("swings-play", server.url, *options, stdout=subprocess.PIPE)
        # A picture, or the unfinished video.
        begun = "pictures/frame_00002.png" if capture == "pictures" else ".out.mp4.tmp"
        wait_until((folder / begun).exists)
        player.send_signal(number)
        out_text, err_text = player.communicate(timeout=BOUND_S)
    assert (player.returncode, out_text, unhurried(err_text)) == (128 + number, "", "")
    names = sorted(path.name for path in folder.iterdir())
    assert names == [capture, "report.json"]
    assert out.is_dir() or out.read_bytes() == b"what was there before"
    summary = json.loads(report.read_text())
    assert summary["interrupted"]
    # Some frames were due and not drawn yet; no more than the queue holds.
    assert 0 <= summary["totals"]["frames"] - len(summary["frames"]) <= 4
    assert sum(one["bytes"] for one in summary["arrivals"]) >= summary["totals"]["bytes"] > 0
    assert summary["totals"]["link_bytes"] > summary["totals"]["bytes"]
    if capture == "pictures":
        assert summary["totals"]["frames"] >= 3
