"""Colours multiplied by a gain: in the Gaussians of each frame, and in each pixel."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from codec.edit.editing import edit_stream
from codec.edit.recolour import ColourOptions
from codec.errors import InvalidError
from codec.splats import SH_C0, Splats
from codec.stream import StreamReader
from codec.tools.audit import verify_stream
from player.render.cpu import render_splats
from tests.support.slots.edited import (
    frames_of,
    least_psnr_db,
    objects_bytes,
    overview,
    write_still,
    write_trained_like,
)
from tests.support.slots.slot_streams import write_slot_stream
from tests.support.slots.updates import small_layout


def gained(splats: Splats, gains: tuple[float, ...]) -> Splats:
    """`splats` with multiplied colours, coefficient by coefficient."""
    sh = splats.sh * np.array(gains)
    sh[:, 0] += (np.array(gains) - 1) / (2 * SH_C0)
    return Splats(*splats.arrays[:4], sh.astype(np.float32))


def write_moving(path: Path) -> Path:
    return write_trained_like(path, 1)


@pytest.mark.parametrize(
    ("options", "gains", "write"),
    [
        (ColourOptions(gain=(1.2, 1.0, 0.9)), (1.2, 1.0, 0.9), write_still),
        (ColourOptions(exposure=1), (2 ** (1 / 2.2),) * 3, write_moving),
        (ColourOptions(exposure=-2), (2 ** (-2 / 2.2),) * 3, write_moving),
        (ColourOptions(gain=(1.0158, 1.0158, 1.0158)), (1.0158,) * 3, write_moving),
        (ColourOptions(gain=(1.2, 1.0, 0.9)), (1.2, 1.0, 0.9), write_moving),
        (ColourOptions(white=(0.8, 0.6, 0.4)), (0.6 / 0.8, 1.0, 0.6 / 0.4), write_moving),
    ],
)
def test_the_same_edit_made_on_exported_frames_gives_the_same_pictures(
    options: ColourOptions, gains: tuple[float, ...], write: Callable[[Path], Path], tmp_path: Path
) -> None:
    np.testing.assert_allclose(options.gains(), gains, rtol=1e-12)
    source = write(tmp_path / "s")
    edit_stream(source, tmp_path / "t", options)
    verify_stream(tmp_path / "t")
    assert least_psnr_db(source, tmp_path / "t", lambda splats, _: gained(splats, gains)) >= 45
    assert objects_bytes(tmp_path / "t") <= objects_bytes(source)


def test_each_pixel_is_multiplied(tmp_path: Path) -> None:
    source = write_trained_like(tmp_path / "s", 5)
    edit_stream(source, tmp_path / "t", ColourOptions(gain=(0.5, 0.9, 1.1)))
    camera = overview(source)
    before, after = (
        render_splats(next(frames_of(path)), camera, 0.01) for path in (source, tmp_path / "t")
    )
    error = after - before * np.array([0.5, 0.9, 1.1])
    assert -10 * np.log10(np.mean(error**2)) >= 45


@pytest.mark.parametrize("degree", [1, 3])
def test_harmonics_and_escaped_gaussians_are_multiplied_too(degree: int, tmp_path: Path) -> None:
    layout = small_layout(2, (20, 10), degree)
    source = write_slot_stream(tmp_path / "s", 6, layout)
    edit_stream(source, tmp_path / "t", ColourOptions(exposure=-1.1))
    verify_stream(tmp_path / "t")
    gain = float(2 ** (-0.5))
    step = max(lattice.colour for lattice in StreamReader(tmp_path / "t").manifest.lattice)
    for before, after in zip(frames_of(source), frames_of(tmp_path / "t"), strict=True):
        np.testing.assert_array_equal(after.means, before.means)
        wanted = gained(before, (gain,) * 3)
        # Half a step each of Y, Co and Cg.
        assert np.abs(after.sh - wanted.sh).max() <= 1.51 * step


@pytest.mark.parametrize(
    "options",
    [
        ColourOptions(gain=(0, 1, 1)),
        ColourOptions(gain=(1, float("inf"), 1)),
        ColourOptions(white=(0, 1, 1)),
        ColourOptions(exposure=float("nan")),
        ColourOptions(exposure=-100),
    ],
)
def test_gains_that_no_stream_has_are_refused(options: ColourOptions, tmp_path: Path) -> None:
    source = write_slot_stream(tmp_path / "s", 2)
    with pytest.raises(InvalidError):
        edit_stream(source, tmp_path / "t", options)
    assert not (tmp_path / "t").exists()
