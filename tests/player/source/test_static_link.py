"""Streams from static hosts and servers over emulated links, in real time. The laws themselves are
in test_hosted_play.py, for a made link; tests/server/abr has those of a server."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from statistics import fmean
from typing import Any
from urllib.parse import urlsplit

import pytest

from codec.framerange import FrameRange
from codec.stream import StreamReader
from player.link.linkprocess import LinkProcess
from player.playout.clock import Clock
from player.playout.queues import Events
from player.playout.threads import Threads
from player.playout.timeline import FrameRecord, Playout
from player.source.opener import Opener
from server.abr.link import Link, LinkStep
from server.abr.playout import PlayoutConfig
from tests.player.source.test_hosted_play import LAWS, need_bps
from tests.support.delivery.assembled import assembled, checked
from tests.support.delivery.rangehost import range_host
from tests.support.hosted_streams import served
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout

pytestmark = pytest.mark.realtime

NUM_FRAMES, LAYERS, FPS = 120, 3, 30.0


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("root")
    write_busy_stream(path / "s", NUM_FRAMES, small_layout(4, (240, 240, 240), 0, 30), fps=FPS)
    return path


@contextmanager
def over_link(root: Path, host: str, *steps: tuple[float, float]) -> Iterator[Opener]:
    """Opens the stream over a link. steps: seconds, and what it carries as a share of the
    stream."""
    all_bps = need_bps(StreamReader(root / "s"))
    link = Link([LinkStep(seconds, share * all_bps, 0.02) for seconds, share in steps])
    hosts: dict[str, Callable[[Path], Any]] = {"ranges": range_host, "swings": served}
    with hosts[host](root) as at:
        url = at.url + ("/watch" if host == "swings" else "")
        port = urlsplit(url).port
        assert port is not None
        with (
            LinkProcess(link, "127.0.0.1", port) as relay,
            closing(Opener(f"{url}/s", relay.address)) as opener,
        ):
            yield opener


@pytest.mark.parametrize(
    ("host", "case"), [("swings", LAWS[0]), *(("ranges", case) for case in LAWS)]
)
def test_layers_follow_the_link_without_a_stall(root: Path, host: str, case: Any) -> None:
    steps, laws = case
    clock, frames = Clock(real=True), list[FrameRecord]()
    with (
        over_link(root, host, *steps) as opener,
        closing(opener.open(FrameRange(), None, adaptive=True)) as source,
    ):
        playout = Playout(source.manifest, 0, NUM_FRAMES, config=PlayoutConfig(conceal_s=0.15))
        events, began_s = Events(playout, clock), clock.now_s()
        with Threads(source, events):
            while (due := events.wait_for_frame()) is not None:
                frames.append(due.record)
    assert [one.frame for one in frames] == list(range(NUM_FRAMES))
    first_s = frames[0].shown_s
    assert first_s - began_s < 0.5
    assert events.totals.stalls == 0
    for begin_s, end_s, least, most in laws:
        part = [one.layers for one in frames if begin_s <= one.shown_s - first_s < end_s]
        assert not begin_s or least <= fmean(part) <= most


def test_a_network_that_dies_again_and_again_is_played_over(root: Path) -> None:
    with (
        over_link(root, "swings", (0.5, 1.5), (0.5, 0.0)) as opener,
        closing(opener.open(FrameRange(), LAYERS)) as source,
    ):
        got = list(checked(StreamReader(root / "s"), assembled(source), LAYERS))
    assert len(got) == NUM_FRAMES
