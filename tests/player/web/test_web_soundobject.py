"""The browser's reader of sound: objects, sources, pieces, files for the decoder, other speeds."""

from __future__ import annotations

import io
import itertools
import random
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.errors import CodecError
from codec.stream.reader import StreamReader
from codec.stream.sound import SAMPLE_RATE, SoundObject, SoundSource, first_sample, packet_samples
from codec.tools.soundfile import decode
from codec.tools.streamsound import read_sound
from tests.support.web.browsercode import BrowserCode
from tests.support.web.clicks import write_clicking_stream

NUM_FRAMES = 45
REST_SHARE, GROWTH_SHARE, URGENT_MS = 4, 0.8, 300
SOURCES = (SoundSource("main", 2), SoundSource("voice", 1, ((0.0, 1.0, 2.0, 3.0),)))


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> StreamReader:
    folder = tmp_path_factory.mktemp("clicking")
    write_clicking_stream(folder, NUM_FRAMES, *SOURCES)
    return StreamReader(folder / "trained")


def test_objects_are_read_as_in_the_package(browser: BrowserCode, reader: StreamReader) -> None:
    frames = [*(record.first_frame for record in reader.records), NUM_FRAMES]
    edges = [first_sample(frame, reader.manifest.fps) for frame in frames]
    for source in SOURCES:
        for segment in range(len(reader.records)):
            found = read_sound(reader, segment, source)
            span = edges[segment : segment + 2]
            question = {"bytes": found.pack().hex(), "channels": source.channels}
            said = browser.ask("sound", **question, span=span)
            ends = itertools.accumulate(map(packet_samples, found.packets), initial=found.first)
            assert said == {
                "preSkip": found.pre_skip,
                "numSamples": found.num_samples,
                "positions": list(ends),
                "packets": [packet.hex() for packet in found.packets],
            }


def test_damaged_objects_are_refused_as_in_the_package(
    browser: BrowserCode, reader: StreamReader
) -> None:
    rng = random.Random(5)
    whole = read_sound(reader, 1, SOURCES[0])
    data = whole.pack()
    cases = [data[:cut] for cut in (0, 3, 35, 36, 40, len(data) - 1)] + [data + b"\0"]
    for _ in range(300):
        damaged = bytearray(data)
        damaged[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        cases.append(bytes(damaged))
    for _ in range(100):  # with a correct checksum
        packets = tuple(rng.randbytes(rng.randint(1, 3)) for _ in range(3))
        try:
            cases.append(SoundObject(2, whole.pre_skip, 9, 0, packets).pack())
        except CodecError:
            continue
    for case in cases:
        try:
            SoundObject.parse(case)
            is_taken = case[12] == 2
        except CodecError:
            is_taken = False
        assert browser.takes("sound", bytes=case.hex(), channels=2) == is_taken


def test_packets_far_from_their_segment_are_refused(browser: BrowserCode) -> None:
    """An object of 16 MB could hold an hour of sound, more than any segment."""
    packets = (b"\xf8\0",) * 3000  # of 20 ms
    data = SoundObject(1, 312, 60 * SAMPLE_RATE, 0, packets).pack().hex()

    def is_taken(*span_s: int) -> bool:
        span = [second * SAMPLE_RATE for second in span_s]
        return browser.takes("sound", bytes=data, channels=1, span=span)

    assert is_taken(0, 60)
    assert is_taken(0, 59)
    assert not is_taken(0, 58)
    assert not is_taken(10, 60)


def test_a_seek_aborts_what_is_no_longer_wanted(browser: BrowserCode) -> None:
    wants = [[0, False], [0, False], [1, False], [50, False], [50, True], [70, True]]
    assert browser.ask("wanted", wants=wants) == [
        {"asked": [0, 1], "aborted": []},
        {"asked": [], "aborted": []},
        {"asked": [2], "aborted": [0]},
        {"asked": [50, 51], "aborted": [1, 2]},
        {"asked": [], "aborted": []},
        {"asked": [70], "aborted": [50, 51]},
        {"asked": [], "aborted": [70]},
    ]


def test_sources_are_read_as_in_the_package(browser: BrowserCode) -> None:
    good = [source.to_json() for source in SOURCES]
    assert [found["part"] for found in browser.ask("sources", sound=good)] == [
        source.part for source in SOURCES
    ]
    bad: list[Any] = [
        {"main": good[0]},
        [good[0], good[0]],
        [{**good[0], "name": "A"}],
        [{**good[0], "channels": 3}],
        [{**good[1], "channels": 2}],
        [{**good[0], "channels": 1, "keys": [[0, 1, 2]]}],
        [{**good[0], "channels": 1, "keys": [[1, 0, 0, 0], [1, 0, 0, 0]]}],
        [{**good[0], "channels": 1, "keys": [["0", 0, 0, 0]]}],
        [{"name": "main"}],
        [{**good[0], "name": str(n)} for n in range(17)],
        7,
        "main",
    ]
    for case in bad:
        assert not browser.takes("sources", sound=case), case


def test_a_source_moves_as_in_the_package(browser: BrowserCode) -> None:
    keys = ((0.5, 0.0, 1.0, 2.0), (1.5, 4.0, 1.0, -2.0), (4.0, 0.0, 0.0, 0.0))
    source = SoundSource("steps", 1, keys)
    for time_s in (0.0, 0.5, 0.7, 1.5, 3.9, 4.0, 9.0):
        assert browser.ask("place", keys=keys, timeS=time_s) == pytest.approx(
            source.position_m(time_s)
        )


def test_places_without_bounds_are_finite_to_a_device(browser: BrowserCode) -> None:
    most = 1e308
    w2c = [0.0, 1.0, 0.0, 5.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, -2.0, 0.0, 0.0, 0.0, 1.0]
    for keys in (
        [[0, 1e39, -1e39, 0]],
        [[0, most, -most, most], [1, -most, most, -most]],
        [[-most, 1, 2, 3], [most, 4, 5, 6]],
    ):
        for time_s in (0, 0.25, 0.5, 2):
            heard = browser.ask("heard", keys=keys, timeS=time_s, w2c=w2c)
            assert np.isfinite(np.asarray(heard, np.float32)).all()
    assert browser.ask("heard", keys=[[0, 1, 2, 3]], timeS=0, w2c=w2c) == [7, 1, -1]


@settings(max_examples=60, deadline=None)
@given(
    fps=st.sampled_from([23.976, 24, 29.97, 30, 60, 1000]),
    segment_frames=st.integers(1, 300),
    num_frames=st.integers(1, 2000),
    live=st.booleans(),
    data=st.data(),
)
def test_pieces_cover_the_stream_once(
    browser: BrowserCode,
    fps: float,
    segment_frames: int,
    num_frames: int,
    live: bool,
    data: st.DataObject,
) -> None:
    """A live stream counts with its whole segments only, because the last one may grow."""
    question = {"fps": fps, "segmentFrames": segment_frames, "numFrames": num_frames, "live": live}
    if live:
        num_frames -= num_frames % segment_frames
    length = first_sample(num_frames, fps)
    begin = data.draw(st.integers(0, max(0, length - 1)))
    found = browser.ask("pieces", **question, sample=begin, count=length, loops=False)
    assert found["length"] == length
    pieces = found["pieces"]
    if length == 0 or len(pieces) == 1000:
        return
    assert pieces[0]["begin"] <= begin < pieces[0]["end"]
    assert all(a["end"] == b["begin"] for a, b in itertools.pairwise(pieces))
    assert pieces[-1]["end"] == length
    for piece in pieces:
        first = piece["segment"] * segment_frames
        assert first_sample(first, fps) <= piece["begin"]
        assert piece["end"] <= first_sample(min(num_frames, first + segment_frames), fps)
        assert piece["end"] - piece["begin"] <= 2 * SAMPLE_RATE


def test_a_decoder_of_files_gives_all_samples(browser: BrowserCode, reader: StreamReader) -> None:
    """The file of the packets decodes to the same samples as the packets: none is skipped."""
    for source in SOURCES:
        found = read_sound(reader, 2, source)
        ends = list(itertools.accumulate(map(packet_samples, found.packets)))
        packets = [packet.hex() for packet in found.packets]
        question = {"packets": packets, "ends": ends, "channels": source.channels}
        file = bytes.fromhex(browser.ask("ogg", **question))
        expected = np.concatenate(list(decode(found.packets, source.channels)))
        with av.open(io.BytesIO(file), "r") as container:
            stream = container.streams.audio[0]
            assert (stream.codec.name, stream.channels) == ("opus", source.channels)
            frames = [frame.to_ndarray() for frame in container.decode(stream)]
        heard = np.concatenate(frames, axis=1)
        if heard.shape[0] == 1 and source.channels == 2:
            heard = heard.reshape(-1, 2).T
        assert heard.shape[1] == ends[-1] == len(expected)
        assert np.abs(heard.T * 32768 - expected).max() <= 2


def pitch_hz(samples: np.ndarray) -> float:
    """The frequency of the loudest tone, Hz."""
    spectrum = np.abs(np.fft.rfft(samples * np.hanning(len(samples))))
    return float(np.argmax(spectrum)) * SAMPLE_RATE / len(samples)


@pytest.mark.parametrize("rate", [0.25, 0.5, 0.75, 1.25, 1.5, 2.0])
def test_another_speed_keeps_the_pitch(browser: BrowserCode, rate: float) -> None:
    count = 24000
    tone = 0.5 * np.sin(2 * np.pi * 440 * np.arange(count) / SAMPLE_RATE)
    length = round(count / rate)
    channels = [tone.tolist(), (-tone).tolist()]
    left, right = map(np.asarray, browser.ask("stretched", channels=channels, length=length))
    assert len(left) == len(right) == length
    assert pitch_hz(left) == pytest.approx(440, abs=2 * SAMPLE_RATE / length)
    assert np.array_equal(right, -left), "both channels move together"
    # It joins the samples before and after it without steps.
    steps = np.abs(np.diff(left))
    assert steps.max() <= 1.2 * np.abs(np.diff(tone)).max()
    assert left[:500] == pytest.approx(tone[:500], abs=1e-6)
    assert left[-3:] == pytest.approx(tone[-3:], abs=1e-3)


@pytest.mark.parametrize("rate", [0.25, 0.7, 1.0, 1.9])
def test_another_speed_is_made_in_parts(browser: BrowserCode, rate: float) -> None:
    """A step makes at most half a second, so that the page stays responsive; nothing is omitted."""
    found = browser.ask("handed", rate=rate, steps=100)
    parts = [tuple(part) for step in found["all"] for part in step]
    assert found["gaps"] == 0
    assert all(at + length == after for (at, length), (after, _) in itertools.pairwise(parts))
    assert sum(parts[-1]) >= 10.8 * SAMPLE_RATE
    if rate != 1:
        assert max(length for _, length in parts) <= 0.38 * SAMPLE_RATE
        assert max(sum(n for _, n in step) for step in found["all"]) <= 0.63 * SAMPLE_RATE


@settings(max_examples=30, deadline=None)
@given(count=st.integers(1, 9000), rate=st.floats(0.25, 2))
def test_any_piece_is_stretched(browser: BrowserCode, count: int, rate: float) -> None:
    length = max(1, round(count / rate))
    noise = np.random.default_rng(count).uniform(-1, 1, count).astype(np.float32)
    [made] = browser.ask("stretched", channels=[noise.tolist()], length=length)
    assert len(made) == length
    assert np.abs(made).max() <= 1.0001


def test_a_folder_of_clicks_is_what_it_says(tmp_path: Path) -> None:
    static = write_clicking_stream(tmp_path, 20, SOURCES[0])
    assert (static / "segments/0/audio-main").is_file()


@given(st.floats(1, 2000), st.floats(500, 10000), st.floats(0.02, 0.3))
@settings(max_examples=60, deadline=None)
def test_sound_is_in_time_and_leaves_the_link_to_the_pictures(
    browser: BrowserCode, length_ms: float, ahead_ms: float, share: float
) -> None:
    """Each segment of `length_ms` takes `share` of it to fetch. None is late, and segments that are
    not heard soon take a small part of the time."""
    took_ms = share * length_ms
    question = {"lengthMs": length_ms, "aheadMs": ahead_ms, "tookMs": took_ms, "rounds": 60}
    for fetched, (_, came_ms, due_ms) in enumerate(browser.ask("paced", **question), 1):
        assert came_ms <= due_ms + 1e-6
        soon_ms = URGENT_MS + 3 * took_ms + length_ms
        most = max(1 / (1 + REST_SHARE), share / GROWTH_SHARE)
        heard_ms = max(0.0, came_ms - took_ms)
        assert took_ms * fetched <= share * (heard_ms + soon_ms) + most * came_ms + 1e-6


@given(st.floats(0.01, 0.7))
@settings(max_examples=20, deadline=None)
def test_the_lead_of_sound_grows(browser: BrowserCode, share: float) -> None:
    """This holds for any share of its length that a segment takes, e.g. because of latency."""
    question = {"lengthMs": 500, "aheadMs": 15000, "tookMs": 500 * share, "rounds": 200}
    *_, (_, came_ms, due_ms) = browser.ask("paced", **question)
    assert due_ms - came_ms > 13000
