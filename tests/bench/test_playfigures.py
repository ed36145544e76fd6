"""Figures of `scripts/bench serve` for made-up plays with known figures."""

from __future__ import annotations

from operator import attrgetter
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.serve.playfigures import PlayFigures, Seen, Shape, figures_of, live_latency_s
from bench.serve.playload import Body
from codec.stream.playrecord import SliceRecord, encode_record

SHAPE = Shape(fps=10.0, num_layers=2, rest_s=0.2, max_rest_s=0.4)


def seen(
    packets: list[tuple[int, int, int, int, float]],
    clients: int = 1,
    ended_s: float = 100.0,
    status: int = 200,
    over: bool = False,
) -> Seen:
    """packets: client, birth, first layer, layers, arrival time; all requests are at 10 s."""
    who, birth, first, layers, at_s = zip(*packets, strict=True) if packets else ((),) * 5
    known = {
        "began_s": 10.0,
        "steady_s": 10.1,
        "ended_s": ended_s,
        "realtime_offset_s": 1000.0,
        "server_share": 0.5,
        "load_share": 0.25,
        "load_longest_s": 0.001,
        "others_share": 0.0,
        "server_rss_bytes": 1e6,
    }
    arrays: dict[str, Any] = {
        "who": np.array(who, np.int32),
        "birth": np.array(birth, np.int32),
        "first": np.array(first, np.int8),
        "layers": np.array(layers, np.int8),
        "at_s": np.array(at_s, np.float64),
        "asked_s": np.full(clients, 10.0),
        "head_s": np.full(clients, 10.01),
        "record_s": np.full(clients, 10.02),
        "status": np.full(clients, status),
        "over": np.full(clients, over),
    }
    return Seen(arrays, known)


def paced(num_frames: int, client: int = 0) -> list[tuple[int, int, int, int, float]]:
    """Packets of a well-paced server: six frames at once, then three every 0.3 s."""
    return [
        (client, birth, 0, 2, 10.05 if birth < 6 else 10.05 + 0.3 * (1 + (birth - 6) // 3))
        for birth in range(num_frames)
    ]


def figures(packets: list[tuple[int, int, int, int, float]], **more: float) -> PlayFigures:
    return figures_of(seen(packets, ended_s=more.pop("ended_s", 13.05)), SHAPE, 1000)


PLAYS: dict[str, tuple[list[tuple[int, int, int, int, float]], float, dict[str, float]]] = {
    "a good one is never late and has no gap beyond its rest": (
        paced(60), 13.05,
        {"failed": 0, "missing": 0, "double": 0, "late_ms.max": 0, "beyond_ms.max": 0,
         "rest_ms.p50": 300, "layers": 2, "head_ms.p50": 10, "record_ms.max": 20,
         "picture_ms.p50": 50, "bytes_per_s": 60 * 1000 / 3.05},
    ),
    "a late burst is a gap, and no slice is late while the lead lasts": (
        [(*p[:4], p[4] + 0.1 * (12 <= p[1] < 15)) for p in paced(60)], 13.05,
        {"beyond_ms.max": 100, "late_ms.max": 0},
    ),
    "one that stops is late until the end": (
        paced(12), 13.05,
        {"late_ms.max": 1000 * (13.05 - 11.25), "beyond_ms.max": 1000 * (13.05 - 10.65) - 300},
    ),
    "a server that is always late cannot call it pacing": (
        [(*p[:4], 10.05 + 0.9 * max(0, (p[1] - 3) // 3)) for p in paced(60)], 30.0,
        {"rest_ms.p50": 500, "beyond_ms.p50": 400},  # max_rest_s and a frame
    ),
    "what lacks and what comes twice is counted": (
        # Layer 0 of 7 again; 9 without layer 0.
        [*(p for p in paced(60) if p[1] != 9), (0, 7, 0, 1, 12.0), (0, 9, 1, 1, 12.0)], 13.05,
        {"missing": 1, "double": 1},
    ),
    "a layer alone": ([(*p[:3], 1, p[4]) for p in paced(60)], 13.05, {"layers": 1}),
    "layers that come apart are added up": (
        [(*p[:2], layer, 1, p[4] + 0.01 * layer) for layer in (0, 1) for p in paced(60)], 13.05,
        {"layers": 2, "double": 0},
    ),
}  # fmt: skip
"""The packets of a play, its end in seconds, and its figures."""


@pytest.mark.parametrize("what", PLAYS)
def test_a_play_has_its_figures(what: str) -> None:
    packets, ended_s, expected = PLAYS[what]
    found = figures(packets, ended_s=ended_s)
    values = {name: attrgetter(name)(found) for name in expected}
    assert values == pytest.approx(expected, abs=1e-6)


@given(st.floats(0.7, 2.0))
def test_a_slice_is_late_by_what_exceeds_its_lead(delay_s: float) -> None:
    """Without delay slice 20 arrives up to 0.6 s early: 6 frames of lead, minus its place in its
    burst."""
    packets = [(*p[:4], p[4] + delay_s * (p[1] == 20)) for p in paced(60)]
    due_s, came_s = 10.05 + 2.0, next(p[4] for p in packets if p[1] == 20)
    assert figures(packets, ended_s=15.0).late_ms.max == pytest.approx(
        max(0, 1000 * (came_s - due_s)), abs=1e-6
    )


@pytest.mark.parametrize("how", ["refused", "cut", "silent"])
def test_a_client_that_got_no_play_counts_as_failed(how: str) -> None:
    packets = [] if how == "silent" else paced(60)
    status = 503 if how == "refused" else 200
    one = seen(packets, status=status, over=how == "cut", ended_s=13.05)
    assert figures_of(one, SHAPE).failed == 1


def test_live_latency_is_from_the_birth_of_a_segment() -> None:
    packets = [(n, birth, 0, 2, 11 + birth / 10) for n in range(2) for birth in range(20)]
    born_s = {0: (5, 1010.9), 5: (10, 1011.2), 10: (15, 1011.9), 15: (25, 1012.0)}
    first_s, last_s = live_latency_s(seen(packets, clients=2), born_s, after_s=1011.0)
    # The first segment is too old, the last one never arrived completely.
    assert sorted(first_s) == pytest.approx([0.1, 0.1, 0.3, 0.3])
    assert sorted(last_s) == pytest.approx([0.5, 0.5, 0.7, 0.7])


CHUNKED_PACKETS = (b"x" * 500, b"yz" * 9)
CUTS = st.lists(st.integers(0, 1700), max_size=12).map(sorted)


def pieces(data: bytes, cuts: list[int]) -> list[bytes]:
    return [data[a:b] for a, b in zip([0, *cuts], [*cuts, len(data)], strict=True)]


@given(CUTS, CUTS)
def test_a_body_in_chunks_is_read_in_any_pieces(chunks: list[int], reads: list[int]) -> None:
    records = [encode_record(SliceRecord(birth, CHUNKED_PACKETS, b"mask")) for birth in range(3)]
    body = b"".join(records)
    sent = b"".join(b"%x\r\n%b\r\n" % (len(p), p) for p in pieces(body, chunks) if p)
    got, reader = bytearray(), Body(chunked=True)
    for piece in pieces(sent, reads):
        reader.feed(memoryview(piece), got)
    assert bytes(got) == body
    assert msgpack.unpackb(bytes(got[4 : len(records[0])]))["birth"] == 0
