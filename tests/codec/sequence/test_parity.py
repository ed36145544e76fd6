"""A stream exported to files and imported again: about the same bytes, the same pictures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from codec.camera import Camera
from codec.interop.exporting import export_stream
from codec.interop.formats import read_splats
from codec.sequence.importing import ImportOptions, facing_camera, import_stream
from codec.stream import StreamReader, StreamWriter
from codec.stream.layers import Rank
from player.render.cpu import render_splats
from tests.support.slots.slot_streams import gaussians, slot_manifest
from tests.support.slots.trained_updates import trained_like_layout, trained_like_updates

NUM_FRAMES, NUM_GS = 16, 2000


@pytest.mark.parametrize("swin_size", [1, 2, 5])
def test_an_exported_stream_comes_back_exactly(swin_size: int, tmp_path: Path) -> None:
    layout = trained_like_layout(NUM_GS // swin_size, swin_size, 15)
    with StreamWriter.create(tmp_path / "s", slot_manifest(layout)) as writer:
        for update in trained_like_updates(layout, NUM_FRAMES, 0.3):
            writer.append(update)
    export_stream(tmp_path / "s", tmp_path / "seq" / "f.ply", None, "0:", None, None)
    made = import_stream(tmp_path / "seq", tmp_path / "t", ImportOptions(fps=30))
    assert made.num_frames == NUM_FRAMES
    assert 0.5 * writer.bytes_written < made.num_bytes < 1.15 * writer.bytes_written
    assert 0.5 * writer.played_bytes < made.played_bytes < 1.15 * writer.played_bytes
    reader, source = StreamReader(tmp_path / "t"), StreamReader(tmp_path / "s")
    low, high = (np.array(corner) for corner in reader.manifest.bounds)
    camera: Camera = facing_camera(low, high).scaled(0.1)
    for frame, file in enumerate(sorted((tmp_path / "seq").iterdir())):
        found = reader.active_splats(frame, 4)
        # Equal bit by bit, in another order.
        assert gaussians(found) == gaussians(source.active_splats(frame, 4))
        # Another order changes the picture where two Gaussians have the same depth.
        error = render_splats(found, camera, 0.01) - render_splats(read_splats(file), camera, 0.01)
        assert -10 * np.log10(np.mean(error**2) + 1e-12) >= 50


def test_the_layers_of_the_source_come_back_by_the_order_of_its_files(tmp_path: Path) -> None:
    layout = trained_like_layout(1000, 1, 15)
    with StreamWriter.create(tmp_path / "s", slot_manifest(layout)) as writer:
        for update in trained_like_updates(layout, 1, 0.3):
            writer.append(update)
    export_stream(tmp_path / "s", tmp_path / "f.ply", 0, None, None, None)
    import_stream(tmp_path / "f.ply", tmp_path / "t", ImportOptions(rank=Rank.GIVEN))
    reader, source = StreamReader(tmp_path / "t"), StreamReader(tmp_path / "s")
    for layers in range(1, 5):
        mine, theirs = (one.active_splats(0, layers) for one in (reader, source))
        assert gaussians(mine) == gaussians(theirs)
