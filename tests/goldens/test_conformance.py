"""The conformance suite: the package and the plain reader, which was written from FORMAT.md alone,
pass it; the writer still encodes the chunks of its streams."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from codec.errors import CodecError, CorruptError, UnsupportedError
from codec.stream import StreamReader
from codec.stream.integrity import CheckedObject, read_index
from codec.stream.manifest import Manifest
from codec.stream.playrecord import RecordParser
from codec.stream.segment import OBJECT_HEAD, packet_content
from codec.tools.audit import verify_stream
from tests.goldens.cases import CASES, Case, made_updates
from tests.goldens.decoder import Unsupported
from tests.goldens.folder import StreamFolder, read_manifest
from tests.goldens.folder import read_index as read_index_plainly
from tests.goldens.objects import decode_object, inflate
from tests.goldens.statehash import state_sha256
from tests.goldens.suite import FOLDER, read_order, read_table, stream_name, write_suite
from tests.support.slots.arrivals import played
from tests.support.slots.plain import encoded_chunks, held

STREAMS, ORDERS, HOSTILE = map(read_table, ("streams.json", "orders.json", "hostile.json"))


def names(rows: list[dict[str, Any]]) -> list[str]:
    return [f"{n}-{row.get('name', row.get('stream'))}" for n, row in enumerate(rows)]


def test_the_tables_are_as_regenerate_writes_them(tmp_path: Path) -> None:
    """Only tables that follow from the streams, because a later coder may code better."""
    write_suite(tmp_path)
    for name in ("streams.json", "orders.json"):
        assert (tmp_path / name).read_bytes() == (FOLDER / name).read_bytes()
    assert sum(path.stat().st_size for path in FOLDER.rglob("*")) < 1_000_000


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_the_writer_makes_the_chunks_of_the_streams(case: Case) -> None:
    made = encoded_chunks(case.layout, made_updates(case))
    stream = StreamFolder(FOLDER / stream_name(case))
    for segment, record in enumerate(stream.index):
        births = range(record.first_frame, record.first_frame + record.num_frames)
        assert stream.chunks(segment, "skipmaps") == {b: made.skip_maps[b] for b in births}
        for layer in range(len(case.slots)):
            changes = {b: made.changes[b][layer] for b in births}
            assert stream.chunks(segment, f"{layer}") == changes
            keyframe = {births[0]: made.keyframes[births[0]][layer]}
            assert stream.chunks(segment, f"keyframe-{layer}") == keyframe


@pytest.mark.parametrize("row", STREAMS, ids=names(STREAMS))
def test_a_stream(row: dict[str, Any]) -> None:
    path, wanted = FOLDER / row["stream"], row["state_sha256"]
    assert all(
        OBJECT_HEAD.unpack_from(p.read_bytes())[3:5] == (1, 2) for p in path.glob("segments/*/*")
    )
    assert verify_stream(path).num_frames == len(wanted)
    reader = StreamReader(path)
    for frame, hashes in enumerate(wanted):
        numbers = range(1, reader.manifest.num_layers + 1)
        for n, sha256 in zip(numbers, hashes, strict=True):
            assert sha256 == state_sha256(held(reader.decoder_at(frame, n)))


@pytest.mark.parametrize("row", ORDERS, ids=names(ORDERS))
def test_an_order_of_arrival(row: dict[str, Any]) -> None:
    arrivals, wanted = read_order(row)
    is_altered = any(len(event) == 4 for event in row["events"])
    try:
        found = [state_sha256(one) for one in played(arrivals)]
    except CodecError:
        assert is_altered
    else:
        assert found == wanted


@pytest.mark.parametrize("row", HOSTILE, ids=names(HOSTILE))
def test_a_hostile_file(row: dict[str, Any]) -> None:
    assert verdict_of_package(row) == verdict_of_plain_reader(row) == row["verdict"]


def verdict_of_package(row: dict[str, Any]) -> str:
    data = bytes.fromhex(row["hex"])
    try:
        match row["what"]:
            case "manifest":
                Manifest.from_json(data)
            case "index":
                manifest = Manifest.from_json(
                    (FOLDER / row["stream"] / "manifest.json").read_bytes()
                )
                records = read_index(data, manifest)
                assert len(records) == row.get("num_segments", len(records))
            case "object":
                check_object(data)
            case "packet":
                packet_content(data, row["limit_bytes"])
            case "record":
                assert len(RecordParser().feed(data)) == 1
    except UnsupportedError:
        return "unsupported"
    except CorruptError:
        return "corrupt"
    return "taken"


def check_object(data: bytes) -> None:
    """Reads `data` as layer 0 of segment 1 of the first stream, with its size in the index."""
    reader = StreamReader(FOLDER / STREAMS[0]["stream"])
    record = reader.records[1]
    sizes = (len(data), *record.object_bytes[1:])
    hashes = (hashlib.sha256(data).digest(), *record.object_sha256[1:])
    named = replace(record, object_bytes=sizes, object_sha256=hashes)
    found = CheckedObject.check("", data, reader.manifest, named, 0)
    for entry in found.entries:
        found.content(entry.birth)


def verdict_of_plain_reader(row: dict[str, Any]) -> str:
    data = bytes.fromhex(row["hex"])
    try:
        match row["what"]:
            case "object":
                decode_object(data)
            case "packet":
                inflate(data, row["limit_bytes"])
            case "manifest":
                # The plain reader reads only the fields that decoding needs.
                if read_manifest(data) == StreamFolder(FOLDER / STREAMS[0]["stream"]).shape:
                    return str(row["verdict"])
            case "index":
                shape = read_manifest((FOLDER / row["stream"] / "manifest.json").read_bytes())
                read_index_plainly(data, shape)
            case _:  # it reads no play records
                return str(row["verdict"])
    except Unsupported:
        return "unsupported"
    except (AssertionError, ValueError, RecursionError):
        return "corrupt"
    return "taken"
