"""Whoever trains from cameras that stand too far apart is told before the hours are spent."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from tests.support.tiny_capture import tiny_rig, write_dynerf
from trainer.capture.layout import open_capture
from trainer.fit.config import FitConfig
from trainer.run.apart import apart_warning, neighbour_angle_deg
from trainer.run.config import TrainConfig
from trainer.run.job import train_stream
from trainer.synth.scene import camera_rig

TINY = FitConfig(num_gs=50, genesis_iterations=4, settle_rounds=1, window_iterations=2)


def test_the_angle_is_that_to_the_second_neighbour() -> None:
    for count, arc_deg in ((9, 160.0), (5, 120.0)):
        rig = camera_rig(count, 320, 180, float(np.radians(arc_deg)))
        angle_deg = neighbour_angle_deg(rig)
        assert angle_deg is not None
        # In the middle of an arc the two neighbours are equally far; cameras differ in height, too.
        assert angle_deg == pytest.approx(arc_deg / (count - 1), abs=16)
    assert neighbour_angle_deg(tiny_rig(2)) is None
    assert neighbour_angle_deg(tiny_rig(6, arc_deg=20)) is None  # looks one way


@pytest.mark.parametrize(("num_cameras", "warned"), [(4, True), (9, False)])
def test_a_run_begins_with_the_warning(
    num_cameras: int, warned: bool, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write_dynerf(tmp_path / "capture", num_cameras, 1)
    told = apart_warning(open_capture(tmp_path / "capture"))
    assert (told is not None) == warned
    config = TrainConfig(tmp_path / "capture", tmp_path / "stream", fit=TINY, snapshot_every=0)
    with caplog.at_level(logging.WARNING, "trainer"):
        train_stream(config, Console(quiet=True))
    assert [record.getMessage() for record in caplog.records] == ([told] if warned else [])
    if told is not None:
        assert "3 training cameras stand far apart" in told
        assert "\n" not in told
