"""The bytes of masks, changes, snapshots and folders of version 2, pinned; codec.slots and the
decoder that was written from FORMAT.md alone read them to the same."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from codec.coders.coder import Coder
from codec.stream import StreamReader
from codec.stream.object import HEAD
from codec.tools.audit import verify_stream
from tests.goldens.pinned_slots import (
    FILE,
    SLOT_CASES,
    SlotCase,
    chunk_table,
    held_sha256,
    made_chunks,
    played,
)
from tests.goldens.slots_folder import StreamFolder, read_manifest
from tests.goldens.slots_reader import Reader
from tests.support.slots.folder import slots_manifest
from tests.support.slots.plain import BothReaders, held, plainly_held

GOLDENS: list[dict[str, Any]] = json.loads(FILE.read_text(encoding="utf-8"))
PAIRS = list(zip(SLOT_CASES, GOLDENS, strict=True))
FOLDERS = [(golden, coder) for case, golden in PAIRS if case.folder for coder in Coder]


def test_every_case_is_pinned_and_small() -> None:
    assert [golden["name"] for golden in GOLDENS] == [case.name for case in SLOT_CASES]
    for case, golden in PAIRS:
        assert len(golden["held_sha256"]) == case.num_frames
        coders = [str(coder.value) for coder in Coder] if case.folder else []
        assert list(golden["folders_hex"]) == coders
    assert FILE.stat().st_size < 100_000


def test_the_cases_hold_what_they_are_for() -> None:
    counts: dict[str, list[int]] = {}
    for case, golden in PAIRS:
        changes = [
            bytes.fromhex(c)
            for layer in range(len(case.slots))
            for c in golden["chunks_hex"][str(layer)]
        ]
        sums = [
            sum(int.from_bytes(data[12 + 4 * n : 16 + 4 * n], "little") for data in changes)
            for n in range(4)
        ]
        counts[case.name] = [*sums, sum(data[6] for data in changes if data)]
        assert case.still != any(changes)
    predicted, new, longs, escapes, late = map(list, zip(*counts.values(), strict=True))
    assert [n > 0 for n in predicted] == [True, True, False, True, True]
    assert [n > 0 for n in new] == [True, True, False, True, True]
    assert longs[3] > 5
    assert [n > 0 for n in escapes] == [False, False, False, False, True]
    assert [n > 0 for n in late] == [False, False, False, False, True]


@pytest.mark.parametrize(("case", "golden"), PAIRS, ids=[case.name for case in SLOT_CASES])
def test_chunks_and_what_they_make_are_as_pinned(case: SlotCase, golden: dict[str, Any]) -> None:
    chunks = made_chunks(case)
    assert chunk_table(chunks) == golden["chunks_hex"]
    assert played(case, chunks) == golden["held_sha256"]


@pytest.mark.parametrize(("case", "golden"), PAIRS, ids=[case.name for case in SLOT_CASES])
def test_a_decoder_written_from_the_format_holds_the_same(
    case: SlotCase, golden: dict[str, Any]
) -> None:
    shape = read_manifest(slots_manifest(case.layout).to_json())
    table, layers = golden["chunks_hex"], range(len(case.slots))
    chunks = {name: [bytes.fromhex(data) for data in row] for name, row in table.items()}
    for segment in range(len(chunks["snapshot-0"])):
        both, first = BothReaders(shape), segment * case.segment_frames
        for layer in layers:
            both.load(chunks[f"snapshot-{layer}"][segment])
        for birth in range(first, case.num_frames):
            if birth > first:
                changes = [chunks[str(layer)][birth] for layer in layers]
                both.apply(birth, chunks["masks"][birth], changes)
            found = held_sha256(plainly_held(both.reader, birth, len(case.slots)))
            assert found == held_sha256(held(both.decoder)) == golden["held_sha256"][birth]


@pytest.mark.parametrize(
    ("golden", "coder"),
    FOLDERS,
    ids=[f"{golden['name']}-{coder.name}" for golden, coder in FOLDERS],
)
def test_folders_of_every_coder_are_read_for_ever(
    golden: dict[str, Any], coder: Coder, tmp_path: Path
) -> None:
    for name, data in golden["folders_hex"][str(coder.value)].items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(bytes.fromhex(data))
        if name.startswith("segments"):
            assert HEAD.unpack_from(bytes.fromhex(data))[3:5] == (2, coder)
    wanted = golden["held_sha256"]
    assert verify_stream(tmp_path).num_frames == len(wanted)
    reader, folder = StreamReader(tmp_path), StreamFolder(tmp_path)
    assert folder.num_frames == len(wanted)
    layers = range(reader.manifest.num_layers)
    for frame, sha256 in enumerate(wanted):
        assert held_sha256(held(reader.decoder_at(frame, len(layers)))) == sha256
        plain, segment = Reader(folder.shape), frame // folder.shape.segment_frames
        folder.load(plain, segment, layers)
        folder.apply(plain, range(segment * folder.shape.segment_frames + 1, frame + 1), layers)
        assert held_sha256(plainly_held(plain, frame, len(layers))) == sha256
