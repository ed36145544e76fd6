"""The disk cache: bounded, whole files only, least recently used files are removed first."""

from __future__ import annotations

import os
from hashlib import sha256
from pathlib import Path

from player.network.diskcache import DiskCache

THINGS = [bytes([number]) * 100 for number in range(11)]
NAMES = [sha256(data).digest() for data in THINGS]


def test_it_holds_what_was_used_last_and_gives_nothing_that_was_damaged(tmp_path: Path) -> None:
    cache = DiskCache(tmp_path, 1000)
    mine = tmp_path / "ab" / "letters.txt"
    mine.parent.mkdir()
    mine.write_bytes(bytes(5000))
    files = [tmp_path / name.hex()[:2] / name.hex() for name in NAMES]
    for number, (name, data) in enumerate(zip(NAMES[:10], THINGS, strict=False), 1):
        cache.put(name, data)
        os.utime(files[number - 1], ns=(1_000_000_000 * number,) * 2)
    half = files[4].with_name(f"{files[4].name}.123.tmp")  # another process was killed
    half.write_bytes(bytes(900))
    os.utime(half, ns=(0, 0))
    again = DiskCache(tmp_path, 1000)
    assert again.get(NAMES[0]) == THINGS[0]
    again.put(NAMES[10], THINGS[10])
    assert mine.exists()
    assert not half.exists()
    assert sum(file.stat().st_size for file in files if file.exists()) <= 1000
    assert [n for n, name in enumerate(NAMES) if again.get(name)] == [0, *range(3, 11)]
    files[10].write_bytes(THINGS[9])
    assert again.get(NAMES[10]) is None
    assert again.counts.damaged == 1
