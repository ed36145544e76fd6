"""Objects that the browser fetches from a static host, and their order."""

from __future__ import annotations

import hashlib

import pytest

from codec.stream.index import SegmentRecord, pack_record
from tests.support.slots.slot_streams import slot_manifest
from tests.support.slots.updates import small_layout
from tests.support.web.browsercode import BrowserCode

NUM_SEGMENTS = 30
SEGMENT_FRAMES = 30
"""Frames of a segment: one second."""
LAYER_BYTES = (300_000, 100_000, 100_000)
SNAPSHOT_BYTES = (150_000, 60_000, 60_000)
MASKS_BYTES = 10_000
NEED_BPS = 8.0 * (sum(LAYER_BYTES) + MASKS_BYTES)
MANIFEST = slot_manifest(small_layout(1, (5, 3, 2), 0, SEGMENT_FRAMES))
FAST_BPS = 100 * NEED_BPS


def index_bytes() -> bytes:
    sha256 = hashlib.sha256(b"any").digest()
    sides = (MASKS_BYTES, *SNAPSHOT_BYTES)
    records = (
        SegmentRecord(
            segment,
            segment * SEGMENT_FRAMES,
            SEGMENT_FRAMES,
            LAYER_BYTES,
            (sha256,) * 3,
            (27.0, 28.0, 29.0),
            sides,
            (sha256,) * 4,
        )
        for segment in range(NUM_SEGMENTS)
    )
    return b"".join(map(pack_record, records))


def standing(
    next_frame: int,
    rate_bps: float = FAST_BPS,
    paused: bool = False,
    queued_bytes: int = 0,
    rate: float = 1.0,
) -> dict[str, object]:
    return {
        "nextFrame": next_frame,
        "rateBps": rate_bps,
        "paused": paused,
        "queuedBytes": queued_bytes,
        "rate": rate,
    }


def chosen(
    browser: BrowserCode, *standings: dict[str, object], first: int = 0, most: int = 3
) -> list[list[str]]:
    """The objects that are requested in each situation."""
    found: list[list[str]] = browser.ask(
        "chosen",
        manifest=MANIFEST.to_json().hex(),
        index=index_bytes().hex(),
        firstFrame=first,
        mostLayers=most,
        standings=list(standings),
    )
    return found


def test_a_fast_link_brings_every_layer_once_and_snapshots_at_the_start_alone(
    browser: BrowserCode,
) -> None:
    seconds = range(0, NUM_SEGMENTS * SEGMENT_FRAMES, SEGMENT_FRAMES)
    asked = [name for names in chosen(browser, *map(standing, seconds)) for name in names]
    objects = {f"{n}/{part}" for n in range(NUM_SEGMENTS) for part in ("0", "1", "2", "masks")}
    assert sorted(asked) == sorted(objects | {f"0/snapshot-{layer}" for layer in range(3)})


def test_nine_seconds_of_layer_0_come_first_and_fifteen_at_most(browser: BrowserCode) -> None:
    (asked,) = chosen(browser, standing(0))
    assert asked[:3] == ["0/snapshot-0", "0/masks", "0/0"]
    layers = [name for name in asked if name.partition("/")[2] in ("0", "1", "2")]
    assert layers[:9] == [f"{n}/0" for n in range(9)]
    assert layers[9:18] == [f"{n}/1" for n in range(9)]
    assert layers[18:27] == [f"{n}/2" for n in range(9)]
    assert {name.partition("/")[0] for name in asked} == {str(n) for n in range(15)}


def test_a_link_that_carries_layer_0_alone_brings_no_other(browser: BrowserCode) -> None:
    rate_bps = 8.5 * (LAYER_BYTES[0] + MASKS_BYTES)
    (asked,) = chosen(browser, standing(0, rate_bps))
    assert {name.partition("/")[2] for name in asked} == {"snapshot-0", "masks", "0"}
    assert len(asked) == 1 + 2 * 15


def test_a_layer_that_comes_back_begins_with_its_snapshot(browser: BrowserCode) -> None:
    full = standing(300, queued_bytes=10**10)
    fast, slow, again = chosen(browser, standing(0), full, standing(480))
    assert "14/1" in fast
    assert not [name for name in slow if name.endswith("/1")]
    assert again[again.index("16/1") - 1] == "16/snapshot-1"
    assert [name for name in again if "snapshot" in name] == ["16/snapshot-1", "16/snapshot-2"]


@pytest.mark.parametrize("queued_bytes", [0, 2_000_000])
def test_what_would_come_too_late_is_not_asked_for(browser: BrowserCode, queued_bytes: int) -> None:
    rate_bps = 1.5 * NEED_BPS
    late = standing(0, rate_bps, queued_bytes=queued_bytes)
    (asked,) = chosen(browser, late)
    planned_s = 8 * (queued_bytes + LAYER_BYTES[1] + SNAPSHOT_BYTES[1]) / (0.9 * rate_bps)
    first = min(int(name.partition("/")[0]) for name in asked if name.endswith("/1"))
    assert first == max(0, -int(-(planned_s - 0.5) // 1))


def test_a_paused_picture_gets_all_layers(browser: BrowserCode) -> None:
    playing, paused = (
        chosen(browser, standing(25, 1.2 * NEED_BPS, paused=paused), first=25)[0]
        for paused in (False, True)
    )
    assert "0/2" not in playing
    assert {"0/snapshot-2", "0/2"} <= set(paused)


def test_at_double_speed_no_more_layers_than_the_link_carries_then(browser: BrowserCode) -> None:
    at = [standing(25, 1.5 * NEED_BPS, rate=rate) for rate in (1.0, 2.0)]
    upper = [
        {name for name in chosen(browser, one, first=25)[0] if name.endswith("/2")} for one in at
    ]
    assert upper[0]
    assert not upper[1]


@pytest.mark.parametrize("most", [1, 2])
def test_no_more_layers_than_are_wanted(browser: BrowserCode, most: int) -> None:
    (asked,) = chosen(browser, standing(0), most=most)
    layers = {name.partition("/")[2] for name in asked if name[-1].isdigit()}
    assert {name for name in layers if "-" not in name} == {str(n) for n in range(most)}


def test_a_rate_follows_the_link(browser: BrowserCode) -> None:
    steady = [[20_000, 0.02]] * 50
    outage = [[0, 0.4]]
    found = browser.ask("estimates", samples=[[1000, 0.001], *steady, *outage, [-20_000, 0.0]])
    assert found[0] is None
    assert found[50] == pytest.approx(8e6, rel=0.01)
    assert found[51] < 0.6 * found[50]
    assert 1 <= found[52] < found[51]
