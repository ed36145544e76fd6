"""The browser reads sound as the package does; player/web/test/sound.test.mjs plays it."""

from __future__ import annotations

import io
import itertools
import random
from typing import Any

import av
import numpy as np
import pytest

from codec.errors import CodecError
from codec.stream.reader import StreamReader
from codec.stream.sound import SAMPLE_RATE, SoundObject, SoundSource, first_sample, packet_samples
from codec.tracks.soundfile import decode
from codec.tracks.streamtracks import read_sound
from tests.support.web.browsercode import BrowserCode
from tests.support.web.clicks import write_clicking_stream

NUM_FRAMES = 45
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


@pytest.mark.parametrize("fps", [23.976, 24, 29.97, 30, 60, 1000])
def test_segments_have_the_samples_that_they_have_in_the_package(
    browser: BrowserCode, fps: float
) -> None:
    for segment_frames in (1, 7, 300):
        found = browser.ask("spans", fps=fps, segmentFrames=segment_frames, numSegments=50)
        edges = [first_sample(n * segment_frames, fps) for n in range(51)]
        assert found == [list(span) for span in itertools.pairwise(edges)]
