"""Masks on their way from the cache to training and to the scores."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from codec.arrays import Bytes
from codec.lattice.lattice import Lattice
from codec.rig import rig_centre
from codec.slice import Slice
from codec.splats import Splats
from codec.stream import StreamReader, StreamWriter
from tests.support.tiny_capture import HEIGHT_PX, WIDTH_PX, picture_of, seen_by, tiny_rig
from tests.support.tiny_models import transforms_of, write_pictures, write_transforms
from tests.support.tiny_stream import tiny_manifest
from tests.support.waiting import wait_until
from trainer.capture.layout import open_capture
from trainer.errors import CaptureError
from trainer.pictures.framecache import FrameCache
from trainer.pictures.scale import half_mask, scaled_mask
from trainer.score.evaluate import EvaluateConfig, LayerScore, evaluate_stream
from trainer.score.meter import QualityMeter

FRAMES, SWIN, SLOTS = 3, 2, (30, 30)


def hole(frame: int) -> Bytes:
    """(36, 64) 0/1 mask: a part near the middle is ignored, a different one in each frame."""
    mask = np.ones((HEIGHT_PX, WIDTH_PX), np.uint8)
    mask[8:20, 20 + frame : 41] = 0
    return mask


def write_masked(root: Path, garbage: int | None = None, masked: bool = True) -> None:
    """Writes three cameras of three frames; cam00, held out, and cam01 have masks for every frame.

    garbage: colour of ignored pixels, instead of the picture.
    """

    def picture(index: int, frame: int) -> Bytes:
        shown = picture_of(index, frame)
        if garbage is not None and index < 2:
            shown[hole(frame) == 0] = garbage
        return shown

    cameras = tiny_rig(3)
    value = transforms_of(cameras, write_pictures(root, cameras, FRAMES, False, picture))
    for number, entry in enumerate(value["frames"][: 2 * FRAMES] if masked else ()):
        entry["mask_path"] = f"masks/{number % FRAMES}.png"
    (root / "masks").mkdir()
    for frame in range(FRAMES):
        Image.fromarray(hole(frame) * np.uint8(255)).save(root / f"masks/{frame}.png")
    write_transforms(root, value)


@settings(max_examples=25)
@given(
    size=st.tuples(st.integers(1, 23), st.integers(1, 23)),
    small=st.tuples(st.integers(1, 23), st.integers(1, 23)),
    seed=st.integers(0, 99),
)
def test_a_small_pixel_counts_if_all_that_it_touches_counts(
    size: tuple[int, int], small: tuple[int, int], seed: int
) -> None:
    height, width = min(small[0], size[0]), min(small[1], size[1])
    mask = (np.random.default_rng(seed).random(size) > 0.1).astype(np.uint8)
    got = scaled_mask(mask, width, height)
    assert got.shape == (height, width)
    assert got.dtype == np.uint8
    for y, x in np.ndindex(height, width):
        top, bottom = y * size[0] // height, -(-(y + 1) * size[0] // height)
        left, right = x * size[1] // width, -(-(x + 1) * size[1] // width)
        assert got[y, x] == mask[top:bottom, left:right].min()


def test_the_cache_scales_masks_with_their_pictures_and_counts_them(tmp_path: Path) -> None:
    write_masked(tmp_path)
    capture, pixels = open_capture(tmp_path), WIDTH_PX * HEIGHT_PX
    with FrameCache(capture, range(1, FRAMES), 0.5) as cache:
        got = cache.mask(1, 2)
        assert got is not None
        assert got.shape == cache.image(1, 2).shape[:2]
        assert np.array_equal(got, half_mask(hole(2)))
        assert cache.mask(1, 2) is got
        assert cache.mask(2, 2) is None
        assert (cache.statistics.hits, cache.statistics.misses) == (1, 2)
        assert cache.statistics.held_bytes == got.size + 3 * got.size
        with pytest.raises(ValueError, match="read-only"):
            got[0, 0] = 1
    with FrameCache(capture, range(FRAMES), max_bytes=5 * pixels) as cache:
        for frame in range(FRAMES):
            cache.image(0, frame)
            assert np.array_equal(cache.mask(0, frame), hole(frame))  # type: ignore[arg-type]
            assert cache.statistics.held_bytes <= 5 * pixels
        assert cache.statistics.evictions > 0


def test_masks_are_read_ahead_too_and_a_still_one_is_held_once(tmp_path: Path) -> None:
    write_masked(tmp_path)
    value = json.loads((tmp_path / "transforms.json").read_text())
    for entry in value["frames"][2 * FRAMES :]:
        entry["mask_path"] = "masks/1.png"
    write_transforms(tmp_path, value)
    with FrameCache(open_capture(tmp_path), range(FRAMES)) as cache:
        for frame in range(FRAMES):
            cache.prefetch([0, 2], frame, 0)
        wait_until(lambda: cache.statistics.prefetched == 6 + 3 + 1)
        assert cache.statistics.held_bytes == (3 * 6 + 3 + 1) * WIDTH_PX * HEIGHT_PX
        assert cache.mask(2, 0) is cache.mask(2, 2)
        assert np.array_equal(cache.mask(0, 1), hole(1))  # type: ignore[arg-type]
        assert cache.statistics.misses == 0


def coarse_slice(birth: int, centre: np.ndarray) -> Slice:
    """Clearly visible Gaussians."""
    rng, size = np.random.default_rng(birth + 9), sum(SLOTS)
    splats = Splats(
        (centre + rng.normal(0, 0.7, (size, 3))).astype(np.float32),
        rng.normal(-1.5, 0.4, (size, 3)).astype(np.float32),
        rng.normal(size=(size, 4)).astype(np.float32),
        rng.normal(0, 1, size).astype(np.float32),
        (rng.integers(-9, 9, (size, 1, 3)) / 8).astype(np.float32),
    )
    return Slice(birth, splats, np.zeros(size, np.uint8))


def write_stream(path: Path, capture_path: Path) -> tuple[float, ...]:
    """Writes a stream of coarse Gaussians; returns the quality recorded meanwhile."""
    manifest = replace(
        seen_by(tiny_manifest(SWIN, segment_frames=FRAMES), capture_path), slots=SLOTS,
        lattice=(Lattice(0.01, 1 / 8, 1 / 60, 1 / 20, 41),) * 2, near_m=0.2,
    )  # fmt: skip
    centre = rig_centre(manifest.cameras)
    assert centre is not None
    with FrameCache(open_capture(capture_path), range(FRAMES)) as cache:
        meter = QualityMeter(cache, manifest)
        with StreamWriter.create(path, manifest, quality=meter) as writer:
            for birth in range(1 - SWIN, FRAMES):
                writer.append(coarse_slice(birth, centre))
    return StreamReader(path).records[0].psnr_db


def test_scores_see_only_what_counts(tmp_path: Path) -> None:
    noted, scored, moving = [], list[list[LayerScore]](), []
    for name, garbage, masked in (("a", 9, True), ("b", 200, True), ("c", 200, False)):
        write_masked(tmp_path / name, garbage, masked)
        noted.append(write_stream(tmp_path / f"{name}.s", tmp_path / name))
        config = EvaluateConfig(tmp_path / f"{name}.s", tmp_path / name)
        found = evaluate_stream(config)
        scored.append(found.layers)
        moving.append(found.moving_share)
    assert noted[0] == noted[1]
    assert scored[0] == scored[1]
    # Only the garbage changes.
    assert moving[0] == moving[1] == 0
    assert moving[2]
    assert noted[1] != noted[2]
    for with_masks, without in zip(scored[1], scored[2], strict=True):
        assert with_masks.psnr_db != pytest.approx(without.psnr_db, abs=0.01)
        assert with_masks.ssim != pytest.approx(without.ssim, abs=1e-3)
        assert with_masks.flicker != without.flicker


def test_a_mask_that_ignores_all_leaves_nothing_to_score(tmp_path: Path) -> None:
    write_masked(tmp_path / "c")
    black = np.zeros((HEIGHT_PX, WIDTH_PX), np.uint8)
    Image.fromarray(black).save(tmp_path / "c/masks/1.png")
    assert write_stream(tmp_path / "s", tmp_path / "c")  # from the other frames
    with pytest.raises(CaptureError, match="camera cam01 ignores all of frame 1") as caught:
        evaluate_stream(EvaluateConfig(tmp_path / "s", tmp_path / "c"))
    assert "\n" not in str(caught.value)
