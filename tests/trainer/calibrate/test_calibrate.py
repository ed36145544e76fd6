"""Videos alone become a capture; with pycolmap, a rig is found of what its cameras saw."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from codec.arrays import Doubles
from tests.support.commands import environment, run
from tests.support.tiny_capture import tiny_rig, write_video
from tests.support.tiny_models import write_videos
from tests.trainer.calibrate.test_rigs import FOCAL, HEIGHT, WIDTH, arc
from trainer.calibrate.capturecommand import Calibrate
from trainer.calibrate.command import calibrate
from trainer.calibrate.offsets import (
    Synchrony,
    confirmed,
    geometric_lags,
    lags_of,
    stepped,
    synchronise,
    whole_frames,
)
from trainer.calibrate.solution import Rig, align, centres
from trainer.calibrate.takes import Take, find_takes
from trainer.capture.layout import open_capture
from trainer.errors import CaptureError
from trainer.run.config import TrainConfig
from trainer.run.fromvideos import with_poses


def test_a_capture_shows_the_frames_that_are_nearest_in_time(tmp_path: Path) -> None:
    """One camera begins 3 frames early, one films at half the rate."""
    root = tmp_path / "c"
    write_videos(root, cameras := tiny_rig(3), 12)
    write_video(root / "videos/cam01.mp4", 1, 15)
    write_video(root / "videos/cam02.mp4", 2, 7, times=[40 * n for n in range(7)])
    entries = [
        {
            "file_path": f"videos/{camera.name}.mp4", "fl_x": 50, "start_s": start_s,
            "transform_matrix": np.linalg.inv(camera.w2c).tolist(),
        }
        for camera, start_s in zip(cameras, (0.0, 0.1, 0.0), strict=True)
    ]  # fmt: skip
    (root / "transforms.json").write_text(json.dumps({"fps": 30, "frames": entries}))
    capture = open_capture(root)
    assert capture.num_frames == 12
    assert capture.starts_s == (0.0, 0.1, 0.0)
    sources = [capture.open_images(index) for index in range(3)]
    for frame in (0, 5, 10):
        greens = [int(source.read(frame)[0, 0, 1]) for source in sources]
        np.testing.assert_allclose(greens[:2], [20 + 4 * frame, 32 + 4 * frame], atol=2)
        assert abs(greens[2] - 20 - 2 * frame) <= 4
    entries[1]["start_s"] = 3.0
    (root / "transforms.json").write_text(json.dumps({"fps": 30, "frames": entries}))
    with pytest.raises(CaptureError, match=r"3\.000 s|no time in common"):
        open_capture(root)


def test_takes_are_videos_or_folders_and_offsets_may_be_given(tmp_path: Path) -> None:
    for name in ("cam2", "cam10"):
        write_video(tmp_path / f"{name}.mp4", 0, 40)
    takes = find_takes([tmp_path])
    assert [take.name for take in takes] == ["cam2", "cam10"]
    (tmp_path / "offsets.txt").write_text("cam10 0.5\ncam2 0.1\n")
    found = synchronise(takes, tmp_path / "offsets.txt", lambda share: None)
    np.testing.assert_allclose(found.starts_s, [0, 0.4], atol=1e-9)
    assert found.num_frames == 28
    (tmp_path / "b").mkdir()
    write_video(tmp_path / "b/cam2.mp4", 0, 4)
    for given, says in (
        ([tmp_path, tmp_path / "b/cam2.mp4"], "are both camera cam2"),
        ([tmp_path / "b"], "1 videos or folders"),
    ):
        with pytest.raises(CaptureError, match=says):
            find_takes(given)
    (tmp_path / "offsets.txt").write_text("cam10 0.5\n")
    with pytest.raises(CaptureError, match="lacks the offset of cam2"):
        synchronise(takes, tmp_path / "offsets.txt", lambda share: None)
    refused = run("swings-capture", "calibrate", tmp_path, tmp_path / "c", "--moments", "3")
    assert "moments 3: must be at least 6" in refused.stderr


def walk_seen(starts: list[int]) -> tuple[Rig, list[Doubles]]:
    """Six cameras, and where each sees a ball that hops along a spiral, with noise, in 150 frames
    from its start on."""
    rng, poses = np.random.default_rng(0), arc(6)
    turns = np.arange(-60, 220) / 30
    walk = np.column_stack(
        [np.cos(turns), np.sin(turns), 0.5 * np.sin(2.3 * turns) + 0.3 * np.sin(3.9 * turns)]
    ) * (0.4 + turns[:, None] / 9)
    places = []
    for pose, start in zip(poses, starts, strict=True):
        local = walk[60 - start : 210 - start] @ pose[:, :3].T + pose[:, 3]
        xy = FOCAL * local[:, :2] / local[:, 2:] + (WIDTH / 2, HEIGHT / 2)
        xy += rng.normal(0, 6, xy.shape)
        xy[rng.random(len(xy)) < 0.1] = np.nan
        places.append(xy)
    lenses = np.tile([FOCAL, WIDTH / 2, HEIGHT / 2, 0.0], (6, 1))
    return Rig(lenses, poses, np.zeros((0, 3)), np.zeros((0, 3), np.int64)), places


def test_places_of_movement_tell_the_offsets_to_the_frame() -> None:
    starts = [0, 17, -9, 30, 4, -21]
    found = geometric_lags(*walk_seen(starts), 3)
    np.testing.assert_allclose(found.lags - found.lags[0], starts, atol=0.7)
    assert (found.score > found.rest).all()
    assert np.isnan(lags_of({}, 3, 3).lags).all()


@pytest.mark.parametrize("phase", [0.0, 0.3, 0.5, 0.8])
def test_lags_are_to_the_frame_whatever_they_are_counted_from(phase: float) -> None:
    right = np.array([0, 17, -9, 30, 4, -21])
    found = whole_frames(right + phase + np.array([0.3, -0.2, 0.2, 0.1, -0.3, -0.2]))
    assert np.ptp(found - right) == 0


def test_a_camera_that_is_five_frames_late_is_named_and_corrected() -> None:
    rig, places = walk_seen([0, 0, 0, 5, 0, 0])
    times_s = np.arange(150) / 30
    takes = [Take(f"cam{i}", (Path(f"cam{i}.mp4"),), 640, 360, times_s, 30.0) for i in range(6)]
    guess = Synchrony((0.0,) * 6, 149 / 30, 150, 30.0, "", moving_px=tuple(places))
    found, lost = confirmed(takes, guess, rig, range(6))
    assert not lost
    np.testing.assert_allclose(np.array(found.starts_s) * 30, [0, 0, 0, 5, 0, 0], atol=1e-9)
    assert found.notes == ("out of step as filmed, and corrected: cam3 by +5 frames",)
    first = stepped(takes, guess, rig)
    np.testing.assert_allclose(first.starts_s, found.starts_s, atol=1e-9)
    assert first.moving_px == guess.moving_px
    blind = replace(guess, moving_px=(*places[:3], np.full((150, 2), np.nan), *places[4:]))
    assert not np.any(stepped(takes, blind, rig).starts_s)
    assert "nothing tells when cam3 began" in confirmed(takes, blind, rig, range(6))[0].notes[0]
    takes[1] = replace(takes[1], times_s=np.arange(160) / 30)
    found, lost = confirmed(takes, blind, rig, range(6))
    assert found.starts_s == (0.0,) * 5
    assert lost.keys() == {3}
    assert "clap once" in lost[3]


def test_one_moment_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Videos in which nothing moves, and those of a single frame."""
    monkeypatch.setattr("trainer.calibrate.command.find_spec", lambda name: name)
    for frames, says in (
        (12, "all 6 moments look the same"),
        (1, "frames that all cameras show: 1"),
    ):
        folder = tmp_path / str(frames)
        folder.mkdir()
        for i in range(4):
            write_video(folder / f"cam{i}.mp4", i, frames, is_still=True)
        with pytest.raises(CaptureError, match=says):
            calibrate(Calibrate((folder, tmp_path / "c"), moments=6))
        assert not (tmp_path / "c").exists()


def test_training_makes_a_capture_of_plain_videos_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    videos, made = tmp_path / "play", list[Path]()
    videos.mkdir()
    for i in range(3):
        write_video(videos / f"cam{i}.mp4", i, 4)

    def calibrating(asked: Calibrate, console: Console) -> str:
        given, target = asked.videos
        made.append(target)
        shutil.copytree(given, target / "videos")
        return "3 of 3 cameras"

    monkeypatch.setattr("trainer.calibrate.command.calibrate", calibrating)
    config = TrainConfig(videos, tmp_path / "stream")
    wanted = replace(config, capture=tmp_path / "stream-capture", title="play")
    for _ in range(2):
        assert with_poses(config, Console(stderr=True)) == wanted
    assert made == [tmp_path / "stream-capture"]
    assert capsys.readouterr().err.count("3 of 3 cameras") == 1
    write_video(videos / "cam1.mp4", 1, 9)
    with pytest.raises(CaptureError, match="a capture of other videos than those in"):
        with_poses(config, Console(quiet=True))
    (videos / "transforms.json").touch()
    assert with_poses(config, Console(quiet=True)) is config


MAP = """
import sys
from pathlib import Path
import numpy as np
from trainer.calibrate.mapping import Job, Mapper
folder = Path(sys.argv[1])
given = dict(np.load(folder / "given.npz"))
mapper = Mapper(folder, Job([(640, 360)] * 8, [0] * 8, ([0], [1]), True, 1000, 2))
mapper.keypoints = [given.pop(f"keypoints{i}") for i in range(8)]
verified = {tuple(map(int, pair.split())): matches for pair, matches in given.items()}
np.savez(folder / "found.npz", **mapper.rigs("whole", verified))
"""
"""In a process of its own, as the command has it."""


def test_rigs_are_found_of_matches_with_lenses_of_each_camera(tmp_path: Path) -> None:
    """Eight cameras of one kind, whose lenses differ by 2 %, and points between them."""
    pytest.importorskip("pycolmap")
    rng, poses, count = np.random.default_rng(0), arc(), 400
    xyz = rng.uniform(-1.2, 1.2, (count, 3))
    focal = FOCAL * (1 + 0.02 * rng.uniform(-1, 1, 8))
    given: dict[str, Any] = {}
    for i, pose in enumerate(poses):
        local = xyz @ pose[:, :3].T + pose[:, 3]
        xy = focal[i] * local[:, :2] / local[:, 2:] + (WIDTH / 2, HEIGHT / 2)
        xy += rng.normal(0, 0.3, xy.shape)
        given[f"keypoints{i}"] = np.column_stack([xy, np.zeros(count)])
        for j in range(i + 1, min(i + 4, 8)):
            shared = np.flatnonzero(rng.random(count) < 0.6)
            given[f"{i} {j}"] = np.column_stack([shared, shared])
    np.savez(tmp_path / "given.npz", **given)
    command = [sys.executable, "-c", MAP, str(tmp_path)]
    subprocess.run(command, check=True, capture_output=True, env=environment())
    found = np.load(tmp_path / "found.npz")
    for lens in ("like", "free"):
        rig = Rig(*(found[f"whole_{lens}_{key}"] for key in Rig.__dataclass_fields__))
        placed = align(rig.poses, poses).poses(rig.poses)
        assert np.linalg.norm(centres(placed) - centres(poses), axis=1).max() < 0.1
        np.testing.assert_allclose(rig.lenses[:, 0], focal, rtol=0.03)
        assert len(rig.seen) > 1500
