"""Steps of an edit that rounds: large enough that the stream does not grow, or unchanged."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from codec.edit.editing import edit_stream
from codec.edit.fitting import MOST, first_segment_bytes, fitted
from codec.edit.rewrite import coder_of_stream
from codec.edit.transform import Transform, TransformOptions
from codec.interop.formats import SplatFormat, write_splats
from codec.sequence.importing import ImportOptions, import_stream
from codec.splats import Splats
from codec.stream import StreamReader
from tests.support.slots.edited import write_trained_like
from tests.support.trained_like import trained_like_splats

TURN = TransformOptions(turn=(10, 20, 30))


def write_few_harmonics(path: Path, num_gs: int) -> Path:
    """Writes a stream of one frame of degree 3 to `path`. One coefficient of degree 2 and one of
    degree 3 are not 0; after an oblique turn, all of them are not 0."""
    splats, rng = trained_like_splats(num_gs), np.random.default_rng(1)
    sh = np.zeros((num_gs, 16, 3), np.float32)
    sh[:, :1] = splats.sh
    sh[:, [5, 11]] = 0.1 * rng.normal(size=(num_gs, 2, 3))
    path.mkdir()
    write_splats(path / "m.ply", Splats(*splats.arrays[:4], sh), SplatFormat.PLY)
    import_stream(path / "m.ply", path / "s", ImportOptions(fps=30))
    return path / "s"


def test_steps_that_would_not_save_enough_stay_as_they_were(tmp_path: Path) -> None:
    source = write_few_harmonics(tmp_path / "m", 1000)
    reader = StreamReader(source)
    coder, limit_bytes = coder_of_stream(reader), sum(reader.records[0].part_bytes)
    edit = Transform(TURN, reader.manifest)
    assert first_segment_bytes(reader, edit.coarser(MOST), coder) > limit_bytes
    assert fitted(reader, edit, coder) is edit
    made = edit_stream(source, tmp_path / "t", TURN)
    assert made.size_bytes > made.source_bytes
    assert StreamReader(tmp_path / "t").manifest.lattice == reader.manifest.lattice


def test_steps_grow_until_the_first_segment_does_not(tmp_path: Path) -> None:
    reader = StreamReader(write_trained_like(tmp_path / "s", 5))
    coder, limit_bytes = coder_of_stream(reader), sum(reader.records[0].part_bytes)
    # With steps half as large the turned stream is larger, so there is something to fit.
    edit = Transform(TURN, reader.manifest, 0.5)
    assert first_segment_bytes(reader, edit, coder) > limit_bytes
    made = fitted(reader, edit, coder)
    assert made is not edit
    assert first_segment_bytes(reader, made, coder) <= limit_bytes
