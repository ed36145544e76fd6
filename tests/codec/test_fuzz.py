"""The fuzzer's corpus and its findings, run through the parsers; see fuzz/codec.py."""

from __future__ import annotations

import json
import random
from pathlib import Path

import pytest

from codec.errors import CodecError, CorruptError
from codec.stream.manifest import Manifest
from codec.stream.playrecord import MAX_TEXT_BYTES, ErrorRecord, decode_record, encode_record
from fuzz.codec import TARGETS, accepts
from fuzz.seed import CORPUS, found, made_manifest, seeds
from fuzz.slots import LAYOUTS, run_script
from fuzz.slotseed import NUM_FRAMES
from tests.support.hostile import survives

FILES = sorted(CORPUS.iterdir())
MANIFEST = json.loads(made_manifest().to_json())


def test_the_corpus_is_that_of_the_seeds_and_small() -> None:
    names = {f"{target}-{what}" for target, what, _ in seeds()}
    names |= {f"found-{target}-{what}" for target, what, _ in found()}
    assert names == {path.name for path in FILES if path.name in names}
    assert all(path.name in names or path.name.startswith("found-") for path in FILES)
    assert sum(path.stat().st_size for path in FILES) < 300_000


def test_every_parser_has_a_seed_that_it_accepts() -> None:
    assert {target for target, _, _ in seeds()} == set(TARGETS)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_a_file_of_the_corpus(path: Path) -> None:
    """A seed is accepted by its parser; a finding is refused or accepted, with no other error."""
    accepted = accepts(path.read_bytes())
    assert accepted or path.name.startswith("found-")


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_what_is_near_a_file_of_the_corpus(path: Path) -> None:
    """A short version of the fuzzer's work, with the same mutations in each run."""
    data = path.read_bytes()
    rng = random.Random(path.name)
    for _ in range(40):
        altered = bytearray(data)
        for _ in range(rng.randint(1, 4)):
            place = rng.randrange(1, len(altered))
            match rng.randrange(4):
                case 0:
                    altered[place] ^= 1 << rng.randrange(8)
                case 1:
                    altered[place] = rng.choice((0, 1, 0x7F, 0x80, 0xFF))
                case 2:
                    del altered[place : place + rng.randint(1, 8)]
                case _:
                    altered[place:place] = rng.randbytes(rng.randint(1, 8))
            if len(altered) < 2:
                break
        accepts(bytes(altered))


def test_a_reader_takes_every_step_of_a_whole_script_and_most_of_a_torn_one() -> None:
    """These seeds start the fuzzer deep in the reader of slots."""
    for number, layout in enumerate(LAYOUTS):
        foods = {what: food for target, what, food in seeds() if target == "slots"}
        num_loads = len(layout.slots)
        assert run_script(foods[f"whole-{number}"]) == num_loads + NUM_FRAMES - 1
        assert run_script(foods[f"torn-{number}"]) >= num_loads + NUM_FRAMES - 1 + 4


def test_the_law_can_be_broken(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("codec.camera.CorruptError", KeyError)
    broken = (CORPUS / "found-manifest-list-for-a-name").read_bytes()
    with pytest.raises(KeyError):
        accepts(broken)


def test_a_text_that_is_not_unicode_is_refused_everywhere() -> None:
    """Such a text could not be written again: a stream with it as title could never be finished."""
    half = "\ud800"
    camera = MANIFEST["cameras"][0] | {"name": half}
    for change in (
        {"title": half},
        {"poster": half},
        {"object_url": half + "{segment}{layer}"},
        {"cameras": [camera], "default_camera": half},
    ):
        with pytest.raises(CorruptError, match="half a surrogate pair"):
            Manifest.from_json(json.dumps(MANIFEST | change).encode())


@pytest.mark.parametrize(
    "change",
    [
        {"name": 7},
        {"name": ["front"]},
        {"width_px": "64"},
        {"width_px": 64.0},
        {"height_px": True},
        {"fx_px": "50"},
        {"cx_px": None},
        {"fy_px": 10**400},
        {"w2c": ["1"] * 16},
        {"w2c": [[1.0] * 4] * 4},
        {"w2c": "1" * 16},
        {"w2c": [10**400] * 16},
    ],
)
def test_a_camera_with_a_value_of_the_wrong_type(change: dict[str, object]) -> None:
    cameras = [MANIFEST["cameras"][0] | change]
    with pytest.raises(CorruptError, match="camera"):
        Manifest.from_json(json.dumps(MANIFEST | {"cameras": cameras}).encode())


@pytest.mark.parametrize("key", ["name", "w2c"])
def test_lists_in_lists_as_deep_as_json_goes(key: str) -> None:
    """The parser accepts this depth, but it exhausts the stack of code that prints the value."""
    for depth in range(800, 1000):
        deep = "[" * depth + "]" * depth
        camera = json.dumps(MANIFEST["cameras"][0] | {key: 7}).replace('": 7', f'": {deep}')
        data = json.dumps(MANIFEST | {"cameras": [1]}).replace("[1]", f"[{camera}]").encode()
        assert not survives(Manifest.from_json, data)


def test_a_long_text_in_a_record() -> None:
    for value, good in ((MAX_TEXT_BYTES, True), (MAX_TEXT_BYTES + 1, False)):
        body = b"\x82\xa4kind\xa5error\xa7message\xdb" + value.to_bytes(4, "big") + b"x" * value
        if good:
            assert decode_record(body) == ErrorRecord("x" * 500)
        else:
            with pytest.raises(CodecError):
                decode_record(body)


def test_what_went_wrong_can_always_be_sent() -> None:
    """A message may name a path whose bytes are not UTF-8."""
    body = encode_record(ErrorRecord("lost: \udcff" + "x" * 999))[4:]
    assert decode_record(body) == ErrorRecord("lost: ?" + "x" * 493)
