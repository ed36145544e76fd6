"""Streams exported and imported again, and the commands of docs/SEQUENCES.md as written."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from codec.camera import Camera
from codec.interop.exporting import export_stream
from codec.interop.formats import SplatFormat, read_splats, write_splats
from codec.sequence.errorbound import ErrorBound
from codec.sequence.importing import ImportOptions, facing_camera, import_stream
from codec.stream import StreamReader, StreamWriter
from codec.stream.layers import Rank
from player.render.cpu import render_splats
from tests.support.commands import ENTRY, ROOT, run_ok
from tests.support.slots.rotating import figure, turned
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


PAGE = (ROOT / "docs" / "SEQUENCES.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^ {4}(swings-.*)$", PAGE, re.MULTILINE)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder after all commands of the page, in order."""
    root = tmp_path_factory.mktemp("page")
    (root / "my-splats").mkdir()
    splats = figure(100)
    for number in range(4):
        path = root / "my-splats" / f"frame_{number:04d}.ply"
        write_splats(path, turned(splats, 0.02 * number), SplatFormat.PLY)
    for line in COMMANDS:
        name, *words = line.split()
        run_ok(name, *words, folder=root)
    return root


def test_the_commands_run(folder: Path) -> None:
    assert len(COMMANDS) == 11
    assert {line.split()[0] for line in COMMANDS} <= set(ENTRY)


def test_they_do_what_the_page_says(folder: Path) -> None:
    sizes, streams = {}, {}
    plain = "my-stream", "finer-stream", "back-stream", "exact-stream", "two-layers"
    for name in (*plain, "halved", "quartered"):
        streams[name] = StreamReader(folder / name)
        sizes[name] = sum(sum(record.part_bytes) for record in streams[name].records)
        assert streams[name].num_frames == 4
    assert sizes["my-stream"] < sizes["finer-stream"]
    assert sizes["back-stream"] < 1.15 * sizes["my-stream"]
    for frame in range(4):
        file = read_splats(folder / "my-splats" / f"frame_{frame:04d}.ply")
        assert gaussians(streams["exact-stream"].active_splats(frame, 4)) == gaussians(file)
        one, other = (streams[n].active_splats(frame, 4) for n in ("my-stream", "back-stream"))
        assert gaussians(one) == gaussians(other)
    assert streams["two-layers"].manifest.num_layers == 2
    assert streams["halved"].manifest.num_layers == 5
    assert streams["halved"].manifest.temporal_period == 2
    assert streams["quartered"].manifest.temporal_period == 4


def test_the_page_has_the_defaults() -> None:
    told = dict(re.findall(r"\| `--error\.(\w+)` \| .* \| ([0-9.]+) \|", PAGE))
    bound = ErrorBound()
    assert told.keys() == {field.name for field in fields(bound)}
    for name, value in told.items():
        assert float(value) == pytest.approx(getattr(bound, name), rel=0.01)
