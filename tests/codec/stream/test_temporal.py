"""A stream with a temporal layer: with it every frame is the same, without it the missing frames
are interpolated between their neighbours, and the index has the quality of both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from codec.errors import InvalidError, UnsupportedError
from codec.interop.formats import SplatFormat, write_splats
from codec.sequence.importing import ImportOptions, import_stream
from codec.slice import Slice
from codec.splats import Splats
from codec.stream import StreamReader, StreamWriter
from codec.stream.manifest import Manifest
from codec.tools.audit import describe, verify_stream
from codec.tools.packing import pack_stream
from codec.tools.static import export_static
from tests.support.deforming import Deforming
from tests.support.drawn import same_splats
from tests.support.hostile import refused
from tests.support.slots.folder import slots_manifest
from tests.support.slots.updates import patternless_updates, small_layout

NUM_FRAMES = 19
OPTIONS = ImportOptions(fps=30, layers=2)


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same files as streams `plain`, and `halved` with a temporal layer."""
    path, model = tmp_path_factory.mktemp("temporal"), Deforming(400, 0)
    (path / "files").mkdir()
    for frame in range(NUM_FRAMES):
        write_splats(path / f"files/{frame:03}.ply", model.next(), SplatFormat.PLY)
    import_stream(path / "files", path / "plain", OPTIONS)
    import_stream(path / "files", path / "halved", replace(OPTIONS, temporal=2))
    return path


def test_all_layers_show_the_same_frames(root: Path) -> None:
    plain, halved = StreamReader(root / "plain"), StreamReader(root / "halved")
    assert halved.manifest.num_layers == plain.manifest.num_layers + 1
    for frame in [*range(NUM_FRAMES), 7, 16, 3]:
        wanted = plain.active_splats(frame, 2)
        assert same_splats(halved.active_splats(frame, 3), wanted)
        if frame % 2 == 0:
            for layers in (1, 2):
                wanted = plain.active_splats(frame, layers)
                assert same_splats(halved.active_splats(frame, layers), wanted)


def test_what_is_left_out_lies_between_its_neighbours(root: Path) -> None:
    plain, halved = StreamReader(root / "plain"), StreamReader(root / "halved")
    for frame in range(1, NUM_FRAMES - 1, 2):
        before, wanted, after = (
            plain.window(frame + step, 2)[0].splats.means for step in (-1, 0, 1)
        )
        found = halved.window(frame, 2)[0].splats.means
        held_m, between_m = (
            np.median(np.linalg.norm(means - wanted, axis=1)) for means in (before, found)
        )
        assert between_m < 0.7 * held_m
        motion = np.linalg.norm(after - before, axis=1)
        moves = (motion > 0.005) & (motion < 0.1)
        middle = (before + after)[moves] / 2
        step_m = max(lattice.position_m for lattice in plain.manifest.lattice)
        near = (abs(found[moves] - middle) <= step_m).all(axis=1)
        assert near.mean() > 0.95  # the others are new, or so small that they jump


def test_it_is_a_stream_like_others(root: Path, tmp_path: Path) -> None:
    summary = verify_stream(root / "halved")
    assert (summary.num_frames, summary.temporal_period) == (NUM_FRAMES, 2)
    assert "the last layer: all but 1 of 2 frames" in describe(summary)
    export_static(root / "halved", tmp_path / "static")
    verify_stream(tmp_path / "static")
    pack_stream(root / "halved", tmp_path / "one.swings")
    verify_stream(tmp_path / "one.swings")
    halved = StreamReader(root / "halved")
    for path in (tmp_path / "static", tmp_path / "one.swings"):
        for frame in (0, 1, 10, 17):
            for layers in (1, 2, 3):
                found = StreamReader(path).active_splats(frame, layers)
                assert same_splats(found, halved.active_splats(frame, layers))


def test_the_index_knows_what_is_shown_without_it(tmp_path: Path) -> None:
    """Each frame is scored once, in order; without the layer, as such a reader shows it."""
    told: dict[int, list[Splats]] = {}

    def quality(birth: int, slices: Sequence[Slice]) -> list[float]:
        told[birth] = [part.splats for part in slices]
        return [float(birth)] * len(slices)

    layout = small_layout(1, (5, 3), 0, 8, 4)
    updates = patternless_updates(small_layout(1, (5, 3), 0, 8), 19, calm=3)
    path, manifest = tmp_path / "s", slots_manifest(layout)
    with StreamWriter.create(path, manifest, quality=quality) as writer:
        for update in updates[:12]:
            writer.append(update)
        writer.abort()
    with StreamWriter.resume(path, quality=quality) as writer:
        for update in updates[writer.next_birth :]:
            writer.append(update)
    assert sorted(told) == list(range(19))
    reader = StreamReader(path)
    assert [record.psnr_db[0] for record in reader.records] == [3.5, 11.5, 17]
    for frame, slices in told.items():
        # Nothing after a segment is known when its record is written.
        if frame // 4 % 2 == 1 or frame >= 16:
            continue
        for layers, found in enumerate(slices, start=1):
            assert same_splats(found, reader.slice(frame, layers).splats)


def test_the_manifest(root: Path) -> None:
    data = (root / "halved/manifest.json").read_bytes()
    assert b'"version": 3' in data
    assert b'"version": 2' in (root / "plain/manifest.json").read_bytes()
    manifest = Manifest.from_json(data)
    assert manifest.slots[-1] == 0
    assert Manifest.from_json(manifest.to_json()).to_json() == manifest.to_json()
    with pytest.raises(UnsupportedError, match="version 4"):
        Manifest.from_json(data.replace(b'"version": 3', b'"version": 4'))
    for wrong in (b"1", b"9", b"7", b"2.0", b"true"):
        with pytest.raises(Exception, match=r"manifest: (slots: )?(a temporal|temporal_period)"):
            Manifest.from_json(
                data.replace(b'"temporal_period": 2', b'"temporal_period": %s' % wrong)
            )
    refused(InvalidError, "swin_size of 1", lambda: slots_manifest().with_temporal_layer(2))
