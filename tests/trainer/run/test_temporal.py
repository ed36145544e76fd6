"""swings-train --temporal: the same film, with an additional layer."""

from __future__ import annotations

from pathlib import Path

import pytest

from codec.stream import StreamReader
from codec.tools.audit import verify_stream
from tests.support.commands import run, run_ok
from tests.support.drawn import same_splats
from tests.support.tiny_capture import write_dynerf

FRAMES = 6
QUICK = "--num-gs", 60, "--genesis-iterations", 4, "--settle-rounds", 1, "--window-iterations", 1


def test_a_temporal_layer_changes_no_frame(tmp_path: Path) -> None:
    write_dynerf(tmp_path / "capture", 4, FRAMES)
    made = {}
    for period in (1, 2):
        out = tmp_path / f"s{period}"
        run_ok("swings-train", tmp_path / "capture", out, *QUICK, "--temporal", period)
        assert verify_stream(out).num_frames == FRAMES
        made[period] = StreamReader(out)
    plain, halved = made[1], made[2]
    assert halved.manifest.num_layers == plain.manifest.num_layers + 1
    assert halved.manifest.segment_frames == 16
    for frame in range(FRAMES):
        wanted = plain.active_splats(frame, plain.manifest.num_layers)
        assert same_splats(halved.active_splats(frame, halved.manifest.num_layers), wanted)
    assert halved.records[0].psnr_db[-1] == pytest.approx(plain.records[0].psnr_db[-1])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--temporal", 9), "temporal 9: choose 1 to 8"),
        (("--temporal", 2, "--swin-size", 5), "--temporal needs --swin-size 1"),
        (("--temporal", 2, "--ray"), "cannot be combined with --ray"),
        (("--temporal", 2, "--layers", *[1 / 16] * 16), "choose --layers of 15 shares"),
    ],
)
def test_options_that_do_not_go_together(
    tmp_path: Path, arguments: tuple[object, ...], message: str
) -> None:
    failed = run("swings-train", tmp_path, tmp_path / "s", *arguments)
    assert failed.returncode in (1, 2)
    assert message in " ".join(failed.stderr.split())
