"""The commands of docs/SEQUENCES.md run as written, and do what the page describes."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

import pytest

from codec.interop.formats import SplatFormat, read_splats, write_splats
from codec.sequence.errorbound import ErrorBound
from codec.stream import StreamReader
from tests.support.commands import ENTRY, ROOT, run_ok
from tests.support.slots.rotating import figure, turned
from tests.support.slots.slot_streams import gaussians

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
