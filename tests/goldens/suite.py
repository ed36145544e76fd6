"""The conformance suite in conformance/: writes it, and reads its tables.

The expected state is that of the plain reader, which was written from FORMAT.md alone.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from codec.stream import StreamWriter
from tests.goldens.cases import CASES, Case, made_updates
from tests.goldens.folder import StreamFolder
from tests.goldens.hostile import hostile_rows
from tests.goldens.statehash import state_sha256
from tests.support.commands import ROOT
from tests.support.slots.arrivals import (
    Arrivals,
    Change,
    Event,
    Keyframe,
    Look,
    Show,
    SkipMap,
    arrivals_of,
)
from tests.support.slots.folder import slots_manifest
from tests.support.slots.plain import Chunks, encoded_chunks, plainly_held

FOLDER = ROOT / "conformance"
ALTERED_SHARES = (0.0,) * 8 + (0.3,) * 3
"""Shares of altered chunks, among those that no frame needs, in the orders of each stream."""


def write_suite(folder: Path) -> None:
    """Writes streams and tables into `folder`, and replaces old ones."""
    shutil.rmtree(folder / "streams", ignore_errors=True)
    for case in CASES:
        _write_stream(folder / "streams", case)
    _write_table(folder / "streams.json", [_stream_row(folder, case) for case in CASES])
    orders = [row for seed, case in enumerate(CASES) for row in _order_rows(folder, case, seed)]
    _write_table(folder / "orders.json", orders)
    _write_table(folder / "hostile.json", hostile_rows(folder / stream_name(CASES[0])))


def read_table(name: str) -> list[dict[str, Any]]:
    """The rows of a table of the suite."""
    rows: list[dict[str, Any]] = json.loads((FOLDER / name).read_text(encoding="utf-8"))
    return rows


def stream_name(case: Case) -> str:
    return f"streams/{case.name}"


def _write_table(path: Path, rows: list[dict[str, Any]]) -> None:
    lines = ",\n".join(json.dumps(row) for row in rows)
    path.write_text(f"[\n{lines}\n]\n", encoding="utf-8")


def _write_stream(folder: Path, case: Case) -> None:
    with StreamWriter.create(folder / case.name, slots_manifest(case.layout)) as writer:
        for update in made_updates(case):
            writer.append(update)


def _stream_row(folder: Path, case: Case) -> dict[str, Any]:
    name = stream_name(case)
    stream, numbers = StreamFolder(folder / name), range(1, len(case.slots) + 1)
    states = [[_state(stream, frame, n) for n in numbers] for frame in range(stream.num_frames)]
    return {"stream": name, "state_sha256": states}


def _state(stream: StreamFolder, frame: int, num_layers: int) -> str:
    """The hash of a reader that joins at `frame` with layers 0..num_layers-1."""
    return state_sha256(plainly_held(stream.reader_at(frame, num_layers), frame, num_layers))


def _order_rows(folder: Path, case: Case, number: int) -> list[dict[str, Any]]:
    name = stream_name(case)
    stream, chunks = StreamFolder(folder / name), encoded_chunks(case.layout, made_updates(case))
    rows = []
    for seed, share in enumerate(ALTERED_SHARES, 100 * number):
        made = arrivals_of(stream.shape, chunks, seed, share)
        hashes = iter(map(state_sha256, made.expected()))
        events = [_event_row(event, chunks, hashes) for event in made.events]
        rows.append({"stream": name, "join": made.join_frame, "events": events})
    return rows


def _event_row(event: Event, chunks: Chunks, hashes: Iterator[str]) -> list[object]:
    match event:
        case SkipMap(birth):
            return ["skip_map", birth]
        case Change(birth, layer, chunk):
            is_altered = chunk != chunks.changes[birth][layer]
            return ["change", birth, layer, *([chunk.hex()] if is_altered else [])]
        case Keyframe(frame, layer, chunk):
            is_altered = chunk != chunks.keyframes[frame][layer]
            return ["keyframe", frame, layer, *([chunk.hex()] if is_altered else [])]
        case Show(frame):
            return ["show", frame]
        case Look():
            return ["compare", next(hashes)]


def read_order(row: dict[str, Any]) -> tuple[Arrivals, list[str]]:
    """The arrivals of a row of orders.json, and the hash at each Look."""
    stream, hashes = StreamFolder(FOLDER / row["stream"]), []
    chunks: dict[tuple[str, int], bytes] = {}
    for record in range(len(stream.index)):
        for name in stream.index[record].files:
            for birth, chunk in stream.chunks(record, name).items():
                chunks[name, birth] = chunk
    events: list[Event] = []
    for kind, *rest in row["events"]:
        match kind, rest:
            case "skip_map", [birth]:
                events.append(SkipMap(birth, chunks["skipmaps", birth]))
            case "change", [birth, layer, *other]:
                chunk = bytes.fromhex(other[0]) if other else chunks[f"{layer}", birth]
                events.append(Change(birth, layer, chunk))
            case "keyframe", [frame, layer, *other]:
                chunk = bytes.fromhex(other[0]) if other else chunks[f"keyframe-{layer}", frame]
                events.append(Keyframe(frame, layer, chunk))
            case "show", [frame]:
                events.append(Show(frame))
            case "compare", [sha256]:
                events.append(Look())
                hashes.append(sha256)
            case _:
                raise ValueError(f"orders.json: no such event: {kind}")
    return Arrivals(stream.shape, row["join"], events), hashes
