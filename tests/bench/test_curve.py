"""Streams of one capture side by side: scored once, in a table, in a plot."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

import bench.curve
from bench.curve import CurveConfig, Published, draw, kept_path, measure, table_of
from codec.errors import InvalidError
from tests.support.hostile import refused
from tests.support.tiny_capture import seen_by, write_dynamic3dgs
from tests.support.tiny_stream import tiny_manifest, write_tiny

FRAMES = 4


def write_stream(path: Path, capture: Path, first_frame: int = 0, exact: bool = False) -> Path:
    manifest = replace(seen_by(tiny_manifest(), capture), capture_frame=first_frame)
    write_tiny(path, FRAMES - first_frame, manifest, exact)
    return path


@pytest.fixture
def config(tmp_path: Path) -> CurveConfig:
    capture = tmp_path / "capture"
    write_dynamic3dgs(capture, num_cameras=3, num_frames=FRAMES)
    streams = (
        write_stream(tmp_path / "raw", capture, exact=True),
        write_stream(tmp_path / "late", capture, first_frame=1),
    )
    published = (Published("others", 1, 20), Published("more", 300, 25))
    return CurveConfig(
        streams, capture, tmp_path / "plots" / "curve.png", tmp_path / "work", published
    )


def test_it_scores_once_and_draws(config: CurveConfig, monkeypatch: pytest.MonkeyPatch) -> None:
    curves = measure(config)
    assert [curve.name for curve in curves] == ["raw", "late"]
    assert [curve.frames for curve in curves] == [range(4), range(1, 4)]
    raw, late = (curve.found.layers for curve in curves)
    assert raw[-1].bytes_per_frame > late[-1].bytes_per_frame > 0
    # A player that starts at frame 0 with all layers fetches every file.
    files = [f for f in config.streams[0].rglob("*") if f.is_file()]
    assert raw[-1].bytes_per_frame * FRAMES == sum(f.stat().st_size for f in files)

    def fail(*arguments: object) -> None:
        raise AssertionError("scored again")

    monkeypatch.setattr(bench.curve, "evaluate_stream", fail)
    assert measure(config) == curves
    console = Console(width=110)
    with console.capture() as shown:
        console.print(table_of(curves))
    rows = [line.split() for line in shown.get().splitlines() if "raw" in line or "late" in line]
    assert [row[3] for row in rows] == ["1", "2", "1", "2"]
    for row, score in zip(rows, [*raw, *late], strict=True):
        expected = [score.psnr_db, score.flicker, score.bytes_per_frame / 1e3]
        assert [float(row[i]) for i in (5, 9, 11)] == pytest.approx(expected, abs=0.06)
        assert row[7] == "-"
    for published in (config.published, ()):
        config.out.unlink(missing_ok=True)
        draw(curves, replace(config, published=published))
        assert config.out.read_bytes().startswith(b"\x89PNG")


def test_other_bytes_or_another_step_are_scored_anew(config: CurveConfig) -> None:
    raw, late = config.streams
    paths = {
        kept_path(raw, config),
        kept_path(late, config),
        kept_path(raw, replace(config, every=2)),
    }
    assert len(paths) == 3
    before = kept_path(raw, config)
    again = write_stream(raw.with_name("again"), config.capture, exact=True)
    assert kept_path(again, config) == before
    manifest = json.loads((raw / "manifest.json").read_text())
    (raw / "manifest.json").write_text(json.dumps({**manifest, "title": "another"}))
    assert kept_path(raw, config) != before


def test_a_published_point_is_name_kb_and_db() -> None:
    assert Published.parse("TC3DGS:310:27.9") == Published("TC3DGS", 310, 27.9)
    assert Published.parse("a: b:1.5:20") == Published("a: b", 1.5, 20)
    assert str(Published.parse("a: b:1.5:20")) == "a: b:1.5:20"
    for wrong in ("", "a", "a:1", ":1:2", "a:b:2", "a:0:2", "a:-1:2", "a:inf:2", "a:1:nan"):
        refused(InvalidError, "NAME:KB:DB", Published.parse, wrong)
