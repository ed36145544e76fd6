"""The whole path through real processes and files: film, train, verify, score, serve, play."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from codec.stream import StreamReader
from codec.stream.poster import POSTER_NAME
from player.render.cpu import render_splats
from player.render.gl import GlRenderer
from player.render.renderer import GlVersion
from tests.support.commands import run, run_ok, serving
from tests.support.screen.opengl import GL_VERSIONS
from tests.support.suite.once import made_once
from tests.support.tiny_capture import write_dynerf
from trainer.step.loss import psnr_db

FRAMES = 7
SWIN = 3


def write_all(root: Path) -> None:
    """Writes a capture and its streams: "stream" of slices that are sent whole, "raw" of the same
    Gaussians without loss, and "lasting" of slots that last, the default."""
    capture = root / "capture"
    run_ok(
        "swings-synth", capture, "--frames", FRAMES, "--cameras", 8,
        "--width-px", 64, "--height-px", 36, "--points", 1000,
    )  # fmt: skip
    common = (
        "--num-gs", 600, "--genesis-iterations", 150, "--window-iterations", 25,
        "--segment-frames", 3, "--layers", 0.4, 0.3, 0.3,
    )  # fmt: skip
    run_ok(
        "swings-train", capture, root / "stream", "--raw-stream", root / "raw", *common,
        "--whole-slices", "--swin-size", SWIN, "--settle-rounds", 0,
    )  # fmt: skip
    run_ok("swings-train", capture, root / "lasting", *common, "--settle-rounds", 1)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_once(tmp_path_factory, "pipeline", write_all)


@cache
def scores_of(stream: Path) -> list[dict[str, float]]:
    """A row for each number of layers, from swings-eval."""
    told = run_ok("swings-eval", stream, stream.with_name("capture"), "--json")
    rows: list[dict[str, float]] = json.loads(told)["layers"]
    return rows


@pytest.mark.parametrize("name", ["stream", "lasting"])
def test_a_trained_stream_is_whole_shows_the_scene_and_loses_it_layer_by_layer(
    name: str, made: Path
) -> None:
    stream = made / name
    run_ok("swings-stream", "verify", stream)
    reader = StreamReader(stream)
    assert reader.num_frames == FRAMES
    assert reader.manifest.swin_size == (SWIN if name == "stream" else 1)
    assert not reader.manifest.live
    camera, near_m = reader.manifest.camera(), reader.manifest.near_m
    base, full = (
        np.clip(render_splats(reader.active_splats(FRAMES // 2, n), camera, near_m), 0, 1)
        for n in (1, 3)
    )
    poster = np.asarray(Image.open(stream / POSTER_NAME), np.float32) / np.float32(255)
    assert psnr_db(full, poster, None) > 25
    # Layer 0 alone still shows the scene, darker, with the same light and dark areas.
    assert np.corrcoef(base.ravel(), full.ravel())[0, 1] > 0.6
    scores = scores_of(stream)
    assert [s["layers"] for s in scores] == [1, 2, 3]
    psnr = [s["psnr_db"] for s in scores]
    assert psnr == sorted(psnr)
    assert psnr[0] < psnr[-1] - 0.3
    assert psnr[-1] > 15.5  # pictures of one colour, their mean, have 14.5
    assert [s["bytes_per_frame"] for s in scores] == sorted(s["bytes_per_frame"] for s in scores)
    # The index has the score of one held-out camera per frame, swings-eval of all.
    frames = [record.num_frames for record in reader.records]
    for layers in (1, 2, 3):
        known = [record.psnr_db[layers - 1] for record in reader.records]
        assert np.average(known, weights=frames) == pytest.approx(psnr[layers - 1], abs=1.5)
    assert all(record.psnr_db[0] < record.psnr_db[-1] for record in reader.records)


def test_quantising_costs_little_and_slots_that_last_save_bytes(made: Path) -> None:
    coded, raw, lasting = (scores_of(made / name)[-1] for name in ("stream", "raw", "lasting"))
    assert (made / "raw" / POSTER_NAME).is_file()
    assert abs(coded["psnr_db"] - raw["psnr_db"]) < 0.15
    assert coded["bytes_per_frame"] < raw["bytes_per_frame"] / 3
    assert lasting["bytes_per_frame"] < coded["bytes_per_frame"]
    assert lasting["keyframe_bytes_per_frame"] > 0


@pytest.mark.parametrize("name", ["stream", "lasting"])
def test_a_served_stream_shows_what_the_folder_shows(name: str, made: Path, tmp_path: Path) -> None:
    stream = made / name
    with serving(stream) as url:
        for layers in (1, 3):
            played, direct = tmp_path / f"url{layers}", tmp_path / f"folder{layers}"
            common = ("--renderer", "cpu", "--layers", layers, "--camera", "orbit")
            run_ok("swings-play", url, "--capture", played, *common)
            run_ok("swings-play", stream, "--capture", direct, *common)
            names = [f"frame_{number:05d}.png" for number in range(FRAMES)]
            assert sorted(file.name for file in played.iterdir()) == names
            for file in names:
                assert (played / file).read_bytes() == (direct / file).read_bytes()


def test_a_part_of_the_frames_is_scored_against_the_same_part(made: Path, tmp_path: Path) -> None:
    stream = tmp_path / "part"
    run_ok(
        "swings-train", made / "capture", stream, "--frames", "3:6", "--num-gs", 60,
        "--swin-size", 2, "--genesis-iterations", 4, "--settle-rounds", 1, "--window-iterations", 2,
    )  # fmt: skip
    assert StreamReader(stream).manifest.capture_frame == 3
    result = json.loads(run_ok("swings-eval", stream, made / "capture", "--json"))
    assert result["frames"] == 3


@pytest.mark.parametrize("version", GL_VERSIONS)
def test_the_renderers_agree_on_a_trained_frame(version: GlVersion, made: Path) -> None:
    reader, frame = StreamReader(made / "lasting"), 4
    manifest = reader.manifest
    renderer = GlRenderer(manifest, version=version)
    try:
        for part in reader.window(frame, manifest.num_layers):
            renderer.put(part)
        for camera in manifest.cameras[::3]:
            drawn = renderer.render(frame, camera)
            splats = reader.active_splats(frame, manifest.num_layers)
            assert psnr_db(drawn, render_splats(splats, camera, manifest.near_m)) >= 56
    finally:
        renderer.close()


def check_one_line(name: str, arguments: tuple[object, ...], word: str) -> None:
    done = run(name, *arguments)
    assert done.returncode in (1, 2), done.stderr[-500:]
    lines = [line for line in done.stderr.splitlines() if line.strip()]
    assert len(lines) == 1, done.stderr[-1000:]
    assert lines[0].startswith(f"{name}: ")
    assert word in lines[0]


@pytest.mark.parametrize(
    ("capture", "stream", "more", "word"),
    [
        ("nowhere", "out", (), "nowhere"),
        ("empty", "out", (), "empty"),
        ("capture", "full", (), "not empty"),
        ("capture", "out", ("--num-gs", "7", "--swin-size", "2"), "num_gs 7"),
    ],
)
def test_what_cannot_be_trained_gets_one_line_and_nothing_is_written(
    capture: str, stream: str, more: tuple[str, ...], word: str, tmp_path: Path
) -> None:
    write_dynerf(tmp_path / "capture", 4, 2)
    (tmp_path / "empty").mkdir()
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("keep me")
    check_one_line("swings-train", (tmp_path / capture, tmp_path / stream, *more), word)
    assert not (tmp_path / "out").exists()


def flipped(data: bytes, at: int) -> bytes:
    return data[:at] + bytes([data[at] ^ 255]) + data[at + 1 :]


@pytest.mark.parametrize(
    ("name", "damaged", "change"),
    [
        ("swings-stream", "segments/1/0", lambda data: data[:-9]),
        ("swings-stream", "segments/1/0", lambda data: flipped(data, len(data) // 2)),
        ("swings-stream", "segments/1/skipmaps", lambda data: flipped(data, len(data) // 2)),
        ("swings-eval", "segments/1/0", lambda data: flipped(data, len(data) // 2)),
        ("swings-eval", "manifest.json", lambda data: data[:50]),
        ("swings-play", "segments/1/0", None),
        ("swings-play", "segments/1/skipmaps", lambda data: flipped(data, len(data) // 2)),
        ("swings-play", "index.bin", lambda data: flipped(data, 3)),
    ],
)
def test_a_damaged_stream_gets_one_line(
    name: str, damaged: str, change: Callable[[bytes], bytes] | None, made: Path, tmp_path: Path
) -> None:
    stream, out = tmp_path / "stream", tmp_path / "out.mp4"
    shutil.copytree(made / "stream", stream)
    target = stream / damaged
    if change is None:
        target.unlink()
    else:
        target.write_bytes(change(target.read_bytes()))
    arguments: dict[str, tuple[object, ...]] = {
        "swings-stream": ("verify", stream),
        "swings-eval": (stream, made / "capture"),
        "swings-play": (stream, "--capture", out, "--renderer", "cpu"),
    }
    check_one_line(name, arguments[name], damaged)
    assert not out.exists()


def test_another_capture_is_told_from_the_right_one(made: Path, tmp_path: Path) -> None:
    write_dynerf(tmp_path / "other", 4, FRAMES)
    check_one_line("swings-eval", (made / "stream", tmp_path / "other"), "cam01")
