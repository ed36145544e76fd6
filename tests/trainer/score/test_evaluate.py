"""swings-eval: sizes, traffic, training cameras, and figures that a writer records, too."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from codec.camera import Camera
from codec.errors import InvalidError
from codec.lattice.lattice import Lattice
from codec.slice import Slice
from codec.slots.slotlayout import PREDICTED, SlotLayout
from codec.stream import StreamReader, StreamWriter
from tests.support.commands import run_ok
from tests.support.slots.folder import slots_manifest
from tests.support.slots.updates import patternless_updates, small_layout
from tests.support.tiny_capture import seen_by, tiny_rig, write_dynamic3dgs, write_dynerf
from tests.support.tiny_models import transforms_of, write_pictures, write_transforms
from tests.support.tiny_stream import tiny_manifest, tiny_slice, write_tiny
from tests.support.trainings import train_here
from trainer.capture.layout import open_capture
from trainer.errors import CaptureError
from trainer.pictures.framecache import FrameCache
from trainer.score.evaluate import EvaluateConfig, evaluate_stream
from trainer.score.meter import QualityMeter
from trainer.score.scores import traffic
from trainer.score.sheet import HEADER_PX, write_sheet
from trainer.score.truth import captured, displayed, stream_cameras
from trainer.step.loss import psnr_db

SCALE = 0.3


def test_cameras_have_the_sizes_of_training_and_others_are_named(tmp_path: Path) -> None:
    """Cameras of 64, 51 and 33 pixels in width, which SCALE does not divide."""
    write_dynamic3dgs(tmp_path / "c", num_cameras=4, num_frames=3)
    plain = open_capture(tmp_path / "c")
    sizes = [(64, 36), (51, 29), (33, 19), (64, 36)]
    cameras = [
        replace(c, camera=c.camera.resized(*size), held_out=True)
        for c, size in zip(plain.cameras, sizes, strict=True)
    ]
    uneven = replace(plain, cameras=tuple(cameras))
    trained = tuple(c.camera.scaled(SCALE) for c in cameras)
    manifest = replace(tiny_manifest(), cameras=trained, default_camera="cam00")
    found = stream_cameras(manifest, uneven, "stream")
    with FrameCache(uneven, range(3), SCALE) as cache:
        for i, camera in enumerate(found):
            scaled = cache.camera(i)
            assert (camera.width_px, camera.height_px) == (scaled.width_px, scaled.height_px)
    with FrameCache(uneven, range(3), cameras=found) as cache:
        assert cache.camera(1) == found[1]
        assert cache.image(0, 0).shape == (found[0].height_px, found[0].width_px, 3)
    for index in (0, 2):
        others, moved = list(manifest.cameras), manifest.cameras[index].w2c.copy()
        moved[:3, 3] += 0.1
        for name, told in (("", f"camera cam0{index} is not the one"), ("x", "has no camera")):
            others[index] = replace(others[index], w2c=moved, name=name or others[index].name)
            wrong = replace(manifest, cameras=tuple(others), default_camera=others[0].name)
            with pytest.raises(CaptureError, match=told):
                stream_cameras(wrong, uneven, "stream")


def test_a_contact_sheet_shows_cameras_of_any_size_whole(tmp_path: Path) -> None:
    """A portrait camera and a wide one among others: the first row does not define the others."""
    root, frames, sizes = tmp_path / "capture", 6, [(64, 36), (20, 50), (90, 30)]

    def resized(camera: Camera, width: int, height: int) -> Camera:
        return replace(camera, width_px=width, height_px=height, cx_px=width / 2, cy_px=height / 2)

    def colour_of(index: int, frame: int) -> tuple[int, int, int]:
        return 90 + 20 * index, 100 + 5 * frame, 200

    def picture(index: int, frame: int) -> np.ndarray:
        width_px, height_px = sizes[index % 3]
        return np.full((height_px, width_px, 3), colour_of(index, frame), np.uint8)

    cameras = [resized(c, *sizes[i % 3]) for i, c in enumerate(tiny_rig(6))]
    paths = write_pictures(root, cameras, frames, False, picture)
    write_transforms(root, transforms_of(cameras, paths))
    (root / "held_out.txt").write_text("".join(f"{c.name}\n" for c in cameras[:3]))
    manifest = replace(tiny_manifest(), cameras=tuple(cameras), default_camera=cameras[0].name)
    write_tiny(tmp_path / "stream", frames, manifest)
    write_sheet(tmp_path / "stream", root, tmp_path / "sheet.png")
    with Image.open(tmp_path / "sheet.png") as image:
        sheet = np.asarray(image)
    assert sheet.shape == (2 * sum(h + HEADER_PX for _, h in sizes), 3 * 90, 3)
    top = 0
    for row in range(6):
        width_px, height_px = sizes[row % 3]
        top += HEADER_PX
        line = sheet[top : top + height_px]
        assert (line[:, :width_px] == colour_of(row % 3, row)).all()
        error = line[:, 2 * width_px : 3 * width_px]
        assert error[:, -1].max() > 0  # the third column is there to its last pixel
        assert line[:, 3 * width_px :].max(initial=0) == 0
        top += height_px


@pytest.mark.parametrize("swin_size", [1, 3])
def test_who_plays_from_frame_0_fetches_no_later_keyframe(swin_size: int, tmp_path: Path) -> None:
    capture, stream, frames = tmp_path / "capture", tmp_path / "stream", 7
    write_dynamic3dgs(capture, num_cameras=3, num_frames=frames)
    layout = small_layout(swin_size, (9, 6, 4), 0, 3)  # the last segment is short
    updates = patternless_updates(layout, frames)
    manifest = replace(seen_by(slots_manifest(layout), capture), live=True)
    with StreamWriter.create(stream, manifest) as writer:
        for update in updates:
            writer.append(update)

    def size_of(*names: str) -> int:
        return sum((stream / name).stat().st_size for name in names)

    found = evaluate_stream(EvaluateConfig(stream, capture)).layers
    assert len(found) == 3
    for score in found:
        layers = range(score.layers)
        played = [f"segments/{n}/{part}" for n in range(3) for part in (*layers, "skipmaps")]
        joins = [[f"segments/{n}/keyframe-{layer}" for layer in layers] for n in range(3)]
        objects = size_of(*played, *joins[0])
        overhead = size_of("manifest.json", "index.bin")
        assert score.bytes_per_frame * frames == pytest.approx(objects + overhead)
        later = size_of(*joins[1], *joins[2])
        assert score.keyframe_bytes_per_frame * frames == pytest.approx(later)
        assert score.bits_per_second == pytest.approx(8 * 25 * score.bytes_per_frame)
        # Before frame 0 nothing is predicted, and the keyframes contain the state of frame 0.
        rows = slice(layout.row_edges[score.layers])
        sent = sum(int((update.statuses[rows] >= PREDICTED).sum()) for update in updates)
        assert score.bytes_per_gaussian == pytest.approx(objects / sent)


def test_whole_slices_bring_all_their_gaussians(tmp_path: Path) -> None:
    write_tiny(tmp_path, 5)
    reader = StreamReader(tmp_path)
    manifest = reader.manifest
    found = traffic(reader)
    files = [f for f in (tmp_path / "segments").rglob("*") if f.is_file()]
    assert found[-1].object_bytes + found[-1].join_bytes == sum(f.stat().st_size for f in files)
    slices = 5 + manifest.swin_size - 1
    assert [one.gaussians for one in found] == [slices * n for n in np.cumsum(manifest.slots)]


def test_training_cameras_are_scored_and_info_agrees_or_says_why_not(tmp_path: Path) -> None:
    capture, stream, frames = tmp_path / "capture", tmp_path / "stream", 3
    write_dynerf(capture, 6, frames)
    (capture / "held_out.txt").write_text("cam01\ncam03\n")
    train_here(
        capture, stream, "--num-gs", 200, "--genesis-iterations", 40, "--settle-rounds", 1,
        "--window-iterations", 5, "--segment-frames", 2,
    )  # fmt: skip
    reader, footage = StreamReader(stream), open_capture(capture)
    scores = json.loads(run_ok("swings-eval", stream, capture, "--training-cameras", "--json"))
    training, held_out = scores["gap"]["training"], scores["gap"]["held_out"]
    best = scores["layers"][-1]
    for name in ("psnr_db", "fitted_psnr_db", "moving_psnr_db", "fitted_moving_psnr_db"):
        assert held_out[name] == pytest.approx(best[name])
    splats, found_db = reader.active_splats(1, reader.manifest.num_layers), []
    for index in footage.training:
        shown = displayed(splats, footage.cameras[index].camera, reader.manifest.near_m)
        with closing(footage.open_images(index)) as pictures:
            found_db.append(psnr_db(shown, captured(pictures.read(1))))
    assert len(found_db) == 4
    assert training["per_frame_psnr_db"][1] == pytest.approx(np.mean(found_db))
    assert training["fitted_psnr_db"] >= training["psnr_db"]
    table = run_ok("swings-eval", stream, capture, "--training-cameras")
    [line] = [line for line in table.splitlines() if line.startswith("│ gap")]
    assert f"{training['psnr_db'] - held_out['psnr_db']:.2f}" in line

    info = json.loads(run_ok("swings-stream", "info", stream, "--json"))
    assert info["played_bytes"] / frames == pytest.approx(best["bytes_per_frame"])
    for said, scored in zip(info["layers"], scores["layers"], strict=True):
        whole_bytes = said["size_bytes"] + reader.overhead_bytes
        assert whole_bytes / frames == pytest.approx(scored["bytes_per_frame"])
        by_turns_db = scored["per_camera_psnr_db"].values()
        assert min(by_turns_db) - 1 < said["psnr_db"] < max(by_turns_db) + 1
    assert "swings-eval adds manifest and index" in run_ok("swings-stream", "info", stream)


def test_options_that_do_not_go_together() -> None:
    drawing = "--compare draws and does not score"
    cases: list[tuple[dict[str, Any], str]] = [
        ({"json": True}, drawing),
        ({"sheet": Path("s.png")}, drawing),
        ({"training_cameras": True}, drawing),
        ({"compare": ("cam00", Path("x.gif"))}, "name an .mp4 file, or a folder"),
    ]
    for options, message in cases:
        with pytest.raises(InvalidError, match=message):
            EvaluateConfig("s", "c", **{"compare": ("cam00", Path("x.mp4")), **options})


FRAMES, SEGMENT = 8, 3


@pytest.mark.parametrize("killed_at", [None, 4, 7])
@pytest.mark.parametrize("swin_size", [1, 3])
def test_frames_score_as_they_show(swin_size: int, killed_at: int | None, tmp_path: Path) -> None:
    """Also where the writer is dropped before the birth `killed_at`, and another one resumes."""
    capture, stream = tmp_path / "capture", tmp_path / "stream"
    write_dynamic3dgs(capture, num_cameras=3, num_frames=FRAMES)
    lattice = Lattice(0.01, 0.05, 1 / 60, 0.056, 161, -2.0)
    layout = SlotLayout(swin_size, (20, 10), 0, (lattice,) * 2, SEGMENT)
    manifest = replace(seen_by(slots_manifest(layout), capture), near_m=0.2)
    updates = patternless_updates(layout, FRAMES)
    said: dict[int, list[float]] = {}

    def noted(frame: int, slices: Sequence[Slice]) -> list[float] | None:
        scores_db = meter(frame, slices)
        if scores_db is not None:
            said[frame] = scores_db
            assert meter.mean_db == scores_db[-1]  # of the only camera
        return scores_db

    with FrameCache(open_capture(capture), range(FRAMES), 1.0, 1 << 24) as cache:
        meter = QualityMeter(cache, manifest)
        writer = StreamWriter.create(stream, manifest, quality=noted)
        for update in updates:
            if update.birth == killed_at:
                writer.abort()
                meter = QualityMeter(cache, manifest)
                writer = StreamWriter.resume(stream, quality=noted)
                meter.recall(StreamReader(stream), writer.next_birth)
                for again in updates[writer.next_birth - updates[0].birth :]:
                    if again.birth < killed_at:
                        writer.append(again)
            writer.append(update)
        writer.close()
    scores = evaluate_stream(EvaluateConfig(stream, capture)).layers
    expected = np.transpose([score.per_frame_psnr_db for score in scores])
    assert np.array([said[frame] for frame in range(FRAMES)]) == pytest.approx(expected, abs=1e-4)
    assert len({round(db, 6) for frame in said.values() for db in frame}) > FRAMES  # they differ
    for record in StreamReader(stream).records:
        frames = range(record.first_frame, record.first_frame + record.num_frames)
        assert record.psnr_db == pytest.approx(expected[frames].mean(axis=0), abs=1e-4)


@pytest.mark.parametrize("segment_frames", [2, 4, 5])
def test_quality_does_not_depend_on_the_camera_whose_turn_it_is(
    segment_frames: int, tmp_path: Path
) -> None:
    """With very different cameras, neither the progress nor the index jumps from one to another."""
    write_dynamic3dgs(tmp_path / "capture", num_cameras=6, num_frames=8)
    capture = open_capture(tmp_path / "capture")
    far = tuple(replace(c, held_out=i >= 3) for i, c in enumerate(capture.cameras))
    capture = replace(capture, cameras=far)
    manifest = replace(tiny_manifest(segment_frames=segment_frames), near_m=0.2)
    with FrameCache(capture, range(8), 1.0, 1 << 24) as cache:
        meter = QualityMeter(cache, manifest)
        assert meter.mean_db is None
        means: list[float] = []
        by_segment: dict[int, list[float]] = {}
        for birth in range(manifest.first_birth, 8):
            slice = tiny_slice(birth)
            scores_db = meter(birth, [slice] * manifest.num_layers)
            if birth >= 0:
                assert meter.mean_db is not None
                means.append(meter.mean_db)
            if scores_db is not None:
                by_segment.setdefault(birth // segment_frames, []).append(scores_db[-1])
    by_turns = [db for scores_db in by_segment.values() for db in scores_db]
    in_index = [np.mean(scores_db) for scores_db in by_segment.values()]
    assert len(in_index) == -(-8 // segment_frames)
    assert max(in_index) - min(in_index) < 0.35  # what the frames differ by
    assert max(means) - min(means) < 0.3
    assert means[0] == pytest.approx(in_index[0], abs=0.2)
    # The red of a picture grows with its camera, and the Gaussians hide little of it.
    assert max(by_turns) - min(by_turns) > 1 or segment_frames < 3  # else of all cameras at once
