"""Traffic of a stream: every file is either played, or used only for joining."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from codec.slots.update import PREDICTED
from codec.stream import StreamReader, StreamWriter
from tests.support.slots.folder import slots_manifest
from tests.support.slots.updates import patternless_updates, small_layout
from tests.support.tiny_capture import seen_by, write_dynamic3dgs
from tests.support.tiny_stream import write_tiny
from trainer.score.evaluate import EvaluateConfig, evaluate_stream
from trainer.score.traffic import traffic

FRAMES = 7  # in segments of 3: the last one is short


@pytest.mark.parametrize("swin_size", [1, 3])
def test_who_plays_from_frame_0_fetches_no_later_snapshot(swin_size: int, tmp_path: Path) -> None:
    capture, stream = tmp_path / "capture", tmp_path / "stream"
    write_dynamic3dgs(capture, num_cameras=3, num_frames=FRAMES)
    layout = small_layout(swin_size, (9, 6, 4), 0, 3)
    updates = patternless_updates(layout, FRAMES)
    manifest = replace(seen_by(slots_manifest(layout), capture), live=True)
    with StreamWriter.create(stream, manifest) as writer:
        for update in updates:
            writer.append(update)
    found = evaluate_stream(EvaluateConfig(stream, capture)).layers
    assert len(found) == 3
    edges = layout.row_edges
    for score in found:
        names = [*map(str, range(score.layers)), "masks"]
        snapshots = [f"snapshot-{layer}" for layer in range(score.layers)]
        segments = stream / "segments"
        sizes = {
            segment: sum((segments / segment / name).stat().st_size for name in names)
            for segment in "012"
        }
        played = sum(sizes.values())
        joined = [
            sum((segments / segment / name).stat().st_size for name in snapshots)
            for segment in "012"
        ]
        objects = played + joined[0]
        overhead = sum((stream / n).stat().st_size for n in ("manifest.json", "index.bin"))
        assert score.bytes_per_frame * FRAMES == pytest.approx(objects + overhead)
        assert score.snapshot_bytes_per_frame * FRAMES == pytest.approx(joined[1] + joined[2])
        assert score.bits_per_second == pytest.approx(8 * 25 * score.bytes_per_frame)
        # Before frame 0 nothing is predicted, and the snapshots contain the state of frame 0.
        sent = sum(
            int((update.statuses[: edges[score.layers]] >= PREDICTED).sum()) for update in updates
        )
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
