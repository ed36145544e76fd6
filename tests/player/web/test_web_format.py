"""What else of a stream the browser reads: chunks of version 1, objects, packets, manifest, index,
play records. It takes and refuses what the package does."""

from __future__ import annotations

import json
import random
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from codec.coders.coder import decompress
from codec.errors import CodecError
from codec.profiles.quantise import opacity_logits
from codec.stream.chunk import Chunk, decode_chunk
from codec.stream.index import SegmentRecord
from codec.stream.integrity import read_index
from codec.stream.manifest import Manifest
from codec.stream.object import object_packets
from codec.stream.playrecord import (
    EndRecord,
    ErrorRecord,
    Record,
    RecordParser,
    SliceRecord,
    SnapshotRecord,
    StartRecord,
    encode_record,
)
from codec.stream.poster import poster_path
from fuzz.codec import TARGETS
from fuzz.seed import CORPUS, made_manifest
from tests.goldens.pinned_slots import FILE as SLOTS_FILE
from tests.support.web.browsercode import BrowserCode

GOLDENS = Path(__file__).parents[2] / "goldens"
CHUNKS = json.loads((GOLDENS / "chunks.json").read_text())
OBJECTS = json.loads((GOLDENS / "objects.json").read_text())
FOLDERS = [row["folders_hex"] for row in json.loads(SLOTS_FILE.read_text()) if row["folders_hex"]]
TARGET_NAMES = list(TARGETS)
LIMIT = 1 << 20


def chunk_by_browser(browser: BrowserCode, data: bytes) -> object:
    found = browser.ask("chunk", bytes=data.hex())
    arrays = tuple(bytes.fromhex(array) for array in found["arrays"])
    return found["birth"], found["layer"], found["profile"], arrays, found["startOffsets"]


def chunk_by_package(chunk: Chunk) -> object:
    arrays = tuple(array.tobytes() for array in chunk.slice.splats.arrays)
    offsets = chunk.slice.start_offsets.tobytes().hex()
    return chunk.birth, chunk.layer, chunk.profile.value, arrays, offsets


@pytest.mark.parametrize("golden", CHUNKS, ids=lambda golden: golden["name"])
def test_a_chunk_of_version_1(browser: BrowserCode, golden: dict[str, str]) -> None:
    data = bytes.fromhex(golden["chunk_hex"])
    assert chunk_by_browser(browser, data) == chunk_by_package(decode_chunk(data))


def test_opacities_are_the_same_bits(browser: BrowserCode) -> None:
    for levels in range(2, 257):
        assert browser.ask("logits", levels=levels) == opacity_logits(levels).tobytes().hex()


def test_an_object_of_version_1(browser: BrowserCode) -> None:
    for golden in OBJECTS:
        data = bytes.fromhex(str(golden["object_hex"]))
        packets = [[birth, bytes(packet).hex()] for birth, packet in object_packets(data)]
        found = browser.ask("object", bytes=data.hex(), version=1)
        assert found == {"coder": golden["coder"], "packets": packets}


def test_the_folder_of_a_golden(browser: BrowserCode) -> None:
    """Manifest, index, objects; what gzip packets hold."""
    for folders in FOLDERS:
        for coder, files in folders.items():
            manifest = Manifest.from_json(bytes.fromhex(files["manifest.json"]))
            assert_same_manifest(browser.ask("manifest", bytes=files["manifest.json"]), manifest)
            found = browser.ask("index", manifest=files["manifest.json"], bytes=files["index.bin"])
            records = read_index(bytes.fromhex(files["index.bin"]), manifest)
            assert found == [record_as_json(record) for record in records]
            for name in files:
                if name.startswith("segments/"):
                    assert_same_object(browser, bytes.fromhex(files[name]), int(coder))


def assert_same_object(browser: BrowserCode, data: bytes, coder: int) -> None:
    packets = [(birth, bytes(packet)) for birth, packet in object_packets(data, 2)]
    found = browser.ask("object", bytes=data.hex(), version=2)
    assert found == {"coder": coder, "packets": [[birth, data.hex()] for birth, data in packets]}
    if coder == 2:
        for _, packet in packets:
            content = decompress(packet, LIMIT).hex()
            assert browser.ask("packet", bytes=packet.hex(), limit=LIMIT) == content


def assert_same_manifest(found: dict[str, object], manifest: Manifest) -> None:
    camera = manifest.camera()
    assert found["parts"] == list(map(str, manifest.parts))
    same = {
        "version": manifest.version,
        "fps": manifest.fps,
        "swinSize": manifest.swin_size,
        "numGs": manifest.num_gs,
        "numLayers": manifest.num_layers,
        "segmentFrames": manifest.segment_frames,
        "shDegree": manifest.sh_degree,
        "profile": manifest.profile.value,
        "antialias": manifest.antialias,
        "nearM": manifest.near_m,
        "bounds": [list(corner) for corner in manifest.bounds],
        "live": manifest.live,
        "poster": poster_path(manifest),
        "objectUrl": manifest.object_url,
        "title": manifest.title,
        "captureFrame": manifest.capture_frame,
    }
    assert {key: found[key] for key in same} == same
    default = found["defaultCamera"]
    assert isinstance(default, dict)
    assert (default["name"], default["fxPx"]) == (camera.name, camera.fx_px)
    assert default["w2c"] == camera.w2c.ravel().tolist()


def record_as_json(record: SegmentRecord) -> dict[str, object]:
    return {
        "segment": record.segment,
        "firstFrame": record.first_frame,
        "numFrames": record.num_frames,
        "psnrDb": np.array(record.psnr_db, np.float32).tobytes().hex(),
        "objectBytes": list(record.part_bytes),
        "objectSha256": [sha256.hex() for sha256 in record.part_sha256],
    }


RECORDS: list[Record] = [
    StartRecord(7, 150, made_manifest().to_json()),
    SliceRecord(-3, (b"one", b"two")),
    SliceRecord(70_000, (b"", b"x" * 300), b"mask"),
    SliceRecord(5, (), b""),
    SliceRecord(5, (b"y" * 70_000,), None, 3),
    SnapshotRecord(128, 1, (b"s",)),
    EndRecord(1 << 30),
    ErrorRecord("käputt " + "x" * 600),
]


def record_in_browser(record: Record) -> dict[str, object]:
    match record:
        case StartRecord(from_frame, num_frames, manifest):
            return {
                "kind": "start",
                "fromFrame": from_frame,
                "numFrames": num_frames,
                "manifest": manifest.hex(),
            }
        case SliceRecord(birth, packets, mask, first_layer):
            return {
                "kind": "slice",
                "birth": birth,
                "firstLayer": first_layer,
                "packets": [packet.hex() for packet in packets],
                "mask": None if mask is None else mask.hex(),
            }
        case SnapshotRecord(frame, first_layer, packets):
            packets_hex = [packet.hex() for packet in packets]
            return {
                "kind": "snapshot",
                "frame": frame,
                "firstLayer": first_layer,
                "packets": packets_hex,
            }
        case EndRecord(num_frames):
            return {"kind": "end", "numFrames": num_frames}
        case ErrorRecord(message):
            return {"kind": "error", "message": message[:500]}


@pytest.mark.parametrize("piece_bytes", [1 << 20, 1000, 7, 1])
def test_play_records_in_pieces(browser: BrowserCode, piece_bytes: int) -> None:
    records = RECORDS if piece_bytes > 1 else RECORDS[1:2] + RECORDS[-3:]
    data = b"".join(map(encode_record, records))
    pieces = [data[at : at + piece_bytes].hex() for at in range(0, len(data), piece_bytes)]
    assert browser.ask("records", pieces=pieces) == list(map(record_in_browser, records))


def test_lists_in_lists_do_not_exhaust_the_stack(browser: BrowserCode) -> None:
    body = b"\x81\xa6frames" + b"\x91" * 1_000_000
    assert not browser.takes("records", pieces=[(struct.pack("<I", len(body)) + body).hex()])


@pytest.mark.parametrize("fps", [0.001, 1000.0])
def test_frame_rates_within_the_bounds(browser: BrowserCode, fps: float) -> None:
    data = replace(made_manifest(), fps=fps).to_json()
    assert browser.ask("manifest", bytes=data.hex())["fps"] == Manifest.from_json(data).fps == fps


@pytest.mark.parametrize("fps", [1e-320, 0.000999, 0, -1, 1000.5, 1e400])
def test_frame_rates_out_of_the_bounds(browser: BrowserCode, fps: float) -> None:
    value = json.loads(made_manifest().to_json())
    data = json.dumps(value | {"fps": fps}).replace("Infinity", "1e400").encode()
    with pytest.raises(CodecError, match="fps"):
        Manifest.from_json(data)
    with pytest.raises(CodecError, match="fps"):
        browser.ask("manifest", bytes=data.hex())


@pytest.mark.parametrize(
    ("poster", "taken"),
    [
        ("poster.jpg", True),
        ("art/still #1.PNG", True),
        ("//evil.example/x.jpg", False),
        ("/x.jpg", False),
        ("a//x.jpg", False),
        ("../x.jpg", False),
        ("a/../x.jpg", False),
        ("x.svg", False),
        (".jpg", False),
        ("art/.jpg", False),
        ("", False),
    ],
)
def test_a_poster_lies_in_the_stream_s_folder(
    browser: BrowserCode, poster: str, taken: bool
) -> None:
    manifest = replace(made_manifest(), poster=poster)
    expected = poster if taken else None
    assert poster_path(manifest) == expected
    assert browser.ask("manifest", bytes=manifest.to_json().hex())["poster"] == expected


def record_is_taken(data: bytes) -> object:
    return RecordParser().feed(data)


CHECKED: dict[str, tuple[Callable[[bytes], object], Callable[[BrowserCode, bytes], object]]] = {
    "chunk": (
        lambda data: chunk_by_package(decode_chunk(data)),
        chunk_by_browser,
    ),
    "manifest": (
        Manifest.from_json,
        lambda browser, data: browser.ask("manifest", bytes=data.hex()),
    ),
    "record": (
        lambda data: list(map(record_in_browser, RecordParser().feed(data))),
        lambda browser, data: browser.ask("records", pieces=[data.hex()]),
    ),
    "object": (
        lambda data: [[birth, bytes(packet).hex()] for birth, packet in object_packets(data)],
        lambda browser, data: browser.ask("object", bytes=data.hex(), version=1)["packets"],
    ),
    "slot_object": (
        lambda data: [[birth, bytes(packet).hex()] for birth, packet in object_packets(data, 2)],
        lambda browser, data: browser.ask("object", bytes=data.hex(), version=2)["packets"],
    ),
}
"""By the name of a parser of the fuzzer what the package makes of its bytes, and the browser."""

NEAR_THE_CORPUS = [
    path
    for path in sorted(CORPUS.iterdir())
    if TARGET_NAMES[path.read_bytes()[0] % len(TARGETS)] in CHECKED
]


@pytest.mark.parametrize("path", NEAR_THE_CORPUS, ids=lambda path: path.name)
def test_what_is_near_the_corpus_of_the_fuzzer(browser: BrowserCode, path: Path) -> None:
    """Both give the same value, or both refuse. Only of numbers such as 3.0 may the browser take
    what the package refuses: it cannot tell them from integers."""
    target = TARGET_NAMES[path.read_bytes()[0] % len(TARGETS)]
    by_package, by_browser = CHECKED[target]
    data, rng = path.read_bytes()[1:], random.Random(path.name)
    for mutated in [data, *(mutate(data, rng) for _ in range(60))]:
        try:
            expected = by_package(mutated)
        except CodecError:
            if target == "manifest" and b".0" in mutated:
                continue
            with pytest.raises(CodecError):
                by_browser(browser, mutated)
        else:
            found = by_browser(browser, mutated)
            if target != "manifest":
                assert found == expected


def mutate(data: bytes, rng: random.Random) -> bytes:
    altered = bytearray(data)
    for _ in range(rng.randint(1, 3)):
        place = rng.randrange(len(altered) + 1)
        match rng.randrange(4):
            case 0 if place < len(altered):
                altered[place] ^= 1 << rng.randrange(8)
            case 1 if place < len(altered):
                altered[place] = rng.choice((0, 1, 0x7F, 0x80, 0xFF))
            case 2:
                del altered[place : place + rng.randint(1, 8)]
            case _:
                altered[place:place] = rng.randbytes(rng.randint(1, 8))
    return bytes(altered)
