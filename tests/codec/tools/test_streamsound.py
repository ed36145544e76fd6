"""Sound added to real streams, by the commands and by hand."""

from __future__ import annotations

import wave
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from codec.errors import CodecError, CorruptError
from codec.stream import StreamReader, StreamWriter
from codec.stream.sound import (
    SAMPLE_RATE,
    SoundObject,
    SoundSource,
    first_sample,
    segment_sound,
)
from codec.tools.audit import verify_stream
from codec.tools.cutting import join
from codec.tools.packing import pack_stream
from codec.tools.soundfile import Samples, decode, encode, read_samples
from codec.tools.static import export_static
from codec.tools.streamsound import read_sound, samples
from tests.support.commands import run, run_ok
from tests.support.sounding import add_clicks, best_shift, heard, write_clicks
from tests.support.tiny_stream import append_tiny, files_of, tiny_manifest, tiny_slice, write_tiny

CLICKS = (0, 4000, 9600, 14400)


@pytest.fixture
def stream(tmp_path: Path) -> Path:
    path = tmp_path / "s"
    write_tiny(path, 10)
    return path


def test_add_extract_and_remove(stream: Path, tmp_path: Path) -> None:
    before = files_of(stream)
    fps = StreamReader(stream).manifest.fps
    length = first_sample(10, fps)
    write_clicks(tmp_path / "in.wav", length + 5000, CLICKS)
    run_ok("swings-stream", "audio", "add", stream, tmp_path / "in.wav")
    run_ok("swings-stream", "verify", stream)
    run_ok("swings-stream", "audio", "extract", stream, tmp_path / "out.wav")
    with wave.open(str(tmp_path / "out.wav")) as file:
        assert (file.getnchannels(), file.getnframes()) == (2, length)
        heard = np.frombuffer(file.readframes(length), "<i2").reshape(-1, 2)
    with wave.open(str(tmp_path / "in.wav")) as file:
        given = np.frombuffer(file.readframes(length), "<i2").reshape(-1, 2)
    assert best_shift(given[:, 0], heard[:, 0], 30) == 0
    run_ok("swings-stream", "audio", "remove", stream)
    assert files_of(stream) == before


def test_a_segment_decodes_by_itself(stream: Path, tmp_path: Path) -> None:
    write_clicks(tmp_path / "in.wav", 40000, CLICKS)
    run_ok("swings-stream", "audio", "add", stream, tmp_path / "in.wav", "--at-m", "0", "1", "2")
    reader = StreamReader(stream)
    (source,) = reader.manifest.sound
    assert source == SoundSource("main", 1, ((0.0, 0.0, 1.0, 2.0),))
    whole = np.concatenate(list(samples(reader, source))).astype(float)
    found = read_sound(reader, 1, source)
    alone = np.concatenate(list(decode(found.packets, 1))).astype(float)
    begin = first_sample(reader.records[1].first_frame, reader.manifest.fps)
    from_begin = alone[begin + found.pre_skip - found.first :]
    count = min(len(from_begin), len(whole) - begin)
    assert count > 1000
    error = from_begin[:count] - whole[begin : begin + count]
    assert np.sqrt(np.mean(error**2)) < 0.05 * np.sqrt(np.mean(whole**2)) + 1


def test_several_sources_of_other_formats(stream: Path, tmp_path: Path) -> None:
    write_clicks(tmp_path / "music.wav", 9000, CLICKS)
    with av.open(str(tmp_path / "voice.flac"), "w") as out:
        track = out.add_stream("flac", rate=44100)
        frame = av.AudioFrame.from_ndarray(np.full((1, 2 * 8192), 900, np.int16), "s16", "stereo")
        frame.sample_rate = 44100
        out.mux([*track.encode(frame), *track.encode(None)])
    run_ok("swings-stream", "audio", "add", stream, tmp_path / "music.wav")
    voice = ("--name", "voice", "--at-m", "0", "1", "2")
    run_ok("swings-stream", "audio", "add", stream, tmp_path / "voice.flac", *voice)
    verify_stream(stream)
    reader = StreamReader(stream)
    assert [source.name for source in reader.manifest.sound] == ["main", "voice"]
    heard = np.concatenate(list(samples(reader, reader.manifest.sound[1])))
    assert abs(len(heard) - 8192 * SAMPLE_RATE / 44100) <= 2
    run_ok("swings-stream", "audio", "remove", stream)
    assert [source.name for source in StreamReader(stream).manifest.sound] == ["voice"]


def test_static_export_and_one_file_carry_it(stream: Path, tmp_path: Path) -> None:
    write_clicks(tmp_path / "in.wav", 9000, CLICKS)
    run_ok("swings-stream", "audio", "add", stream, tmp_path / "in.wav")
    export_static(stream, tmp_path / "static")
    verify_stream(tmp_path / "static")
    for n in range(3):
        name = f"segments/{n}/audio-main"
        assert (tmp_path / "static" / name).read_bytes() == (stream / name).read_bytes()
    pack_stream(stream, tmp_path / "s.swings")
    verify_stream(tmp_path / "s.swings")
    for place in (stream, tmp_path / "s.swings"):
        run_ok("swings-stream", "audio", "extract", place, tmp_path / f"{place.name}.wav")
    assert (tmp_path / "s.wav").read_bytes() == (tmp_path / "s.swings.wav").read_bytes()
    (stream / "segments" / "1" / "audio-main").write_bytes(b"SWA1")
    with pytest.raises(CorruptError, match="segments/1/audio-main: byte 0: sound"):
        pack_stream(stream, tmp_path / "s.swings")


def test_any_changed_byte_is_found(stream: Path, tmp_path: Path) -> None:
    write_clicks(tmp_path / "in.wav", 9000, CLICKS)
    run_ok("swings-stream", "audio", "add", stream, tmp_path / "in.wav")
    path = stream / "segments" / "1" / "audio-main"
    data = path.read_bytes()
    for at in range(0, len(data), 7):
        with pytest.raises(CodecError):
            SoundObject.parse(data[:at] + bytes([data[at] ^ 0x55]) + data[at + 1 :])
        with pytest.raises(CodecError):
            SoundObject.parse(data[:at])
    path.write_bytes(data[:-1])
    with pytest.raises(CorruptError, match="audio-main"):
        verify_stream(stream)


def played(path: Path, codec: str, video: bool, late_s: float = 0.0) -> None:
    """Writes a file of half a second with a stereo tone of 1 kHz from 100 ms on. late_s: time of
    the sound's first sample."""
    tone = (12000 * np.sin(np.arange(24000) * 2 * np.pi / 48)).astype(np.int16)
    tone[:4800] = 0
    with av.open(str(path), "w") as out:
        picture = out.add_stream("mpeg4", rate=25) if video else None
        track: Any = out.add_stream(codec, rate=SAMPLE_RATE, layout="stereo")
        if picture is not None:
            picture.width, picture.height, picture.pix_fmt = 32, 32, "yuv420p"
            for _ in range(12):
                image = av.VideoFrame.from_ndarray(np.zeros((32, 32, 3), np.uint8), "rgb24")
                out.mux(picture.encode(image))
            out.mux(picture.encode(None))
        frame = av.AudioFrame.from_ndarray(np.repeat(tone, 2)[None], "s16", "stereo")
        frame.sample_rate, frame.pts = SAMPLE_RATE, round(late_s * SAMPLE_RATE)
        frame.time_base = Fraction(1, SAMPLE_RATE)
        fitted = av.AudioResampler(track.format, "stereo", SAMPLE_RATE, track.frame_size or 960)
        for piece in [*fitted.resample(frame), *fitted.resample(None)]:
            out.mux(track.encode(piece))
        out.mux(track.encode(None))


def test_a_file_without_sound_is_refused_in_plain_words(stream: Path, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("no sound")
    told = run("swings-stream", "audio", "add", stream, tmp_path / "notes.txt")
    assert told.returncode == 1
    assert told.stderr.splitlines() == [
        f"swings-stream: {tmp_path}/notes.txt: its sound cannot be read: Invalid data found when "
        "processing input; give WAV, FLAC, Opus, or a video with sound"
    ]


@pytest.mark.parametrize(
    ("name", "codec"),
    [("a.opus", "libopus"), ("a.mp4", "aac"), ("a.mkv", "libopus"), ("a.ogg", "flac")],
)
def test_opus_and_videos_keep_their_time(
    stream: Path, tmp_path: Path, name: str, codec: str
) -> None:
    played(tmp_path / name, codec, name.endswith(("mp4", "mkv")))
    run_ok("swings-stream", "audio", "add", stream, tmp_path / name)
    heard = heard_of(stream)
    loud = np.flatnonzero(np.abs(heard.astype(int)) > 6000)
    assert abs(int(loud[0]) - 4800) < 240  # 5 ms
    assert np.abs(heard[6000:14000].astype(int)).max() > 9000


def heard_of(stream: Path) -> Samples:
    """The first channel of the sound called main."""
    reader = StreamReader(stream)
    return np.concatenate(list(samples(reader, reader.manifest.sound[0])))[:, 0]


def test_sound_that_begins_after_the_pictures_is_late(stream: Path, tmp_path: Path) -> None:
    played(tmp_path / "a.mkv", "flac", True, late_s=0.08)
    run_ok("swings-stream", "audio", "add", stream, tmp_path / "a.mkv")
    loud = np.flatnonzero(np.abs(heard_of(stream).astype(int)) > 6000)
    assert abs(int(loud[0]) - 4800 - 3840) < 240


@pytest.mark.parametrize("offset_s", [0.05, -0.05])
def test_an_offset_moves_the_sound(stream: Path, tmp_path: Path, offset_s: float) -> None:
    played(tmp_path / "a.ogg", "flac", False)
    add = ("swings-stream", "audio", "add", stream, tmp_path / "a.ogg")
    run_ok(*add)
    usual = heard_of(stream)
    run_ok("swings-stream", "audio", "remove", stream)
    run_ok(*add, f"--offset-s={offset_s}")
    moved = heard_of(stream)
    begins = [int(np.flatnonzero(np.abs(x.astype(int)) > 6000)[0]) for x in (usual, moved)]
    assert abs(begins[1] - begins[0] - round(offset_s * SAMPLE_RATE)) < 30


def test_a_source_moves_along_the_places_of_a_file(stream: Path, tmp_path: Path) -> None:
    write_clicks(tmp_path / "in.wav", 9000, CLICKS)
    path = tmp_path / "path.json"
    path.write_text("[[0, 0, 1, 0], [2.5, 4, 1, 0]]")
    add = ("swings-stream", "audio", "add", stream, tmp_path / "in.wav", "--path", path)
    run_ok(*add)
    (source,) = StreamReader(stream).manifest.sound
    assert source == SoundSource("main", 1, ((0.0, 0.0, 1.0, 0.0), (2.5, 4.0, 1.0, 0.0)))
    assert source.position_m(1.25) == (2.0, 1.0, 0.0)
    before = files_of(stream)
    for wrong in ("[]", "{", "[[0, 1, 2]]", '[["a", 0, 0, 0]]', "[[1, 0, 0, 0], [0, 0, 0, 0]]"):
        path.write_text(wrong)
        done = run(*add, "--name", "other")
        assert (done.returncode, done.stderr.count("\n")) == (1, 1), done.stderr
    path.write_text("[[0, 0, 0, 0]]")
    done = run(*add, "--name", "other", "--at-m", "0", "0", "0")
    assert done.returncode == 1
    assert "not both" in done.stderr
    assert files_of(stream) == before


def test_a_live_stream_has_sound_as_far_as_it_goes(tmp_path: Path) -> None:
    path, fps = tmp_path / "s", tiny_manifest().fps
    write_clicks(tmp_path / "in.wav", 40000, CLICKS)
    whole = encode(read_samples(tmp_path / "in.wav", 2), 2, first_sample(10, fps), 96000)

    def objects(first_frame: int, end_frame: int) -> dict[str, bytes]:
        begin, stop = first_sample(first_frame, fps), first_sample(end_frame, fps)
        return {"audio-main": segment_sound(whole, begin, stop).pack()}

    manifest = replace(tiny_manifest(), sound=(SoundSource("main", 2),))
    writer = StreamWriter.create(path, manifest)
    for birth in range(manifest.first_birth, 10):
        if birth == 9:  # two segments are written; the third is lost
            writer.abort()
            reader = StreamReader(path)
            assert (reader.manifest.live, reader.num_frames) == (True, 8)
            (source,) = reader.manifest.sound
            assert sum(map(len, samples(reader, source))) == first_sample(8, fps)
            verify_stream(path)
            writer = StreamWriter.resume(path)
        writer.sound = objects
        for missing in range(writer.next_birth, birth + 1):
            writer.append(tiny_slice(missing))
    writer.close()
    verify_stream(path)
    write_tiny(tmp_path / "plain", 10)
    run_ok("swings-stream", "audio", "add", tmp_path / "plain", tmp_path / "in.wav")
    for name in ("manifest.json", *(f"segments/{n}/audio-main" for n in range(3))):
        assert (path / name).read_bytes() == (tmp_path / "plain" / name).read_bytes()


def test_edits_of_all_frames_keep_the_sound(stream: Path, tmp_path: Path) -> None:
    write_clicks(tmp_path / "in.wav", 16000, CLICKS)
    add = ("swings-stream", "audio", "add", stream, tmp_path / "in.wav")
    run_ok(*add)
    run_ok(*add, "--name", "voice", "--at-m", "0", "1", "2")
    edit = ("swings-stream", "edit")
    run_ok(*edit, "colour", stream, tmp_path / "c", "--exposure", "0.5")
    run_ok(*edit, "transform", stream, tmp_path / "t", "--move", "1", "0", "0", "--scale", "2")
    for name in ("c", "t"):
        verify_stream(tmp_path / name)
        for n in range(3):
            for part in (f"segments/{n}/audio-main", f"segments/{n}/audio-voice"):
                assert (tmp_path / name / part).read_bytes() == (stream / part).read_bytes()
    main, voice = StreamReader(tmp_path / "t").manifest.sound
    assert main == SoundSource("main", 2)
    np.testing.assert_allclose(voice.keys, [(0.0, 1.0, 2.0, 4.0)], atol=0.01)


@pytest.mark.parametrize("first", [3, 4])
def test_trimmed_and_joined_streams_keep_the_sound(
    stream: Path, tmp_path: Path, first: int
) -> None:
    write_clicks(tmp_path / "in.wav", 16000, CLICKS)
    run_ok("swings-stream", "audio", "add", stream, tmp_path / "in.wav")
    fps = StreamReader(stream).manifest.fps
    cut, both = tmp_path / "cut", tmp_path / "both"
    run_ok("swings-stream", "edit", "trim", stream, cut, "--frames", f"{first}:9")
    run_ok("swings-stream", "edit", "join", stream, both, "--then", stream)
    verify_stream(cut)
    verify_stream(both)
    whole = heard(stream)
    begin, stop = first_sample(first, fps), first_sample(9, fps)
    assert len(heard(cut)) == first_sample(9 - first, fps)
    count = min(stop - begin, len(heard(cut)))
    assert best_shift(whole[begin : begin + count], heard(cut)[:count], 30) == 0
    assert len(heard(both)) == first_sample(20, fps)
    half = first_sample(10, fps)
    again = heard(both)[half : half + len(whole)]
    assert best_shift(whole[: len(again)], again, 30) == 0


def test_a_joined_source_that_moves_is_left_out_and_named(stream: Path, tmp_path: Path) -> None:
    write_clicks(tmp_path / "in.wav", 16000, CLICKS)
    (tmp_path / "path.json").write_text("[[0, 0, 1, 2], [0.2, 4, 1, 2]]")
    add = ("swings-stream", "audio", "add", stream, tmp_path / "in.wav")
    run_ok(*add, "--name", "steps", "--path", tmp_path / "path.json")
    said = run_ok("swings-stream", "edit", "join", stream, tmp_path / "j", "--then", stream)
    assert "left out: steps" in said
    assert not StreamReader(tmp_path / "j").manifest.sound
    run_ok("swings-stream", "edit", "trim", stream, tmp_path / "t", "--frames", "3:9")
    (steps,) = StreamReader(tmp_path / "t").manifest.sound
    assert steps.keys[1][0] == pytest.approx(0.2 - 3 / StreamReader(stream).manifest.fps)


def test_sound_that_cannot_be_cut_leaves_no_stream(stream: Path, tmp_path: Path) -> None:
    write_clicks(tmp_path / "in.wav", 16000, CLICKS)
    run_ok("swings-stream", "audio", "add", stream, tmp_path / "in.wav")
    path = stream / "segments" / "1" / "audio-main"
    data = path.read_bytes()
    path.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    out, before = tmp_path / "out", sorted(tmp_path.iterdir())
    for edit in (["trim", stream, out, "--frames", "3:9"], ["join", stream, out, "--then", stream]):
        done = run("swings-stream", "edit", *edit)
        assert (done.returncode, done.stdout, done.stderr.count("\n")) == (1, "", 1)
        assert "segments/1/audio-main" in done.stderr
        assert sorted(tmp_path.iterdir()) == before


def test_a_stream_that_grows_while_it_is_joined_keeps_the_sound_in_step(
    stream: Path, tmp_path: Path
) -> None:
    fps = StreamReader(stream).manifest.fps
    add_clicks(stream, [2, 7])
    (source,) = StreamReader(stream).manifest.sound
    hush = encode([np.zeros((first_sample(16, fps), 2), np.int16)], 2, 1 << 20, 96000)

    def objects(first_frame: int, end_frame: int) -> dict[str, bytes]:
        begin, stop = first_sample(first_frame, fps), first_sample(end_frame, fps)
        return {source.part: segment_sound(hush, begin, stop).pack()}

    writer = StreamWriter.create(tmp_path / "live", replace(tiny_manifest(), sound=(source,)))
    writer.sound = objects
    append_tiny(writer, 8)

    def grow(done: int, total: int) -> None:
        append_tiny(writer, 16)

    join([tmp_path / "live", stream], tmp_path / "both", progress=grow)
    writer.close()
    assert StreamReader(tmp_path / "live").num_frames == 16
    verify_stream(tmp_path / "both")
    found, begin = heard(tmp_path / "both"), first_sample(8, fps)
    assert len(found) == first_sample(18, fps)
    assert best_shift(heard(stream), found[begin:], 30) == 0
