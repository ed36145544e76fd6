"""Rate against quality with and without a temporal layer."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench.temporal import TemporalConfig, scored
from codec.stream import StreamReader
from codec.tools.audit import verify_stream
from codec.tools.cutting import set_temporal_layer
from tests.bench.scored_stream import FRAMES, write_scored


def test_the_same_stream_with_another_layer(tmp_path: Path) -> None:
    stream, capture = write_scored(tmp_path, 1)
    set_temporal_layer(stream, tmp_path / "halved", 2)
    assert verify_stream(tmp_path / "halved").num_frames == FRAMES
    assert StreamReader(tmp_path / "halved").manifest.temporal_period == 2
    config = TemporalConfig(stream, capture)
    plain, halved = scored(stream, config), scored(tmp_path / "halved", config)
    assert [row.layers for row in halved] == [1, 2, 3]
    assert halved[-1].psnr_db == pytest.approx(plain[-1].psnr_db, abs=1e-6)
    assert halved[-2].bytes_per_frame < plain[-1].bytes_per_frame < halved[-1].bytes_per_frame
