"""The whole path through real processes and files: film, train, verify, score, serve, play."""

from __future__ import annotations

import json
import shutil
import socket
from collections.abc import Callable
from dataclasses import dataclass
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
from tests.support.tiny_capture import write_dynamic3dgs, write_dynerf, write_video
from trainer.step.loss import psnr_db

FRAMES = 7
SWIN = 3


@dataclass(frozen=True)
class Made:
    """What the pipeline left."""

    capture: Path
    stream: Path
    """Of version 1: slices that are sent whole."""
    raw: Path
    """The same Gaussians without loss."""
    lasting: Path
    """Of version 2: slots that last, the default."""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    root = tmp_path_factory.mktemp("pipeline")
    made = Made(*(root / name for name in ("capture", "stream", "raw", "lasting")))
    run_ok(
        "swings-synth", made.capture, "--frames", FRAMES, "--cameras", 8,
        "--width-px", 96, "--height-px", 54, "--points", 2000,
    )  # fmt: skip
    common = (
        "--num-gs", 1500, "--genesis-iterations", 400, "--window-iterations", 60,
        "--segment-frames", 3, "--layers", 0.4, 0.3, 0.3,
    )  # fmt: skip
    run_ok(
        "swings-train", made.capture, made.stream, "--raw-stream", made.raw, *common,
        "--profile", "compact", "--swin-size", SWIN, "--settle-rounds", 0,
    )  # fmt: skip
    run_ok("swings-train", made.capture, made.lasting, *common, "--settle-rounds", 2)
    return made


def evaluation(made: Made, stream: Path) -> dict[str, list[dict[str, float]]]:
    found: dict[str, list[dict[str, float]]] = json.loads(
        run_ok("swings-eval", stream, made.capture, "--json")
    )
    return found


def test_the_trained_stream_is_whole_and_shows_the_scene(made: Made) -> None:
    run_ok("swings-stream", "verify", made.stream)
    assert "compact" in run_ok("swings-stream", "info", made.stream)
    reader = StreamReader(made.stream)
    assert reader.num_frames == FRAMES
    assert not reader.manifest.live
    poster = np.asarray(Image.open(made.stream / POSTER_NAME), np.float32) / np.float32(255)
    middle = reader.active_splats(FRAMES // 2, 3)
    drawn = render_splats(middle, reader.manifest.camera(), reader.manifest.near_m)
    assert psnr_db(np.clip(drawn, 0, 1), poster, None) > 25
    assert (made.raw / POSTER_NAME).is_file()
    scores = evaluation(made, made.stream)["layers"]
    assert [s["layers"] for s in scores] == [1, 2, 3]
    assert scores[-1]["psnr_db"] > 18


def test_slots_that_last_show_the_scene_for_fewer_bytes(made: Made) -> None:
    run_ok("swings-stream", "verify", made.lasting)
    assert "lattice" in run_ok("swings-stream", "info", made.lasting)
    reader = StreamReader(made.lasting)
    assert reader.manifest.has_slots
    assert (reader.num_frames, reader.manifest.swin_size) == (FRAMES, 1)
    assert not reader.manifest.live
    lasting, whole = (evaluation(made, s)["layers"][-1] for s in (made.lasting, made.stream))
    assert lasting["psnr_db"] > 18
    assert lasting["bytes_per_frame"] < whole["bytes_per_frame"]
    assert lasting["snapshot_bytes_per_frame"] > 0 == whole["snapshot_bytes_per_frame"]


@pytest.mark.parametrize("name", ["stream", "lasting"])
def test_dropping_layers_degrades_and_never_breaks(name: str, made: Made) -> None:
    stream: Path = getattr(made, name)
    scores = evaluation(made, stream)["layers"]
    psnr = [s["psnr_db"] for s in scores]
    assert psnr == sorted(psnr)
    assert psnr[0] < psnr[-1] - 0.3
    assert [s["bytes_per_frame"] for s in scores] == sorted(s["bytes_per_frame"] for s in scores)
    # Layer 0 alone still shows the scene, though darker: what was light or dark still is.
    reader = StreamReader(stream)
    camera = reader.manifest.camera()
    full, base = (
        np.clip(render_splats(reader.active_splats(3, n), camera, reader.manifest.near_m), 0, 1)
        for n in (3, 1)
    )
    correlation = np.corrcoef(base.ravel(), full.ravel())[0, 1]
    assert correlation > 0.6


@pytest.mark.parametrize("name", ["stream", "lasting"])
def test_the_index_knows_the_quality_of_every_segment(name: str, made: Made) -> None:
    stream: Path = getattr(made, name)
    reader = StreamReader(stream)
    scores = evaluation(made, stream)["layers"]
    for layers in (1, 2, 3):
        known = [record.psnr_db[layers - 1] for record in reader.records]
        assert np.isfinite(known).all()
        # The index scores one held-out camera a frame, swings-eval all of them.
        frames = [record.num_frames for record in reader.records]
        mean = np.average(known, weights=frames)
        assert mean == pytest.approx(scores[layers - 1]["psnr_db"], abs=1.5)
    assert all(record.psnr_db[0] < record.psnr_db[-1] for record in reader.records)


def test_compact_costs_little_against_raw(made: Made) -> None:
    compact, raw = (evaluation(made, s)["layers"][-1] for s in (made.stream, made.raw))
    assert abs(compact["psnr_db"] - raw["psnr_db"]) < 0.15
    assert compact["bytes_per_frame"] < raw["bytes_per_frame"] / 3


def frames_of(folder: Path) -> list[np.ndarray]:
    pictures = []
    for file in sorted(folder.glob("*.png")):
        with Image.open(file) as picture:
            pictures.append(np.asarray(picture))
    return pictures


@pytest.mark.parametrize("name", ["stream", "lasting"])
def test_a_served_stream_shows_what_the_folder_shows(name: str, made: Made, tmp_path: Path) -> None:
    stream: Path = getattr(made, name)
    with serving(stream) as url:
        for layers in (1, 3):
            played, direct = tmp_path / f"url{layers}", tmp_path / f"folder{layers}"
            common = ("--renderer", "cpu", "--layers", layers, "--camera", "orbit")
            run_ok("swings-play", url, "--capture", played, *common)
            run_ok("swings-play", stream, "--capture", direct, *common)
            ours, theirs = frames_of(played), frames_of(direct)
            assert len(ours) == len(theirs) == FRAMES
            for a, b in zip(ours, theirs, strict=True):
                assert (a == b).all()
        videos = [tmp_path / "url.mp4", tmp_path / "folder.mp4"]
        for source, video in zip((url, stream), videos, strict=True):
            run_ok("swings-play", source, "--capture", video, "--renderer", "cpu", "--layers", 3)
        assert videos[0].read_bytes() == videos[1].read_bytes()
        mp4 = tmp_path / "out.mp4"
        report = tmp_path / "report.json"
        run_ok(
            "swings-play", url, "--capture", mp4, "--report", report, "--link", "2M,10ms",
            "--size", "96x54",
        )  # fmt: skip
    assert mp4.stat().st_size > 1000
    frames = json.loads(report.read_text())["frames"]
    assert [f["frame"] for f in frames] == list(range(FRAMES))
    assert all(1 <= f["layers"] <= 3 for f in frames)


def test_a_part_of_the_frames_is_scored_against_the_same_part(made: Made, tmp_path: Path) -> None:
    stream = tmp_path / "part"
    run_ok(
        "swings-train", made.capture, stream, "--frames", "3:6", "--num-gs", 300, "--swin-size", 2,
        "--genesis-iterations", 20, "--settle-rounds", 1, "--window-iterations", 5,
    )  # fmt: skip
    assert StreamReader(stream).manifest.capture_frame == 3
    result = json.loads(run_ok("swings-eval", stream, made.capture, "--json"))
    assert result["frames"] == 3


def test_the_contact_sheet_is_a_picture(made: Made, tmp_path: Path) -> None:
    sheet = tmp_path / "sheet.png"
    run_ok("swings-eval", made.stream, made.capture, "--sheet", sheet, "--every", 3)
    with Image.open(sheet) as picture:
        assert picture.size[0] == 3 * 96


@pytest.mark.parametrize("name", ["stream", "lasting"])
@pytest.mark.parametrize("frame", [0, 4])
@pytest.mark.parametrize("version", GL_VERSIONS)
def test_the_renderers_agree_on_a_trained_frame(
    version: GlVersion, frame: int, name: str, made: Made
) -> None:
    reader = StreamReader(getattr(made, name))
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


def missing(root: Path) -> tuple[str, ...]:
    return ("swings-train", str(root / "nowhere"), str(root / "out"))


def empty(root: Path) -> tuple[str, ...]:
    (root / "capture").mkdir()
    return ("swings-train", str(root / "capture"), str(root / "out"))


def missing_frame(root: Path) -> tuple[str, ...]:
    write_dynamic3dgs(root / "capture")
    next((root / "capture" / "ims" / "2").iterdir()).unlink()
    return ("swings-train", str(root / "capture"), str(root / "out"))


def unequal_videos(root: Path) -> tuple[str, ...]:
    write_dynerf(root / "capture", 4, 5)
    (root / "capture" / "cam02.mp4").unlink()
    write_video(root / "capture" / "cam02.mp4", 2, 4)
    return ("swings-train", str(root / "capture"), str(root / "out"))


def not_a_video(root: Path) -> tuple[str, ...]:
    write_dynerf(root / "capture", 4, 5)
    (root / "capture" / "cam01.mp4").write_text("this is not a video")
    return ("swings-train", str(root / "capture"), str(root / "out"))


def occupied_target(root: Path) -> tuple[str, ...]:
    write_dynerf(root / "capture", 4, 5)
    (root / "full").mkdir()
    (root / "full" / "mine.txt").write_text("keep me")
    return ("swings-train", str(root / "capture"), str(root / "full"))


def impossible_size(root: Path) -> tuple[str, ...]:
    write_dynerf(root / "capture", 4, 5)
    sizes = ("--num-gs", "7", "--swin-size", "2")
    return ("swings-train", str(root / "capture"), str(root / "out"), *sizes)


CAPTURE_FAULTS: list[tuple[Callable[[Path], tuple[str, ...]], str]] = [
    (missing, "nowhere"),
    (empty, "empty"),
    (missing_frame, "2"),
    (unequal_videos, "cam02"),
    (not_a_video, "cam01.mp4"),
    (occupied_target, "not empty"),
    (impossible_size, "num_gs 7"),
]


def check_one_line(name: str, arguments: tuple[object, ...], word: str) -> None:
    done = run(name, *arguments)
    assert done.returncode in (1, 2), done.stderr[-500:]
    lines = [line for line in done.stderr.splitlines() if line.strip()]
    assert len(lines) == 1, done.stderr[-1000:]
    assert lines[0].startswith(f"{name}: ")
    assert word in lines[0]


@pytest.mark.parametrize(("make", "word"), CAPTURE_FAULTS)
def test_a_wrong_capture_gets_one_line_and_nothing_is_written(
    make: Callable[[Path], tuple[str, ...]], word: str, tmp_path: Path
) -> None:
    name, *arguments = make(tmp_path)
    check_one_line(name, tuple(arguments), word)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("fault", ["truncated", "altered", "gone", "manifest", "index", "masks"])
@pytest.mark.parametrize("name", ["swings-stream", "swings-eval", "swings-play"])
def test_a_damaged_stream_gets_one_line(fault: str, name: str, made: Made, tmp_path: Path) -> None:
    stream = tmp_path / "stream"
    shutil.copytree(made.lasting if fault == "masks" else made.stream, stream)
    target = stream / "segments" / "1" / ("masks" if fault == "masks" else "0")
    if fault == "truncated":
        target.write_bytes(target.read_bytes()[:-9])
    elif fault in ("altered", "masks"):
        data = bytearray(target.read_bytes())
        data[len(data) // 2] ^= 1
        target.write_bytes(data)
    elif fault == "gone":
        target.unlink()
    elif fault == "manifest":
        target = stream / "manifest.json"
        target.write_bytes(target.read_bytes()[:50])
    else:
        target = stream / "index.bin"
        data = bytearray(target.read_bytes())
        data[3] ^= 255
        target.write_bytes(data)
    out = tmp_path / "out.mp4"
    arguments: dict[str, tuple[object, ...]] = {
        "swings-stream": ("verify", stream),
        "swings-eval": (stream, made.capture),
        "swings-play": (stream, "--capture", out, "--renderer", "cpu"),
    }
    word = target.name if target.suffix else str(Path("segments") / "1" / target.name)
    check_one_line(name, arguments[name], word)
    assert not list(tmp_path.glob("out*"))


def test_a_url_that_is_not_a_stream_and_a_port_in_use(made: Made, tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        check_one_line("swings-serve", (made.stream, "--port", port), str(port))
    out = tmp_path / "out.mp4"
    check_one_line("swings-play", (f"http://127.0.0.1:{port}", "--capture", out), str(port))
    with serving(made.stream) as url:
        check_one_line("swings-play", (f"{url}/v1/streams/nothing", "--capture", out), "nothing")
    check_one_line("swings-serve", (made.capture / "absent", "--port", 0), "absent")
    assert not out.exists()


def test_another_capture_is_told_from_the_right_one(made: Made, tmp_path: Path) -> None:
    write_dynerf(tmp_path / "other", 4, FRAMES)
    check_one_line("swings-eval", (made.stream, tmp_path / "other"), "cam01")
