"""The verdict on memory and time over the length of a video, its table and its plot."""

from __future__ import annotations

from pathlib import Path

import pytest
from rich.console import Console

from bench.length import (
    LengthConfig,
    Track,
    complaints,
    draw,
    make_loop,
    own_memory_bytes,
    table_of,
    train,
    write_looped,
)
from trainer.capture.layout import open_capture

MB = 1_000_000


def test_growth_is_what_is_complained_about() -> None:
    flat = Track([1.0] + [0.05] * 299, [200 * MB] * 300, 201 * MB)
    assert complaints([flat]) == []
    fills = Track(flat.seconds, [100 * MB] * 29 + [200 * MB] * 271, 201 * MB)
    assert complaints([fills]) == []
    grows = Track(flat.seconds, [200 * MB] * 290 + [212 * MB] * 10, 212 * MB)
    slows = Track([1.0] + [0.05] * 249 + [0.06] * 50, flat.memory_bytes, 201 * MB)
    assert complaints([grows, slows]) == [
        "300 frames: memory +6.0%",
        "300 frames: time per frame +20.0%",
    ]
    # A few short frames are too few to judge time, but not memory.
    short = Track([1.0] + [0.05] * 15 + [0.06] * 14, [200 * MB] * 20 + [220 * MB] * 10, 220 * MB)
    assert short.time_growth == pytest.approx(0.2)
    assert complaints([short]) == ["30 frames: memory +10.0%"]


def test_a_looped_capture_trains_frame_by_frame(tmp_path: Path) -> None:
    config = LengthConfig(tmp_path / "length.png", num_gs=60, window_iterations=2, cameras=5)
    loop = make_loop(config, tmp_path)
    write_looped(loop, tmp_path / "capture", 12)
    capture = open_capture(tmp_path / "capture")
    assert capture.num_frames == 12
    source = capture.open_images(0)
    assert (source.read(11) == source.read(1)).all()
    source.close()
    track = train(config, tmp_path / "capture", tmp_path / "stream")
    assert track.num_frames == len(track.memory_bytes) == 12
    assert min(track.seconds) > 0
    assert 0 < track.end_bytes <= track.peak_bytes
    assert own_memory_bytes("VmRSS") < 2 * track.peak_bytes
    console = Console(width=120)
    with console.capture() as shown:
        console.print(table_of([track]))
    assert "12" in shown.get()
    draw([track], config)
    assert config.out.read_bytes().startswith(b"\x89PNG")
