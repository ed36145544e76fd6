"""The disk cache: bounded, whole files only, least recently used files are removed first."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from player.network.diskcache import FILL_AFTER, DiskCache


def sha256(data: bytes) -> bytes:
    return hashlib.sha256(data).digest()


def thing(number: int, size: int = 100) -> bytes:
    return bytes([number]) * size


def held(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def put(cache: DiskCache, *things: bytes) -> None:
    for data in things:
        cache.put(sha256(data), data)


def test_what_was_put_is_there_also_for_the_next_one(tmp_path: Path) -> None:
    cache = DiskCache(tmp_path / "a" / "b", 1000)
    put(cache, thing(1))
    assert cache.get(sha256(thing(1))) == thing(1)
    assert cache.get(sha256(thing(2))) is None
    again = DiskCache(tmp_path / "a" / "b", 1000)
    assert again.get(sha256(thing(1))) == thing(1)
    assert (cache.counts.hits, cache.counts.misses) == (1, 1)


def test_what_was_used_longest_ago_goes_first(tmp_path: Path) -> None:
    cache = DiskCache(tmp_path, 1000)
    for number in range(10):
        put(cache, thing(number))
        age = 1_000_000_000 * (number + 1)
        name = sha256(thing(number)).hex()
        os.utime(tmp_path / name[:2] / name, ns=(age, age))
    assert cache.get(sha256(thing(0))) is not None
    put(cache, thing(10))
    there = [number for number in range(11) if cache.get(sha256(thing(number))) is not None]
    assert there == [0, 3, 4, 5, 6, 7, 8, 9, 10]
    assert cache.counts.dropped == 2


@given(sizes=st.lists(st.integers(0, 1500), max_size=30))
@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_it_never_holds_more_than_was_said(tmp_path: Path, sizes: list[int]) -> None:
    cache = DiskCache(tmp_path, 1000)
    for number, size in enumerate(sizes):
        data = thing(number, size)
        put(cache, data)
        assert held(tmp_path) <= 1000
        assert (cache.get(sha256(data)) == data) == (size <= 1000 * FILL_AFTER)


def test_files_of_others_stay(tmp_path: Path) -> None:
    mine = tmp_path / "ab" / "letters.txt"
    mine.parent.mkdir()
    mine.write_bytes(bytes(5000))
    cache = DiskCache(tmp_path, 1000)
    put(cache, *(thing(number) for number in range(30)))
    assert mine.exists()


def test_what_another_one_left_half_written_goes_too(tmp_path: Path) -> None:
    name = sha256(b"x").hex()
    half = tmp_path / name[:2] / f"{name}.123.tmp"
    half.parent.mkdir()
    half.write_bytes(bytes(900))
    os.utime(half, ns=(0, 0))
    cache = DiskCache(tmp_path, 1000)
    put(cache, thing(1), thing(2))
    assert not half.exists()
    assert cache.get(sha256(thing(1))) is not None


def test_a_file_that_was_damaged_is_not_given(tmp_path: Path) -> None:
    cache = DiskCache(tmp_path, 1000)
    put(cache, thing(1))
    name = sha256(thing(1)).hex()
    (tmp_path / name[:2] / name).write_bytes(thing(2))
    assert cache.get(sha256(thing(1))) is None
    assert cache.counts.damaged == 1
    assert held(tmp_path) == 0


def test_what_cannot_be_written_is_counted(tmp_path: Path) -> None:
    cache = DiskCache(tmp_path, 1000)
    name = sha256(thing(1)).hex()
    (tmp_path / name[:2]).write_text("in the way")
    put(cache, thing(1))
    assert cache.counts.failed == 1
    assert cache.get(sha256(thing(1))) is None
