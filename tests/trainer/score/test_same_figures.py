"""`swings-stream info` and `swings-eval` agree on a stream, or info states why not."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from codec.stream import StreamReader
from tests.support.commands import run_ok
from tests.support.tiny_capture import write_dynerf

FRAMES = 6


@pytest.mark.parametrize("held_out", [["cam01"], ["cam00", "cam03"]])
def test_info_and_eval_agree_or_info_says_why_not(held_out: list[str], tmp_path: Path) -> None:
    capture, stream = tmp_path / "capture", tmp_path / "stream"
    write_dynerf(capture, 6, FRAMES)
    (capture / "held_out.txt").write_text("\n".join(held_out))
    run_ok(
        "swings-train", capture, stream, "--num-gs", 200, "--genesis-iterations", 20,
        "--settle-rounds", 1, "--window-iterations", 5, "--segment-frames", 4,
    )  # fmt: skip
    info = json.loads(run_ok("swings-stream", "info", stream, "--json"))
    scores = json.loads(run_ok("swings-eval", stream, capture, "--json"))
    overhead_bytes = StreamReader(stream).overhead_bytes
    assert info["played_bytes"] / FRAMES == pytest.approx(scores["layers"][-1]["bytes_per_frame"])
    for said, scored in zip(info["layers"], scores["layers"], strict=True):
        whole_bytes = said["size_bytes"] + overhead_bytes
        assert whole_bytes / FRAMES == pytest.approx(scored["bytes_per_frame"])
        by_turns_db = [scored["per_camera_psnr_db"][name] for name in held_out]
        if len(held_out) == 1:
            assert said["psnr_db"] == pytest.approx(scored["psnr_db"], abs=1e-3)
        else:
            assert min(by_turns_db) - 1 < said["psnr_db"] < max(by_turns_db) + 1
    text = run_ok("swings-stream", "info", stream)
    assert "one held-out\n             camera a frame, in turn" in text
    assert "swings-eval adds manifest and index" in text
