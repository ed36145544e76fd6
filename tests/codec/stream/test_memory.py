"""Hostile bytes under a memory limit that the kernel enforces: no decoder exceeds the claim.

tests/support/bounded_decoder.py has the inputs, and the memory that each may use.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.bounded_decoder import CASES
from tests.support.commands import ROOT

# `value`, or the error message. A failed allocation inside zstd gives neither.
OUTCOMES = {
    "zstd": "value",
    "cut off": "CorruptError: packet: decompression error: did not decompress full frame",
    "claims the most": "CorruptError: packet: decompression error: did not decompress full frame",
    "claims too much": "248512625 bytes of content, at most 248512624",
    "claims an exabyte": "1152921504606846976 bytes of content cannot come from 8",
    "gzip": "value",
    "gzip says less": "CorruptError: packet: more content than the 1000 bytes that it declares",
    "gzip claims too much": "248512625 bytes of content, at most 248512624",
    "table": "CorruptError: object: 196628 bytes, its table says 1065156628",
    "index": "index.bin is longer than",
    "manifest": "CorruptError: manifest: is not a JSON object",
    "texts in a manifest": "a name of 60000 characters, at most 2000",
    "snapshot record": "value",
    "bytes as a kind": "CorruptError: play: a record of kind bytes",
    "text in a record": "CorruptError: play: a record is not msgpack",
    "short file": "value",
    "ply": "CorruptError: PLY: ends after",
    "ply over the cap": "CorruptError: PLY: claims 1099511627776 Gaussians",
    "spz": "CorruptError: SPZ: not the 171 bytes that 9 Gaussians need",
    "ply of degree 3": "value",
    "compressed ply": "value",
    "splat": "value",
    "spz 3": "value",
    "spz 4": "CorruptError: SPZ: an array: decompression error: did not decompress full frame",
    "change, all escaped": "value",
    "change that no mask names": "CorruptError: change: 262144 new, the mask declares 7",
    "full snapshot": "value",
    "mask of zeros": "CorruptError: mask: a body of 1048576 bytes, of which",
    "mask of noise": "CorruptError: mask: a body of 1048576 bytes, of which",
    "mask beyond its slots": "segments/0/masks: byte 3303: packet: 104857612 bytes of content",
    "change beyond its slots": "segments/0/1: byte 3303: packet: 104857612 bytes of content",
    "snapshot beyond its slots": "snapshot-0: byte 32: packet: 104857612 bytes of content",
    "verify beyond its slots": "segments/0/0: byte 68: packet: 104857612 bytes of content",
    "sizes in an index": "bytes, the index says 1073741824",
    "empty slots": "value",
    # The limit is effective.
    "control": "MemoryError",
}


def test_every_case_has_an_outcome() -> None:
    assert list(OUTCOMES) == list(CASES)


@pytest.fixture(scope="module")
def outcomes() -> dict[str, str]:
    """Outcomes of decoding, by case."""
    if not Path("/proc/self/status").exists():
        pytest.skip("needs Linux: RLIMIT_DATA and VmData")
    done = subprocess.run(
        [sys.executable, "-m", "tests.support.bounded_decoder"],
        cwd=ROOT,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    found: dict[str, str] = json.loads(done.stdout)
    return found


@pytest.mark.parametrize("case", OUTCOMES)
def test_memory_stays_within_what_is_declared(outcomes: dict[str, str], case: str) -> None:
    assert OUTCOMES[case] in outcomes[case]
    assert (OUTCOMES[case] == "value") == (outcomes[case] == "value")
