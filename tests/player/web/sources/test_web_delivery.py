"""What the browser asks for, and when: the decisions of server.abr, one by one."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import pytest

from codec.stream.integrity import read_index
from codec.stream.manifest import Manifest
from server.abr.link.link import Link, LinkStep
from server.abr.media import SegmentSizes, segment_sizes
from server.abr.outlook import Send, SendSlices, SendSnapshots
from server.abr.policies.choice import own_policy
from server.abr.session import (
    Decision,
    Finished,
    PlaySession,
    SessionConfig,
    WaitForFrames,
    WaitForNews,
    WaitUntil,
)
from server.abr.simulate import simulator
from server.abr.simulate.simulator import simulate
from server.abr.standing import Standing
from tests.goldens.pinned_slots import FILE as SLOTS_FILE
from tests.support.delivery.media import MadeMedia, demo_media, slot_media
from tests.support.web.browsercode import BrowserCode

Event = list[Any]

NUM_SEGMENTS = 40
"""More than any stream here has."""


def as_json(decision: Decision) -> dict[str, Any]:
    match decision:
        case SendSlices(births, first_layer, end_layer):
            return {
                "kind": "slices",
                "birth": births.start,
                "endBirth": births.stop,
                "firstLayer": first_layer,
                "endLayer": end_layer,
            }
        case SendSnapshots(frame, first_layer, end_layer):
            return {
                "kind": "snapshots",
                "frame": frame,
                "firstLayer": first_layer,
                "endLayer": end_layer,
            }
        case WaitUntil(time_s):
            return {"kind": "waitUntil", "timeS": time_s}
        case WaitForNews():
            return {"kind": "waitForNews"}
        case WaitForFrames():
            return {"kind": "waitForFrames"}
        case Finished():
            return {"kind": "finished"}


class RecordedSession(PlaySession):
    """A session that notes what happens to it, and what it decides."""

    events: ClassVar[list[Event]] = []
    decided: ClassVar[list[tuple[dict[str, Any], float | None, int]]] = []

    def acknowledge(self, now_s: float, acked_bytes: float) -> None:
        self.events.append(["acknowledge", now_s, acked_bytes])
        super().acknowledge(now_s, acked_bytes)

    def told(self, now_s: float, standing: Standing) -> None:
        self.events.append(["told", now_s, standing.frame, standing.paused])
        super().told(now_s, standing)

    def sent(self, send: Send, num_bytes: float, now_s: float) -> None:
        self.events.append(["sent", as_json(send), num_bytes, now_s])
        super().sent(send, num_bytes, now_s)

    def decide(self, now_s: float) -> Decision:
        self.events.append(["decide", now_s])
        decision = super().decide(now_s)
        self.decided.append((as_json(decision), self.rate_bps, self.next_frame))
        return decision


@pytest.fixture
def recorded(monkeypatch: pytest.MonkeyPatch) -> type[RecordedSession]:
    monkeypatch.setattr(RecordedSession, "events", [])
    monkeypatch.setattr(RecordedSession, "decided", [])
    monkeypatch.setattr(simulator, "PlaySession", RecordedSession)
    return RecordedSession


def replay(
    browser: BrowserCode,
    media: MadeMedia,
    recorded: type[RecordedSession],
    first_frame: int = 0,
    until_frame: int | None = None,
    rate_bps: float | None = None,
) -> None:
    """The browser decides the same, to which the same happens."""
    all_sizes = [media.sizes(n * media.segment_frames) for n in range(NUM_SEGMENTS)]
    rows = [(s.layer_bytes, s.psnr_db, s.snapshot_bytes, s.changed_shares) for s in all_sizes]
    shape = {
        "fps": media.fps,
        "swinSize": media.swin_size,
        "segmentFrames": media.segment_frames,
        "hasSlots": media.has_slots,
        "numLayers": media.num_layers,
        "numFrames": media.num_frames,
        "live": media.live,
    }
    found = browser.ask(
        "replay",
        shape=shape,
        segments=rows,
        firstFrame=first_frame,
        untilFrame=until_frame,
        rateBps=rate_bps,
        events=recorded.events,
    )
    assert len(found) == len(recorded.decided)
    pairs = zip(found, recorded.decided, strict=True)
    for (decision, rate, frame), (expected, expected_rate, expected_frame) in pairs:
        assert decision == pytest.approx(expected)
        assert rate == pytest.approx(expected_rate)
        assert frame == expected_frame


def random_media(seed: int) -> MadeMedia:
    rng = np.random.default_rng(seed)
    num_layers = int(rng.integers(1, 5))
    has_slots = bool(seed % 2)
    segments = []
    for _ in range(4):
        layer_bytes = rng.uniform(500, 20_000, num_layers)
        segments.append(
            SegmentSizes(
                tuple(layer_bytes.tolist()),
                tuple(np.sort(rng.uniform(24, 32, num_layers)).tolist()),
                tuple((6 * layer_bytes).tolist()) if has_slots else (),
                tuple(rng.uniform(0.05, 0.6, num_layers).tolist()) if has_slots else (),
            )
        )
    return MadeMedia(
        tuple(segments),
        num_frames=int(rng.integers(30, 240)),
        fps=float(rng.choice([15.0, 29.97, 30.0, 60.0])),
        swin_size=int(rng.integers(1, 8)),
        segment_frames=int(rng.choice([7, 15, 30])),
        has_slots=has_slots,
    )


def link_of(durations_s: list[float], rates_bps: list[float], latency_s: float) -> Link:
    pairs = zip(durations_s, rates_bps, strict=True)
    return Link([LinkStep(duration_s, rate_bps, latency_s) for duration_s, rate_bps in pairs])


def random_link(seed: int, need_bps: float) -> Link:
    rng = np.random.default_rng(seed)
    durations_s = rng.uniform(0.2, 2.5, 12)
    rates_bps = need_bps * rng.choice([0.02, 0.3, 0.8, 1.1, 1.6, 4.0], 12)
    latency_s = float(rng.choice([0.0, 0.02, 0.15]))
    return link_of(durations_s.tolist(), rates_bps.tolist(), latency_s)


@pytest.mark.parametrize("seed", range(24))
def test_a_play_over_a_link_that_changes(
    browser: BrowserCode, recorded: type[RecordedSession], seed: int
) -> None:
    media = random_media(seed)
    first = int(np.random.default_rng(seed).integers(0, 20))
    link = random_link(seed, media.need_bps(media.num_layers))
    simulate(media, own_policy(media), link, first_frame=first, at_most_s=60)
    assert len(recorded.decided) > 50
    replay(browser, media, recorded, first)


@pytest.mark.parametrize("media", [demo_media(300), slot_media(300)], ids=["slices", "slots"])
def test_the_link_of_the_demo(
    browser: BrowserCode, recorded: type[RecordedSession], media: MadeMedia
) -> None:
    link = link_of([4.0, 4.0, 30.0], [12e6, 4e6, 12e6], 0.02)
    simulate(media, own_policy(media), link)
    replay(browser, media, recorded)


def test_a_play_that_pauses_and_a_stream_that_grows(
    browser: BrowserCode, recorded: type[RecordedSession]
) -> None:
    for media in (demo_media(60), slot_media(60)):
        recorded.events.clear()
        recorded.decided.clear()
        live = replace(media, live=True, num_frames=0)
        session = recorded(live, own_policy(live), SessionConfig(), 0.0, rate_bps=20e6)
        at_first = replace(live)
        for step in range(900):
            now_s = step / 100
            session.acknowledge(now_s, session.sent_bytes)
            if 100 <= step < 300 and step % 50 == 0:
                frame = session.clock.next_frame(now_s)
                session.told(now_s, Standing(frame, paused=True))
            if step == 300:
                frame = session.clock.next_frame(now_s)
                session.told(now_s, Standing(frame))
            if step % 20 == 0:
                live.num_frames, live.live = min(60, step // 5), step < 400
                recorded.events.append(["grown", live.num_frames, live.live])
            decision = session.decide(now_s)
            if isinstance(decision, SendSlices | SendSnapshots):
                session.sent(decision, 3000.0, now_s)
        assert recorded.decided[-1][0] == {"kind": "finished"}
        replay(browser, at_first, recorded, rate_bps=20e6)


def test_the_sizes_that_an_index_says(browser: BrowserCode) -> None:
    goldens = [row["folders_hex"] for row in json.loads(SLOTS_FILE.read_text())]
    for files in [files for folders in goldens for files in folders.values()]:
        manifest = Manifest.from_json(bytes.fromhex(files["manifest.json"]))
        records = read_index(bytes.fromhex(files["index.bin"]), manifest)
        found = browser.ask("sizes", manifest=files["manifest.json"], bytes=files["index.bin"])
        for sizes, record in zip(found, records, strict=True):
            expected = segment_sizes(record, manifest)
            assert sizes["layerBytes"] == pytest.approx(expected.layer_bytes)
            assert sizes["gainsDb"] == pytest.approx(expected.gains_db)
            assert sizes["sliceBytes"] == pytest.approx(expected.slice_bytes)
            assert sizes["snapshotBytes"] == list(expected.snapshot_bytes)
            assert sizes["changedShares"] == pytest.approx(expected.changed_shares)
