"""Scores of shown frames: equal to the stream's if all packets are in time, else lower."""

from __future__ import annotations

from pathlib import Path
from statistics import fmean
from typing import Any

import pytest
from rich.console import Console

from bench.network.shown import shown_scores, table_of
from codec.errors import InvalidError
from codec.stream import StreamReader
from tests.bench.scored_stream import FRAMES, write_scored
from trainer.score.evaluate import EvaluateConfig, evaluate_stream
from trainer.score.truth import open_held_out


def report_of(reader: StreamReader, layers: int, late_s: float = 0.0) -> dict[str, Any]:
    """The report of a play in which `layers` layers arrived before the start, and the others
    `late_s` after the frame in which they were due; never if `late_s` is 0."""
    manifest = reader.manifest
    arrivals = []

    def came(first_layer: int, count: int, came_s: float, **what: int) -> None:
        packets = {"first_layer": first_layer, "layers": count, "bytes": 1, "came_s": came_s}
        arrivals.append({"play": 0, "birth": None, "snapshot_frame": None, **packets, **what})

    for first, count in ((0, layers), (layers, manifest.num_layers - layers)):
        if not count or (first and not late_s):
            continue
        came(first, count, late_s if first else 0.0, snapshot_frame=0)
        for birth in range(1, FRAMES):
            came(first, count, birth + late_s if first else 0.0, birth=birth)
    frames = [{"play": 0, "frame": frame, "shown_s": float(frame)} for frame in range(FRAMES)]
    return {"frames": frames, "arrivals": arrivals, "dropped": {"frames": 0, "arrivals": 0}}


def test_it_scores_the_packets_that_had_come(tmp_path: Path) -> None:
    stream, capture = write_scored(tmp_path)
    expected = evaluate_stream(EvaluateConfig(stream, capture)).layers
    with open_held_out(stream, capture) as held_out:
        for layers in (1, 2):
            scores = list(shown_scores(held_out, report_of(held_out.reader, layers), 1))
            assert [score.frame for score in scores] == list(range(FRAMES))
            found = [score.rendered_db for score in scores]
            assert found == pytest.approx(expected[layers - 1].per_frame_psnr_db, abs=1e-6)
            assert scores[-1].layers == layers
        # Packets that arrive half a frame late show from the next frame on.
        late = list(shown_scores(held_out, report_of(held_out.reader, 1, 0.5), 1))
        assert late[0].rendered_db == pytest.approx(expected[0].per_frame_psnr_db[0], abs=1e-6)
        assert 1 < fmean(score.layers for score in late) < 2
    console = Console(width=100)
    with console.capture() as shown:
        console.print(table_of(late))
    assert "all" in shown.get()


def test_every_other_frame_and_a_report_that_lacks_some(tmp_path: Path) -> None:
    stream, capture = write_scored(tmp_path)
    with open_held_out(stream, capture) as held_out:
        report = report_of(held_out.reader, 2)
        assert [score.frame for score in shown_scores(held_out, report, 2)] == [0, 2, 4]
        report["dropped"]["arrivals"] = 1
        with pytest.raises(InvalidError, match="lacks part of the play"):
            list(shown_scores(held_out, report, 1))
