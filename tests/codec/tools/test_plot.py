"""swings-stream info --plot: the plotted numbers, and a picture that is written atomically."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from codec.errors import CorruptError, InvalidError
from codec.stream import StreamReader, StreamWriter
from codec.stream.manifest import Manifest
from codec.tools.plot import LAYER_COLOURS, bitrates_bps, draw_stream
from tests.support.commands import run_ok
from tests.support.tiny_stream import tiny_manifest, tiny_slice, write_tiny

WHITE = (255, 255, 255)


@pytest.fixture(scope="module")
def stream(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A stream of six frames in two segments of unknown quality."""
    path = tmp_path_factory.mktemp("plot") / "stream"
    write_tiny(path, 6)
    return path


def write_scored(path: Path, manifest: Manifest, scores_db: Sequence[tuple[float, ...]]) -> Path:
    """Writes a stream whose frame n has the quality `scores_db[n]`."""

    def quality(frame: int, slices: object) -> tuple[float, ...] | None:
        return scores_db[frame] if frame >= 0 else None

    with StreamWriter.create(path, manifest, quality=quality) as writer:
        for birth in range(manifest.first_birth, len(scores_db)):
            writer.append(tiny_slice(birth))
    return path


def pixels(path: Path) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    with Image.open(path) as picture:
        assert picture.format == "PNG"
        return np.asarray(picture.convert("RGB"))


def columns_of(drawn: np.ndarray[tuple[int, ...], np.dtype[np.uint8]], colour: str) -> list[int]:
    """Columns of the picture that contain `colour`."""
    rgb = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
    return list(np.flatnonzero((drawn == rgb).all(axis=2).any(axis=0)))


def test_the_bitrate_is_that_of_the_files(stream: Path) -> None:
    reader = StreamReader(stream)
    rates_bps = bitrates_bps(reader.records, reader.manifest.fps)
    assert rates_bps.shape == (2, 2)
    for segment, seconds in ((0, 4 / 25), (1, 2 / 25)):  # the last segment is short
        for layer in range(2):
            size = (stream / "segments" / str(segment) / str(layer)).stat().st_size
            assert rates_bps[segment, layer] == pytest.approx(8 * size / seconds)


def test_quality_is_drawn_where_it_is_known(stream: Path, tmp_path: Path) -> None:
    draw_stream(stream, tmp_path / "deep" / "plain.png")
    plain = pixels(tmp_path / "deep" / "plain.png")
    # Two layers: the first and the last colour, over most of the width.
    for colour in (LAYER_COLOURS[0], LAYER_COLOURS[-1]):
        assert len(columns_of(plain, colour)) > 0.3 * plain.shape[1], colour
    assert tuple(plain[2, 2]) == WHITE
    scored = write_scored(tmp_path / "scored", tiny_manifest(), [(20.0, 30.0)] * 6)
    draw_stream(scored, tmp_path / "scored.png")
    assert pixels(tmp_path / "scored.png").shape[0] > 1.3 * plain.shape[0]
    assert sorted(path.name for path in (tmp_path / "deep").iterdir()) == ["plain.png"]


def test_a_segment_without_quality_is_a_gap(tmp_path: Path) -> None:
    nan = (math.nan, math.nan)
    known = [(20.0, 30.0)] * 4
    whole = write_scored(tmp_path / "whole", tiny_manifest(), known * 3)
    gap = write_scored(tmp_path / "gap", tiny_manifest(), known + [nan] * 4 + known)
    counts = []
    for path in (whole, gap):
        draw_stream(path, tmp_path / "drawn.png")
        drawn = pixels(tmp_path / "drawn.png")
        panel = drawn[drawn.shape[0] // 2 :, : drawn.shape[1] * 3 // 4]
        counts.append(len(columns_of(panel, LAYER_COLOURS[0])))
    assert counts[1] == pytest.approx(counts[0] * 2 / 3, rel=0.1)


@pytest.mark.parametrize("num_layers", [1, 3, 16])
def test_any_number_of_layers_and_any_title(num_layers: int, tmp_path: Path) -> None:
    manifest = tiny_manifest()
    slots, lattices = (40,) * num_layers, manifest.lattice[:1] * num_layers
    title = "$\\frac{1}$ _a_ \n" * 20
    made = replace(manifest, slots=slots, lattice=lattices, title=title)
    scored = write_scored(tmp_path / "s", made, [tuple(20.0 + n for n in range(num_layers))] * 2)
    draw_stream(scored, tmp_path / "drawn.png")
    assert len(columns_of(pixels(tmp_path / "drawn.png"), LAYER_COLOURS[0])) > 200


def test_nothing_to_draw_and_nothing_half_drawn(tmp_path: Path) -> None:
    StreamWriter.create(tmp_path / "empty", tiny_manifest()).abort()
    with pytest.raises(InvalidError, match="has no frames yet; there is nothing to draw"):
        draw_stream(tmp_path / "empty", tmp_path / "drawn.png")
    with pytest.raises(CorruptError, match="is not a folder"):
        draw_stream(tmp_path / "none", tmp_path / "drawn.png")
    assert [path.name for path in tmp_path.iterdir()] == ["empty"]


def test_the_command(stream: Path, tmp_path: Path) -> None:
    picture = tmp_path / "rate.png"
    told = json.loads(run_ok("swings-stream", "info", stream, "--json", "--plot", picture))
    drawn = picture.read_bytes()
    assert told["num_frames"] == 6
    text = run_ok("swings-stream", "info", stream, "--plot", picture)
    assert text.endswith(f"picture      {picture}\n")
    assert picture.read_bytes() == drawn
    with pytest.raises(InvalidError, match="cannot be written"):
        draw_stream(stream, stream / "index.bin" / "x.png")
