"""Sound fetched ahead: bounded, from every kind of source, silent where it is unavailable."""

from __future__ import annotations

import shutil
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.framerange import FrameRange
from codec.stream.streampacker import pack_stream
from player.network.fetch import RetryConfig
from player.sound.feed import (
    AHEAD_S,
    GROWTH_SHARE,
    REST_SHARE,
    URGENT_S,
    DecodedSound,
    FetchPace,
    SoundFeed,
    Whereabouts,
    segment_before,
    segment_span,
    wanted_segments,
)
from player.source.opener import Opener, SourceConfig
from tests.support.delivery.rangehost import range_host
from tests.support.hosted_streams import served, small_manifest, static_host, write_stream
from tests.support.sounding import add_clicks, heard
from tests.support.waiting import wait_until

NUM_FRAMES = 23


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("root")
    write_stream(root / "s", NUM_FRAMES)
    add_clicks(root / "s", (0, 4, 5, 10, 19, 22))
    return root


def fed(source: str, at: Whereabouts, patience_s: float = 1.0) -> tuple[DecodedSound, SoundFeed]:
    """The sound of `source` after everything needed at `at` has arrived."""
    opener = Opener(source, config=SourceConfig(RetryConfig(patience_s)))
    with closing(opener):
        opener.open(FrameRange(), None).close()
        manifest = opener.manifest
        assert manifest is not None
        decoded = DecodedSound(manifest)
        wanted = wanted_segments(manifest, at)
        with SoundFeed(manifest, opener.sound_files(), decoded, lambda: at) as feed:
            wait_until(lambda: all(decoded.has(n) or n in feed.failed for n in wanted))
    return decoded, feed


def test_every_kind_of_source_gives_the_same_samples(root: Path) -> None:
    whole, at = heard(root / "s"), Whereabouts(0, 0, NUM_FRAMES, False)
    pack_stream(root / "s", root / "p.swings")
    with served(root) as server, range_host(root) as host:
        folders = [f"{place}/{name}" for place in (root, host.url) for name in ("s", "p.swings")]
        for source in (*folders, f"{server.url}/watch/s"):
            decoded, feed = fed(source, at)
            camera = small_manifest().camera()
            mixed = decoded.mix(0, len(whole), camera)
            np.testing.assert_array_equal(np.rint(mixed * 32768), whole)
            assert (feed.loaded, len(feed.failed)) == (5, 0)


def test_what_cannot_be_had_is_silent_and_the_rest_is_heard(root: Path, tmp_path: Path) -> None:
    shutil.copytree(root / "s", tmp_path / "s")
    whole = heard(tmp_path / "s")
    (tmp_path / "s" / "segments" / "1" / "audio-main").unlink()
    path = tmp_path / "s" / "segments" / "3" / "audio-main"
    path.write_bytes(path.read_bytes()[:-1])
    with static_host(tmp_path) as host:
        for source in (str(tmp_path / "s"), f"{host}/s"):
            decoded, feed = fed(source, Whereabouts(0, 0, NUM_FRAMES, False), 0)
            assert feed.failed == {1, 3}
            manifest = small_manifest()
            begin, stop = segment_span(manifest, 2)
            mixed = np.rint(decoded.mix(begin, stop, manifest.camera()) * 32768)
            # A decoder that begins here is right except for the history that it cannot know.
            assert np.abs(mixed - whole[begin:stop]).max() < 400
            begin, stop = segment_span(manifest, 1)
            assert not decoded.mix(begin, stop, manifest.camera()).any()


def test_no_more_is_wanted_than_is_heard_soon_and_what_was_just_heard_is_kept() -> None:
    manifest = small_manifest(fps=30.0, segment_frames=30)
    ahead = int(AHEAD_S)
    assert wanted_segments(manifest, Whereabouts(45, 0, 9000, False)) == [*range(1, ahead + 2)]
    assert wanted_segments(manifest, Whereabouts(95, 0, 100, False)) == [3]
    assert wanted_segments(manifest, Whereabouts(95, 40, 100, True)) == [3, 1, 2]
    long = small_manifest(fps=30.0, segment_frames=900)
    assert wanted_segments(long, Whereabouts(0, 0, 9000, False)) == [0, 1]
    assert wanted_segments(long, Whereabouts(9000, 0, 9000, False)) == []
    assert segment_before(manifest, Whereabouts(95, 40, 3000, True)) == 2
    assert segment_before(manifest, Whereabouts(40, 40, 3000, False)) == 0
    assert segment_before(manifest, Whereabouts(40, 40, 3000, True)) == 99


@given(st.floats(0.001, 2), st.floats(0.5, 10), st.floats(0.02, 0.3))
def test_sound_is_in_time_and_leaves_the_link_to_the_pictures(
    length_s: float, ahead_s: float, share: float
) -> None:
    """Each segment of `length_s` takes `share` of it to fetch. Only the first ones are late, and
    segments that are not heard soon take a small part of the time."""
    pace, took_s = FetchPace(), share * length_s
    now_s, fetched, begin_s = 0.0, 0, took_s
    while now_s < 60 * length_s:
        played_s = max(0.0, now_s - begin_s)
        due_s = max(0.0, fetched * length_s - played_s)
        if due_s < max(ahead_s, length_s) and pace.allows(due_s, now_s):
            now_s += took_s
            pace.fetched(now_s - took_s, now_s, length_s)
            assert now_s - begin_s <= fetched * length_s + 1e-9
            fetched += 1
            soon_s = URGENT_S + 3 * took_s + length_s
            most = max(1 / (1 + REST_SHARE), share / GROWTH_SHARE)
            assert took_s * fetched <= share * (played_s + soon_s) + most * now_s
        else:
            now_s += 0.01 * length_s
