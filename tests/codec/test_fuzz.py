"""The fuzzer's corpus and its findings, run through the parsers; see fuzz/codec.py."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from fuzz.codec import TARGETS, accepts
from fuzz.seed import CORPUS, found, seeds
from fuzz.slots import LAYOUTS, run_script
from fuzz.slotseed import NUM_FRAMES
from tests.support.hostile import refused

FILES = sorted(CORPUS.iterdir())


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
    assert accepts(path.read_bytes()) or path.name.startswith("found-")


@pytest.mark.parametrize("rounds", [20, pytest.param(500, marks=pytest.mark.deep)])
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_what_is_near_a_file_of_the_corpus(path: Path, rounds: int) -> None:
    """A short version of the fuzzer's work, with the same mutations in each run."""
    data = path.read_bytes()
    rng = random.Random(path.name)
    for _ in range(rounds):
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
    refused(KeyError, "", accepts, broken)
