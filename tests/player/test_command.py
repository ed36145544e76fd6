"""swings-play from end to end: output files, exit codes, and one line per error."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from statistics import fmean

import av
import pytest
from PIL import Image

from codec.errors import InvalidError
from codec.framerange import FrameRange
from codec.stream import StreamReader
from player.__main__ import main
from player.config import CameraPathName, PlayConfig
from player.link.relay import read_link
from player.render.renderer import RendererKind
from player.run.playback import play
from player.run.stills import draw_frames
from player.view.path import Moment, Size
from server.abr.link import LinkStep
from tests.support.commands import run
from tests.support.hosted_streams import ServerProcess

CPU = RendererKind.CPU


def test_a_folder_into_a_video_with_a_report(library: Path, tmp_path: Path) -> None:
    out, report = tmp_path / "out.mp4", tmp_path / "report.json"
    arguments = ["--capture", str(out), "--report", str(report), "--size", "80x60"]
    words = (library / "one", *arguments, "--camera", "orbit", "--layers", "2")
    done = run("swings-play", *words)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("13 frames of ")
    assert "0 stalls" in done.stdout
    with av.open(str(out)) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(frames) == 13
    assert frames[0].shape == (60, 80, 3)
    assert max(frame.max() for frame in frames) > 60
    told = json.loads(report.read_text())
    assert [f["frame"] for f in told["frames"]] == list(range(13))
    assert {f["layers"] for f in told["frames"]} == {2}
    assert all(f["shown_s"] >= f["due_s"] for f in told["frames"])
    totals = told["totals"]
    assert totals["frames"] == 13
    assert totals["bytes"] == sum(f["bytes"] for f in told["frames"]) > 0
    assert totals["mean_layers"] == 2
    assert totals["link_bytes"] is None
    assert (totals["plays"], totals["undrawn_frames"], told["interrupted"]) == (1, 0, False)
    assert [one["birth"] for one in told["arrivals"]] == [None, *range(1, 13)]
    assert told["arrivals"][0]["keyframe_frame"] == 0
    assert sum(one["bytes"] for one in told["arrivals"]) == totals["bytes"]
    assert told["rates"] == []  # no network is involved
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out.mp4", "report.json"]


def test_a_capture_of_a_served_stream_is_that_of_its_folder(
    library: Path, server: ServerProcess, tmp_path: Path
) -> None:
    """An adaptive play from a server would start with fewer layers."""
    layers = StreamReader(library / "one").manifest.num_layers
    for name, source in (("folder", str(library / "one")), ("served", server.url)):
        config = PlayConfig(source, capture=tmp_path / name, renderer=CPU, loop=2)
        summary = play(config)
        assert summary.totals.fewest_layers == summary.totals.mean_layers == layers
        assert summary.totals.frames == 26
    for ours, theirs in zip(
        sorted((tmp_path / "served").iterdir()),
        sorted((tmp_path / "folder").iterdir()),
        strict=True,
    ):
        assert ours.read_bytes() == theirs.read_bytes()


def test_a_report_has_the_layers_of_a_slow_link_and_the_plays_of_a_loop(
    server: ServerProcess, tmp_path: Path
) -> None:
    report, plot = tmp_path / "report.json", tmp_path / "p.png"
    # Only layer 0 arrives in time.
    config = PlayConfig(server.url, capture=tmp_path / "out", renderer=CPU, report=report)
    play(replace(config, link=read_link("300k,5ms"), frames=FrameRange(2, 9), loop=2, plot=plot))
    told = json.loads(report.read_text())
    layers = [f["layers"] for f in told["frames"]]
    assert told["totals"]["fewest_layers"] == min(layers) == 1
    assert told["totals"]["mean_layers"] == pytest.approx(fmean(layers))
    shown = [(f["play"], f["frame"]) for f in told["frames"]]
    assert shown == [(play, frame) for play in range(2) for frame in range(2, 9)]
    assert told["frames"][6]["shown_s"] <= told["plays"][1]["asked_s"]
    assert told["totals"]["startup_s"] == sum(play["startup_s"] for play in told["plays"])
    assert {one["link_bps"] for one in told["rates"]} == {300e3}
    with Image.open(plot) as picture:
        assert picture.size[0] > 1000


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--layers 0", "neither auto nor a whole number"),
        ("--frames 9:3", "hold no frame"),
        ("--size big", "WIDTHxHEIGHT"),
        ("--renderer cpu", "add --capture"),
        ("--capture x.gif", "name an .mp4"),
        ("--capture x.mp4 --link 8M", "works only with http"),
        ("--capture x.mp4 --link fast", "neither a rate"),
        ("--capture x.mp4 --report /absent/r.json", "there is no folder"),
        ("--capture x.mp4 --loop 0", "neither forever nor a whole number of 1 or more"),
        ("--capture x.mp4 --loop forever", "--loop forever cannot be combined with"),
        ("--capture x.mp4 --rate 2", "--rate cannot be combined with --capture"),
        ("--still 3 --capture x.png --rate 2", "--rate cannot be combined with --still"),
        ("--rate 5", "not within 0.1..4"),
        ("--background blue", "is not RRGGBB"),
        ("--still 3", "name it with --capture"),
        ("--still=-1 --capture o.png", "neither a frame, such as 30, nor a time, such as 2.5s"),
        ("--still 3 --capture o.mp4", "name a .png file"),
        ("--still 3 --capture o.exr", "name a .png file"),
        ("--picture depth --capture o.mov", "name an .mp4 file, or a folder"),
        ("--picture depth --capture o.mp4", "is written as PNGs; name a folder"),
        ("--picture depth --capture o --loop 2", "--loop cannot be combined"),
        ("--picture depth --capture o --fps 60", "--picture depth cannot be combined with --fps"),
        ("--picture depth", "--picture depth needs an output"),
        ("--turntable 3 --capture o.mp4", "choose its frame with --still"),
        ("--still 3 --turntable 3 --capture o.png", "name an .mp4 file, or a folder"),
        ("--still 3 --turntable nan --capture o.mp4", "more than 0"),
        ("--still 3 --turntable 1e9 --capture o.mp4", "at most 3600 seconds"),
        *(
            (f"--still 3 --capture o.png {option}", f"{option.split()[0]} cannot be combined with")
            for option in ("--frames 3:4", "--loop 2", "--report r.json", "--plot p.png")
        ),
        ("--profile p.png --loop 2", "--loop cannot be combined with --profile"),
        ("--capture o.mp4 --renderer cpu --gl 4.3", "--gl 4.3 cannot be combined with --renderer"),
        ("--fps 60", "--fps is the rate of a film"),
        ("--capture o.mp4 --fps 0", "fps 0"),
        ("--capture o.mp4 --background transparent", "an .mp4 has no alpha channel"),
        ("--background transparent", "needs --capture with PNGs"),
    ],
)
def test_options_that_are_wrong_for_any_stream(
    words: str,
    message: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["swings-play", "somewhere", *words.split()])
    with pytest.raises(SystemExit) as exit:
        main()
    assert exit.value.code == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert len([line for line in err.splitlines() if message in line]) == 1


def test_words_become_values(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    configs: list[PlayConfig] = []
    monkeypatch.setattr("player.__main__.run", configs.append)
    words = "--layers 2 --frames 3:9 --size 80x60 --camera orbit:30 --link 8M,20ms --renderer gl"
    for line in (f"http://host {words} --capture {tmp_path}/o", "folder", "folder --layers auto"):
        monkeypatch.setattr(sys, "argv", ["swings-play", *line.split()])
        main()
    config = configs[0]
    assert config.link is not None
    assert config.link.at(0) == LinkStep(3600.0, 8e6, 0.02)
    assert config == PlayConfig(
        "http://host",
        layers=2,
        frames=FrameRange(3, 9),
        size=Size(80, 60),
        camera=CameraPathName("orbit:30"),
        link=config.link,
        renderer=RendererKind.GL,
        capture=tmp_path / "o",
    )
    assert configs[1:] == [PlayConfig("folder")] * 2


def test_what_the_stream_does_not_have_leaves_nothing(library: Path, tmp_path: Path) -> None:
    stream, out = str(library / "one"), tmp_path / "out.mp4"
    config = PlayConfig(stream, capture=out, renderer=CPU)
    for asked, message in (
        (replace(config, frames=FrameRange(13)), "there is no frame 13"),
        (replace(config, layers=4), "--layers 4"),
        (replace(config, camera=CameraPathName("camera:nobody")), "no camera is called"),
        (replace(config, still=Moment(13), capture=tmp_path / "o.png"), "one has frames 0:13"),
    ):
        with pytest.raises(InvalidError, match=message):
            (play if asked.still is None else draw_frames)(asked)
    assert list(tmp_path.iterdir()) == []
