"""Other parts of a stream that the browser reads: objects, packets, manifest, index, play records,
captions. It accepts and refuses the same bytes as the package."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable
from dataclasses import fields, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard

from codec.errors import CodecError, CorruptError, InvalidError, UnsupportedError
from codec.lattice.forms import opacity_logits
from codec.stream.captions import captions_of, check_captions, parse_webvtt
from codec.stream.integrity import read_index
from codec.stream.manifest import Manifest
from codec.stream.pictures import picture_path
from codec.stream.playrecord import (
    EndRecord,
    ErrorRecord,
    KeyframeRecord,
    Record,
    RecordParser,
    SliceRecord,
    StartRecord,
    encode_record,
)
from codec.stream.poster import StoryboardLayout
from codec.stream.segment import SegmentRecord, packet_content
from fuzz.codec import TARGETS
from fuzz.seed import CORPUS
from tests.goldens.suite import FOLDER, read_table
from tests.support.objects import object_packets
from tests.support.slots.slot_streams import slot_manifest
from tests.support.slots.updates import small_layout
from tests.support.web.browsercode import BrowserCode, fields_in_browser

STREAMS = [FOLDER / row["stream"] for row in read_table("streams.json")]
ZSTD_MAGIC = "28b52ffd"
HOSTILE = [  # a browser requests no zstd packets
    row
    for row in read_table("hostile.json")
    if row["what"] != "packet" or not row["hex"].startswith(ZSTD_MAGIC)
]
TARGET_NAMES = list(TARGETS)
LIMIT = 1 << 20
MANIFEST = slot_manifest(small_layout())


def test_opacities_are_the_same_bits(browser: BrowserCode) -> None:
    for levels in range(2, 257):
        assert browser.ask("logits", levels=levels) == opacity_logits(levels).tobytes().hex()


@pytest.mark.parametrize("stream", STREAMS, ids=lambda stream: stream.name)
def test_the_files_of_the_conformance_suite(browser: BrowserCode, stream: Path) -> None:
    """Manifest, index, objects, and the contents of packets."""
    data, index = ((stream / name).read_bytes() for name in ("manifest.json", "index.bin"))
    manifest = Manifest.from_json(data)
    assert_same_manifest(browser.ask("manifest", bytes=data.hex()), manifest)
    found = browser.ask("index", manifest=data.hex(), bytes=index.hex())
    assert found == [record_as_json(record) for record in read_index(index, manifest)]
    for path in stream.glob("segments/*/*"):
        assert_same_object(browser, path.read_bytes())


@pytest.mark.parametrize("row", HOSTILE, ids=lambda row: f"{row['what']}-{row['name']}")
def test_a_hostile_file_of_the_conformance_suite(browser: BrowserCode, row: dict[str, Any]) -> None:
    data, stream = row["hex"], FOLDER / row.get("stream", "")
    match row["what"]:
        case "index":
            manifest = (stream / "manifest.json").read_bytes().hex()
            ask = partial(browser.ask, "index", manifest=manifest, bytes=data)
        case "packet":
            ask = partial(browser.ask, "packet", bytes=data, limit=row["limit_bytes"])
        case "record":
            ask = partial(browser.ask, "records", pieces=[data])
        case what:
            ask = partial(browser.ask, what, bytes=data)
    try:
        ask()
        verdict = "taken"
    except UnsupportedError:
        verdict = "unsupported"
    except CorruptError:
        verdict = "corrupt"
    assert verdict == row["verdict"] or (verdict == "taken" and "lenient" in row)


def assert_same_object(browser: BrowserCode, data: bytes) -> None:
    packets = [(birth, bytes(packet)) for birth, packet in object_packets(data)]
    found = browser.ask("object", bytes=data.hex())
    assert found == [[birth, data.hex()] for birth, data in packets]
    for _, packet in packets:
        content = packet_content(packet, LIMIT).hex()
        assert browser.ask("packet", bytes=packet.hex(), limit=LIMIT) == content


def made_content(rng: random.Random, size: int) -> bytes:
    """Bytes of one of the kinds that zstd codes in different ways."""
    word = rng.randbytes(rng.randrange(3, 40))
    match rng.randrange(6):
        case 0:
            return rng.randbytes(size)
        case 1:
            return word[:1] * size
        case 2:
            return bytes(rng.choices(range(4), k=size))
        case 3:
            return bytes(int(rng.gauss(128, 12)) & 255 for _ in range(size))
        case 4:
            words = [word, *(rng.randbytes(rng.randrange(3, 40)) for _ in range(30))]
            return b"".join(rng.choices(words, k=size // 3 + 1))[:size]
        case _:
            return (rng.randbytes(size // 3) + word * (size // 60)) * 2 or word


@pytest.mark.parametrize("seed", range(60))
def test_frames_of_zstd_of_all_kinds(browser: BrowserCode, seed: int) -> None:
    """Of any level, window and division into blocks; none is taken with less content."""
    rng = random.Random(seed)
    content = made_content(rng, rng.choice((1, 31, 32, 255, 256, 5000, 70_000, 300_000)))
    parameters = zstandard.ZstdCompressionParameters.from_level(
        rng.choice((-5, 1, 3, 9, 19)),
        source_size=len(content),
        min_match=rng.randrange(3, 8),
        window_log=rng.choice((10, 12, 17, 20)),
        write_checksum=True,
    )
    stream = zstandard.ZstdCompressor(compression_params=parameters).compressobj(len(content))
    cuts = sorted({0, len(content), *(rng.randrange(len(content)) for _ in range(seed % 4))})
    parts = [
        stream.compress(content[a:b]) + stream.flush(zstandard.COMPRESSOBJ_FLUSH_BLOCK)
        for a, b in pairwise(cuts)
    ]
    packet = (b"".join(parts) + stream.flush()).hex()
    assert browser.ask("packet", bytes=packet, limit=1 << 20) == content.hex()
    with pytest.raises(CorruptError):
        browser.ask("packet", bytes=packet, limit=len(content) - 1)


def assert_same_manifest(found: dict[str, Any], manifest: Manifest) -> None:
    names = "fps swin_size num_gs num_layers segment_frames sh_degree antialias near_m bounds live"
    names += " camera_near_m object_url title capture_frame"
    same = fields_in_browser(manifest, names.split())
    same["poster"], same["storyboard"] = map(picture_path, (manifest.poster, manifest.storyboard))
    assert {key: found[key] for key in same} == same
    assert found["parts"] == list(map(str, manifest.parts))
    camera, default = manifest.camera(), found["defaultCamera"]
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
    StartRecord(7, 150, MANIFEST.to_json()),
    SliceRecord(-3, (b"one", b"two"), b"statuses"),
    SliceRecord(70_000, (b"", b"x" * 300), b"skip_map"),
    SliceRecord(5, (), b""),
    SliceRecord(5, (b"y" * 70_000,), None, 3),
    KeyframeRecord(128, 1, (b"s",)),
    EndRecord(1 << 30),
    ErrorRecord("käputt " + "x" * 600),
]


def record_in_browser(record: Record) -> dict[str, object]:
    kind = type(record).__name__.removesuffix("Record").lower()
    return {"kind": kind, **fields_in_browser(record, [field.name for field in fields(record)])}


@pytest.mark.parametrize("piece_bytes", [1 << 20, 1000, 7, 1])
def test_play_records_in_pieces(browser: BrowserCode, piece_bytes: int) -> None:
    records = RECORDS if piece_bytes > 1 else RECORDS[1:2] + RECORDS[-3:]
    data = b"".join(map(encode_record, records))
    pieces = [data[at : at + piece_bytes].hex() for at in range(0, len(data), piece_bytes)]
    assert browser.ask("records", pieces=pieces) == list(map(record_in_browser, records))


def test_lists_in_lists_do_not_exhaust_the_stack(browser: BrowserCode) -> None:
    body = b"\x81\xa7packets" + b"\x91" * 1_000_000
    assert not browser.takes("records", pieces=[(struct.pack("<I", len(body)) + body).hex()])


INSIDE = ["poster.jpg", "art/still #1.PNG"]
OUTSIDE = ["//evil.example/x.jpg", "/x.jpg", "a//x.jpg", "../x.jpg", "a/../x.jpg"]
NAMELESS = ["x.svg", ".jpg", "art/.jpg", ""]


@pytest.mark.parametrize("poster", [*INSIDE, *OUTSIDE, *NAMELESS])
def test_a_poster_lies_in_the_stream_s_folder(browser: BrowserCode, poster: str) -> None:
    manifest = replace(MANIFEST, poster=poster, storyboard=poster)
    expected = poster if poster in INSIDE else None
    assert picture_path(manifest.poster) == expected
    found = browser.ask("manifest", bytes=manifest.to_json().hex())
    assert (found["poster"], found["storyboard"]) == (expected, expected)


def test_storyboards_are_laid_out_alike(browser: BrowserCode) -> None:
    streams = [(n, fps) for n in (1, 7, 60, 61, 3599, 10**7) for fps in (0.5, 24, 29.97, 120)]
    found = browser.ask("storyboards", streams=streams)
    expected = [StoryboardLayout.of(*stream) for stream in streams]
    assert [(one["stepFrames"], one["numTiles"], one["columns"], one["rows"]) for one in found] == [
        (one.step_frames, one.num_tiles, one.columns, one.rows) for one in expected
    ]


CHECKED: dict[str, tuple[Callable[[bytes], object], Callable[[BrowserCode, bytes], object]]] = {
    "manifest": (
        Manifest.from_json,
        lambda browser, data: browser.ask("manifest", bytes=data.hex()),
    ),
    "record": (
        lambda data: list(map(record_in_browser, RecordParser().feed(data))),
        lambda browser, data: browser.ask("records", pieces=[data.hex()]),
    ),
    "object": (
        lambda data: [[birth, packet.hex()] for birth, packet in object_packets(data)],
        lambda browser, data: browser.ask("object", bytes=data.hex()),
    ),
    "packet": (
        lambda data: packet_content(data, LIMIT).hex(),
        lambda browser, data: browser.ask("packet", bytes=data.hex(), limit=LIMIT),
    ),
}
"""Readers of the package and of the browser, by the name of the fuzzer's target."""

NEAR_THE_CORPUS = [
    path
    for path in sorted(CORPUS.iterdir())
    if TARGET_NAMES[path.read_bytes()[0] % len(TARGETS)] in CHECKED
]


@pytest.mark.parametrize("path", NEAR_THE_CORPUS, ids=lambda path: path.name)
def test_what_is_near_the_corpus_of_the_fuzzer(browser: BrowserCode, path: Path) -> None:
    """Both give the same value, or both refuse. The browser may accept numbers such as 3.0 that the
    package refuses, because it cannot distinguish them from integers."""
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


CAPTION_LINES = [
    "",
    "1",
    "NOTE x",
    "00:00.000 --> 00:01.000",
    "00:00:00.500 --> 01:00:00.000 line:0",
    "00:0.5 --> 00:01.000",
    "a <b>bold</b> word",
    "1 &lt; 2 &amp;&nbsp;3",
    "it&#39;s &#x20AC;5 &#xD800;&#0;&#1114112; &; &#; &#x;",
    "<v Ann",
    "-->",
]


@pytest.mark.parametrize("seed", range(4))
def test_captions_are_read_alike(browser: BrowserCode, seed: int) -> None:
    rng = random.Random(seed)
    for _ in range(40):
        begin = rng.choice(["WEBVTT", "WEBVTT", "WEBVTT\tx", "WEBVTTx", ""])
        text = "\n".join([begin, *rng.choices(CAPTION_LINES, k=rng.randint(0, 12))])
        said = browser.ask("cues", text=text, timeS=0.75)
        try:
            cues = parse_webvtt(text.encode())
        except CorruptError:
            assert said["cues"] is None, text
            continue
        assert said["cues"] == [
            {"startS": cue.start_s, "endS": cue.end_s, "text": cue.text} for cue in cues
        ], text
        due = [cue.text for cue in cues if cue.start_s <= 0.75 < cue.end_s]
        assert said["text"] == "\n".join(due), text


ENGLISH = {"language": "en", "label": "English"}


@pytest.mark.parametrize(
    ("taken", "captions"),
    [
        (True, []),
        (True, [ENGLISH, {"language": "pt-BR", "label": "Português (Brasil) 字幕 😀"}]),
        (True, [{"language": "en", "label": "x" * 80}]),
        (False, [ENGLISH, ENGLISH]),
        (False, [ENGLISH, {"language": "EN", "label": "Upper"}]),
        (False, [{"language": "en", "label": ""}]),
        (False, [{"language": "en", "label": "x" * 81}]),
        (False, [{"language": "en", "label": "a\nb"}]),
        (False, [{"language": "en", "label": "a\u202eb"}]),
        (False, [{"language": "en", "label": "a\u00a0b"}]),
        (False, [{"language": "en"}]),
        (False, [{"language": "../x", "label": "x"}]),
        (False, [{"language": str(n), "label": "x"} for n in range(17)]),
        (False, {}),
    ],
)
def test_the_captions_of_a_manifest_are_taken_alike(
    browser: BrowserCode, taken: bool, captions: object
) -> None:
    try:
        check_captions(captions_of({"captions": captions}))
        is_taken = True
    except (CorruptError, InvalidError):
        is_taken = False
    assert browser.takes("captions", captions=captions) == is_taken == taken
