"""The choice of traces, the stream and the link of a case, and its plays."""

from __future__ import annotations

import json
import random
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import InvalidError
from codec.stream import StreamReader, StreamWriter
from server.abr.link import Link, LinkStep
from server.abr.media import segment_sizes
from server.study.config import Rules
from server.study.generate import GeneratorConfig, generate
from server.study.looped import LoopedMedia, open_media
from server.study.study import LOAD_WINDOW, at_load, run_play
from server.study.tracefolder import Trace, chosen_names, generated_traces, read_traces
from tests.support.delivery.media import basketball_media
from tests.support.hostile import refused
from tests.support.slots.folder import slots_manifest, write_slots
from tests.support.slots.updates import patternless_updates

MEDIA = LoopedMedia((basketball_media().sizes(0),), 300, 30.0, 30)
names = st.lists(
    st.sampled_from(["", "a/", "a/b/", "c/"]).flatmap(
        lambda folder: st.integers(0, 99).map(lambda number: f"{folder}{number:02d}")
    ),
    unique=True,
    max_size=40,
)


@given(found=names)
def test_the_halves_share_nothing_and_are_all(found: list[str]) -> None:
    tune, report = chosen_names(found, "tune", 0), chosen_names(found, "report", 0)
    assert not set(tune) & set(report)
    assert sorted(tune + report) == sorted(found)
    assert sorted(chosen_names(found, "all", 0)) == sorted(found)


@given(found=names, order=st.randoms(use_true_random=False))
def test_which_are_taken_goes_by_their_names_alone(found: list[str], order: random.Random) -> None:
    shuffled = list(found)
    order.shuffle(shuffled)
    for half in ("all", "tune", "report"):
        assert chosen_names(shuffled, half, 3) == chosen_names(found, half, 3)


def test_halves_alternate_in_each_folder_and_a_few_are_spread_over_it() -> None:
    found = ["b/1", "a/2", "a/1", "a/3", "b/2"]
    assert chosen_names(found, "tune", 0) == ["a/1", "a/3", "b/1"]
    assert chosen_names(found, "report", 0) == ["a/2", "b/2"]
    found = [f"a/{n}" for n in range(9)] + ["b/0"]
    assert chosen_names(found, "all", 3) == ["a/0", "a/3", "a/6", "b/0"]


def test_traces_of_all_kinds_are_found_and_named(tmp_path: Path) -> None:
    (tmp_path / "lte" / "deep").mkdir(parents=True)
    steps = [{"duration_ms": 500, "bandwidth_kbps": 2000, "latency_ms": 30}]
    (tmp_path / "lte" / "deep" / "one.json").write_text(json.dumps(steps))
    (tmp_path / "lte" / "two").write_text("0\n10\n20\n")
    (tmp_path / "README.md").write_text("of whom these are")
    (tmp_path / ".hidden").write_text("?")
    traces = read_traces(tmp_path, "all", 0, latency_s=0.07)
    assert [trace.name for trace in traces] == ["lte/two", "lte/deep/one.json"]
    assert traces[0].link.at(0.0).latency_s == 0.07
    assert traces[1].link.steps == (LinkStep(0.5, 2e6, 0.03),)


def test_a_folder_without_traces_is_refused(tmp_path: Path) -> None:
    refused(InvalidError, "holds no traces", read_traces, tmp_path, "all", 0, 0.0)
    refused(InvalidError, "not a folder", read_traces, tmp_path / "absent", "all", 0, 0.0)
    (tmp_path / "only").write_text("0\n10\n")
    refused(InvalidError, "'report'", read_traces, tmp_path, "report", 0, 0.0)
    (tmp_path / "wrong").write_text("quite")
    refused(InvalidError, "wrong", read_traces, tmp_path, "all", 0, 0.0)
    (tmp_path / "a\nb").write_text("0\n10\n")
    refused(InvalidError, "rename it", read_traces, tmp_path, "all", 0, 0.0)


def test_made_up_traces_are_those_of_their_seeds() -> None:
    config = GeneratorConfig()
    traces = generated_traces(range(10, 14), config, "report", 0, 0.05)
    assert [trace.name for trace in traces] == ["generated/000011", "generated/000013"]
    links = [generate(config, n, 0.05) for n in (11, 13)]
    assert [trace.link.steps for trace in traces] == [link.steps for link in links]


def link_of(*steps: tuple[float, float]) -> Link:
    return Link([LinkStep(duration_s, rate_bps, 0.02) for duration_s, rate_bps in steps])


@given(rates=st.lists(st.floats(1e3, 1e8), min_size=1, max_size=8), load=st.floats(0.1, 10))
def test_a_load_is_the_mean_over_what_is_needed(rates: list[float], load: float) -> None:
    trace = Trace("t", link_of(*((7.0, rate) for rate in rates)))
    link = at_load(trace, load, MEDIA).link
    window_s = min(link.round_s, LOAD_WINDOW * 10)
    carried_bps = 8 * link.capacity_bytes(0, window_s) / window_s
    assert carried_bps == pytest.approx(load * MEDIA.need_bps)
    # Only rates are scaled.
    ratios = [new.rate_bps / old for new, old in zip(link.steps, rates, strict=True)]
    assert ratios == pytest.approx([ratios[0]] * len(ratios))
    assert {(step.duration_s, step.latency_s) for step in link.steps} == {(7.0, 0.02)}


def test_a_silent_trace_and_a_load_out_of_reach_are_refused() -> None:
    silent = Trace("silent.json", link_of((60, 0), (1, 1e6)))
    with pytest.raises(InvalidError, match=r"silent\.json: no data passes in its first 15 s"):
        at_load(silent, 1.0, MEDIA)
    refused(InvalidError, "load is 0", at_load, Trace("t", link_of((9, 1e6))), 0.0, MEDIA)


def test_a_play_that_does_not_end_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("server.study.study.MOST_S", 4.0)
    case = at_load(Trace("uneven", link_of((9, 1e6), (3, 2e5))), 0.5, MEDIA)
    with pytest.raises(InvalidError, match=r"trace uneven at load 0\.5: bola has shown"):
        run_play(MEDIA, case, "bola", Rules())


def test_a_policy_that_fails_is_told(tmp_path: Path) -> None:
    file = tmp_path / "failing.py"
    file.write_text(
        "from server.study.policies import Rule\n"
        "class Failing(Rule):\n"
        "    def choose_layers(self, situation): return 1 // 0\n"
    )
    case = at_load(Trace("even", link_of((9, 1e6))), 0.5, MEDIA)
    with pytest.raises(InvalidError, match=r"failing\.py:Failing: ZeroDivisionError: integer"):
        run_play(MEDIA, case, f"{file}:Failing", Rules())


FRAMES, FPS, SEGMENT = 14, 25.0, 4


@pytest.fixture(scope="module")
def stream(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A stream with three segments of 4 frames and one of 2."""
    path = tmp_path_factory.mktemp("looped") / "stream"
    write_slots(path, FRAMES)
    return path


def test_what_is_not_longer_than_the_stream_is_the_stream(stream: Path) -> None:
    media = open_media(stream, FRAMES / FPS)
    reader = StreamReader(stream)
    assert media.num_frames == FRAMES
    assert (media.fps, media.num_layers) == (FPS, 2)
    for birth in range(FRAMES):
        record = reader.records[reader.manifest.segment_of(birth)]
        assert media.sizes(birth) == segment_sizes(record, reader.manifest)


def test_a_longer_play_repeats_the_whole_segments(stream: Path) -> None:
    media = open_media(stream, 100 / FPS)
    assert media.num_frames == 100
    assert len(media.segments) == 3
    for birth in range(100):
        assert media.sizes(birth) is media.segments[birth // SEGMENT % 3]


def test_a_stream_of_less_than_a_segment_is_repeated_as_it_is(tmp_path: Path) -> None:
    write_slots(tmp_path / "short", 3)
    media = open_media(tmp_path / "short", 1.0)
    assert (media.segment_frames, media.num_frames) == (3, 25)
    assert media.sizes(24) is media.segments[0]


def test_what_it_needs_is_bytes_over_time(stream: Path) -> None:
    media = open_media(stream, 48 / FPS)
    slices_bytes = [sum(media.sizes(frame).layer_bytes) for frame in range(48)]
    assert media.need_bps == pytest.approx(8 * sum(slices_bytes) / (48 / FPS))


def test_a_stream_without_frames_is_refused(tmp_path: Path) -> None:
    manifest = slots_manifest()
    update, *_ = patternless_updates(manifest.slot_layout, 1)
    with StreamWriter.create(tmp_path / "live", manifest) as writer:
        writer.append(update)
        refused(InvalidError, "no frames yet", open_media, tmp_path / "live", 1.0)
