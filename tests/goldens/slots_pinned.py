"""The goldens of version 2: one table of small streams, for the test and for the script that writes
them anew.

A stream is made of integers and of floats that float32 holds, so every platform makes the same.
"""

from __future__ import annotations

import hashlib
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from codec.coders.coder import Coder
from codec.slots.lattice import Lattice, States
from codec.slots.slotdecoder import SlotDecoder
from codec.slots.slotencoder import SlotEncoder
from codec.slots.slotlayout import SlotLayout
from codec.slots.slotstate import ON_LATTICE
from codec.slots.update import ENDED, KEPT, NEW, PREDICTED, Update
from codec.splats import Splats, array_shapes
from codec.stream import StreamWriter
from codec.tools.static import export_static
from tests.support.slots.folder import slots_manifest
from tests.support.slots.plain import Chunks, Held, encoded_chunks, held

FILE = Path(__file__).parent / "slots.json"

LATTICES = (
    Lattice(0.001, 0.05, 1 / 127, 0.02, 256, -3.0),
    Lattice(0.01, 0.125, 1 / 60, 0.056, 41),
    Lattice(1e-6, 1e6, 1.0, 1.0, 2, 1e3),
)


@dataclass(frozen=True, slots=True)
class SlotCase:
    """One stream to pin."""

    name: str
    num_frames: int
    swin_size: int
    slots: tuple[int, ...]
    segment_frames: int
    sh_degree: int = 0
    far: bool = False
    """Whether positions go over all of the lattice, so that residuals are long."""
    late: bool = False
    """Whether some of the new start late."""
    escapes: bool = False
    still: bool = False
    """Whether nothing changes after frame 0."""
    folder: bool = False
    """Whether its files are pinned, of each coder."""

    @property
    def layout(self) -> SlotLayout:
        lattices = LATTICES[: len(self.slots)]
        return SlotLayout(self.swin_size, self.slots, self.sh_degree, lattices, self.segment_frames)


SLOT_CASES = (
    SlotCase("leases", 9, 2, (6, 4), 4, folder=True),
    SlotCase("one-lane", 5, 1, (7,), 3, sh_degree=1),
    SlotCase("still", 4, 2, (5,), 3, still=True),
    SlotCase("far", 6, 2, (5, 3, 2), 8, far=True),
    SlotCase("late-and-escaped", 7, 3, (6, 2), 4, late=True, escapes=True, folder=True),
)

STATUSES = KEPT, PREDICTED, NEW, KEPT, PREDICTED, ENDED, KEPT


def made_updates(case: SlotCase) -> list[Update]:
    """What the stream of `case` is made of."""
    layout, encoder = case.layout, SlotEncoder(case.layout)
    updates = []
    for birth in range(1 - case.swin_size, case.num_frames):
        lane = encoder.lanes[layout.lane(birth)]
        conditions = np.concatenate([slots.conditions for slots in lane])
        rows = np.arange(layout.num_slots)
        statuses = np.array(STATUSES, np.uint8)[(3 * rows + 5 * birth) % 7]
        if birth <= 0:
            statuses = np.where(rows % 5 == 3, KEPT, NEW).astype(np.uint8)
        elif case.still:
            statuses[:] = KEPT
        lost = (statuses == PREDICTED) & (conditions != ON_LATTICE)
        statuses[lost] = NEW
        updates.append(_update(case, birth, statuses))
        encoder.append(updates[-1])
    return updates


def _update(
    case: SlotCase, birth: int, statuses: np.ndarray[tuple[int], np.dtype[np.uint8]]
) -> Update:
    layout = case.layout
    coded = np.flatnonzero(statuses >= PREDICTED)
    is_new = statuses[coded] == NEW
    at = coded + 100 * (birth + case.swin_size)
    levels = np.repeat([lattice.opacity_levels for lattice in layout.lattices], layout.slots)
    spread = 40_000 if case.far else 1
    axes = (at[:, None] * np.array([37, 53, 71]) % 401 - 200) * spread
    columns = np.arange(layout.num_planes - 3)
    attributes = (at[:, None] * 29 + columns * 83) % 256
    attributes[:, -1] %= levels[coded]
    escaped = is_new & (at % 3 == 1) & case.escapes
    count = int(escaped.sum())
    floats = [
        (np.arange(np.prod(shape)).reshape(shape) % 97 - 40.25).astype(np.float32)
        for shape in array_shapes(count, case.sh_degree)
    ]
    offsets = at % case.swin_size * is_new * case.late
    return Update(
        birth,
        statuses,
        States(axes.astype(np.int32), attributes.astype(np.uint8)),
        offsets.astype(np.uint8),
        escaped,
        Splats(*floats),
    )


def made_chunks(case: SlotCase) -> Chunks:
    return encoded_chunks(case.layout, made_updates(case))


def chunk_table(chunks: Chunks) -> dict[str, list[str]]:
    """The chunks in hexadecimal, by the name of their part of a segment."""
    table = {"masks": [data.hex() for data in chunks.masks]}
    for layer in range(len(chunks.changes[0])):
        table[str(layer)] = [changes[layer].hex() for changes in chunks.changes]
        table[f"snapshot-{layer}"] = [row[layer].hex() for row in chunks.snapshots.values()]
    return table


def held_sha256(found: Held) -> str:
    """One hash over all that a reader holds: of each slot a word, or its start, its integers and
    the bits of its floats."""
    return hashlib.sha256(repr(found).encode()).hexdigest()


def played(case: SlotCase, chunks: Chunks) -> list[str]:
    """What one holds at each frame who plays from frame 0."""
    decoder = SlotDecoder(case.layout)
    for snapshot in chunks.snapshots[0]:
        decoder.load(snapshot)
    found = [held_sha256(held(decoder))]
    for birth in range(1, case.num_frames):
        decoder.apply(birth, chunks.masks[birth], chunks.changes[birth])
        found.append(held_sha256(held(decoder)))
    return found


def folder_files(stream: Path) -> dict[str, str]:
    """The files of a folder, by name, in hexadecimal."""
    paths = sorted(path for path in stream.rglob("*") if path.is_file())
    return {path.relative_to(stream).as_posix(): path.read_bytes().hex() for path in paths}


def folder_record(case: SlotCase) -> dict[str, dict[str, str]]:
    """The files of the stream of `case`, by the number of the coder."""
    with tempfile.TemporaryDirectory() as temporary:
        path = Path(temporary)
        with StreamWriter.create(path / "zstd", slots_manifest(case.layout)) as writer:
            for update in made_updates(case):
                writer.append(update)
        export_static(path / "zstd", path / "gzip")
        return {
            str(Coder.ZSTD.value): folder_files(path / "zstd"),
            str(Coder.GZIP.value): folder_files(path / "gzip"),
        }


def slot_record(case: SlotCase) -> dict[str, object]:
    """What is pinned of `case`: its chunks, what one holds who plays them, and files to be read for
    ever; an entropy coder may find better."""
    chunks = made_chunks(case)
    return {
        "name": case.name,
        "chunks_hex": chunk_table(chunks),
        "held_sha256": played(case, chunks),
        "folders_hex": folder_record(case) if case.folder else {},
    }
