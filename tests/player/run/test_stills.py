"""swings-play --still: one frame as a picture or a turn around it, and never a partial file."""

from __future__ import annotations

import json
import math
import signal
import socket
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image

from codec.errors import InvalidError
from codec.framerange import FrameRange
from codec.stream import StreamReader
from player import Scene
from player.config import CameraPathName, PlayConfig
from player.render.cpu import render_splats
from player.render.renderer import RendererKind
from player.run.playback import play
from player.run.stills import draw_frames
from player.show.sink import Bytes, to_bytes
from player.view.moment import Moment
from player.view.path import Size, orbit
from tests.support.commands import ROOT, command, environment, run, run_ok
from tests.support.hosted_streams import served, static_host, write_stream
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


def picture(path: Path) -> Bytes:
    return np.asarray(Image.open(path))


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
    expected = picture(tmp_path / "all" / "frame_00031.png")
    np.testing.assert_array_equal(picture(tmp_path / "still.png"), expected)


@pytest.mark.parametrize("kind", ["depth", "mask"])
def test_depth_and_mask_are_grey_pictures(library: Path, tmp_path: Path, kind: str) -> None:
    out = tmp_path / "still.png"
    options = ("--still", 9, "--capture", out, "--renderer", "cpu", "--picture", kind)
    run_ok("swings-play", library / "whole", *options)
    with Scene.open(library / "whole", renderer="cpu") as scene:
        depth_mm = 1000 * np.nan_to_num(scene.depth(9))
        alpha = scene.render(9, background=None)[:, :, 3]
    found = picture(out)
    if kind == "mask":
        np.testing.assert_array_equal(found, to_bytes(alpha))
        assert found.dtype == np.uint8
        return
    assert found.dtype == np.uint16
    np.testing.assert_array_equal(found, np.rint(depth_mm))
    assert (found > 0).any()
    assert ((found > 0) == (alpha >= 0.5)).mean() > 0.99
    film = run("swings-play", library / "whole", *options[:3], "x.mp4", *options[4:],
               "--turntable", 1)  # fmt: skip
    assert "written as PNGs or as .exr files; name a folder" in film.stderr
    assert run("swings-play", library / "whole", "--picture", kind).returncode == 2


@pytest.mark.parametrize("kind", ["depth", "mask"])
def test_openexr_files_hold_depth_and_mask_exactly(
    library: Path, tmp_path: Path, kind: str
) -> None:
    options = ("--renderer", "cpu", "--picture", kind, "--camera", "camera:c1")
    still = ("--still", 9, "--capture", tmp_path / "still.exr")
    run_ok("swings-play", library / "whole", *still, *options)
    frames = ("--frames", "8:11", "--capture", tmp_path / "all", "--exr")
    told = run_ok("swings-play", library / "whole", *frames, *options)
    assert told.startswith(f"3 pictures of {kind} of ")
    names = sorted(file.name for file in (tmp_path / "all").iterdir())
    assert names == [f"frame_{n:05d}.exr" for n in range(8, 11)]
    with Scene.open(library / "whole", renderer="cpu") as scene:
        for frame, name in enumerate(names, 8):
            expected = np.nan_to_num(scene.depth(frame, "c1"))
            if kind == "mask":
                expected = scene.render(frame, "c1", background=None)[:, :, 3]
            np.testing.assert_array_equal(floats(tmp_path / "all" / name), expected)
    assert (tmp_path / "still.exr").read_bytes() == (tmp_path / "all" / names[1]).read_bytes()


def floats(path: Path) -> npt.NDArray[np.float32]:
    """(H, W) float32 of a grey OpenEXR file."""
    with av.open(str(path)) as container:
        picture = next(container.decode(video=0))
    assert isinstance(picture, av.VideoFrame)
    assert picture.format.name == "grayf32le"
    return picture.to_ndarray().astype(np.float32, copy=False)


def test_the_command_draws_a_still_of_a_url(library: Path, tmp_path: Path) -> None:
    out = tmp_path / "still.png"
    with static_host(library) as host:
        options = ("--still", 9, "--capture", out, "--camera", "camera:c2", "--renderer", "cpu")
        told = run_ok("swings-play", f"{host}/whole", *options)
    assert told == f"a picture of frame 9 of {host}/whole, 64x48, by CPU: {out}\n"
    with Scene.open(library / "whole", renderer="cpu") as scene:
        np.testing.assert_array_equal(picture(out), to_bytes(scene.render(9, "c2")))


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
        np.testing.assert_array_equal(picture(tmp_path / "turn" / name), expected)
    assert len({picture(tmp_path / "turn" / name).tobytes() for name in names}) == 6


def test_a_turntable_may_swing_and_be_a_video(library: Path, tmp_path: Path) -> None:
    out = tmp_path / "turn.mp4"
    options = ("--still", 7, "--turntable", 0.5, "--capture", out, "--camera", "orbit:40")
    told = run_ok("swings-play", library / "whole", *options, "--renderer", "cpu")
    assert told.startswith("15 pictures of frame 7 of ")
    with av.open(str(out)) as container:
        rate = container.streams.video[0].average_rate
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(frames) == 15
    assert rate == 30
    assert [path.name for path in tmp_path.iterdir()] == ["turn.mp4"]


def test_a_frame_that_is_not_there_leaves_nothing(library: Path, tmp_path: Path) -> None:
    config = PlayConfig(
        str(library / "whole"), still=Moment(13), capture=tmp_path / "o.png", renderer=CPU
    )
    with pytest.raises(InvalidError, match=r"frames 13:14: .*whole has frames 0:13"):
        draw_frames(config)
    with pytest.raises(InvalidError, match="has frames 0:13"):
        draw_frames(replace(config, turntable=2.0, capture=tmp_path / "o"))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_a_signal_leaves_no_half_video(
    library: Path, tmp_path: Path, number: signal.Signals
) -> None:
    out = tmp_path / "out.mp4"
    out.write_bytes(b"what was there before")
    options = ("--still", 3, "--turntable", 3000, "--capture", out, "--renderer", "cpu")
    process = subprocess.Popen(
        command("swings-play", library / "slots", *options),
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    partial = tmp_path / ".out.mp4.tmp"
    wait_until(lambda: partial.exists() and partial.stat().st_size > 0)
    process.send_signal(number)
    assert process.communicate(timeout=BOUND_S) == ("", "")
    assert process.returncode == 128 + number
    assert [path.name for path in tmp_path.iterdir()] == ["out.mp4"]
    assert out.read_bytes() == b"what was there before"


def test_a_signal_ends_the_wait_for_a_host_that_is_silent(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        url = f"http://127.0.0.1:{listener.getsockname()[1]}/s"
        words = (url, "--still", 3, "--capture", tmp_path / "out.png")
        process = subprocess.Popen(
            command("swings-play", *words), env=environment(), stderr=subprocess.PIPE, text=True
        )
        connection, _ = listener.accept()
        with connection:
            assert connection.recv(4) == b"GET "
            process.send_signal(signal.SIGTERM)
            assert process.communicate(timeout=BOUND_S)[1] == ""
    assert process.returncode == 128 + signal.SIGTERM
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("capture", "number"),
    [("out.mp4", signal.SIGTERM), ("pictures", signal.SIGINT)],
)
def test_a_signal_writes_the_report_and_no_half_video(
    tmp_path: Path, capture: str, number: signal.Signals
) -> None:
    (tmp_path / "library").mkdir()
    write_stream(tmp_path / "library" / "long", 300)
    folder = tmp_path / "out"
    folder.mkdir()
    out, report = folder / capture, folder / "report.json"
    options = ["--size", "32x24", "--renderer", "cpu", "--link", "20M,2ms", "--loop", "9"]
    with served(tmp_path / "library") as server:
        player = subprocess.Popen(
            [
                *(sys.executable, "-m", "player", server.url, *options),
                *("--capture", str(out), "--report", str(report)),
            ],
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        # A picture, or the unfinished video.
        begun = "pictures/frame_00002.png" if capture == "pictures" else ".out.mp4.tmp"
        wait_until((folder / begun).exists)
        player.send_signal(number)
        told = player.communicate(timeout=BOUND_S)
    assert (player.returncode, *told) == (128 + number, "", "")
    names = sorted(path.name for path in folder.iterdir())
    assert names == (["pictures", "report.json"] if capture == "pictures" else ["report.json"])
    summary = json.loads(report.read_text())
    assert summary["interrupted"]
    assert len(summary["frames"]) == summary["totals"]["frames"] - drawn_too_late(summary)
    assert sum(one["bytes"] for one in summary["arrivals"]) >= summary["totals"]["bytes"] > 0
    assert summary["totals"]["link_bytes"] > summary["totals"]["bytes"]
    assert {one["link_bps"] for one in summary["rates"]} == {20e6}
    if capture == "pictures":
        assert summary["totals"]["frames"] >= 3


def drawn_too_late(summary: dict[str, dict[str, int]]) -> int:
    """Number of frames that were due but not drawn yet; at most the length of the queue."""
    on_their_way = summary["totals"]["frames"] - len(summary["frames"])
    assert 0 <= on_their_way <= 4
    return on_their_way
