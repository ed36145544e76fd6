"""Sound and captions added to real streams."""

from __future__ import annotations

import wave
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.edit.cut import join_streams, trim_stream
from codec.edit.filters import CropOptions
from codec.edit.rewrite import edit_stream
from codec.edit.transform import TransformOptions
from codec.errors import CodecError, CorruptError, SwingsError
from codec.framerange import FrameRange
from codec.stream import StreamReader, StreamWriter
from codec.stream.captions import MAX_CAPTIONS_BYTES, Captions, Cue, parse_webvtt
from codec.stream.sound import SAMPLE_RATE, SoundObject, SoundSource, first_sample, segment_sound
from codec.stream.streampacker import pack_stream
from codec.tools.audit import verify_stream
from codec.tools.static import export_static
from codec.tracks.soundcommands import Add, Audio, run_audio
from codec.tracks.soundfile import decode, encode, read_samples
from codec.tracks.streamtracks import (
    add_captions,
    add_sound,
    read_sound,
    remove_captions,
    remove_sound,
    samples,
)
from tests.support.commands import run, run_ok
from tests.support.hostile import refused
from tests.support.server.running_server import served
from tests.support.sounding import add_clicks, best_shift, heard, write_clicks
from tests.support.tiny_stream import append_tiny, files_of, tiny_manifest, write_tiny

CLICKS = (0, 4000, 9600, 14400)
PLACE = ((0.0, 0.0, 1.0, 2.0),)


@pytest.fixture
def stream(tmp_path: Path) -> Path:
    path = tmp_path / "s"
    write_tiny(path, 10)
    return path


def add(stream: Path, *, name: str = "main", num_samples: int = 16000, **options: Any) -> None:
    """Adds clicks to `stream`, with the `options` of swings-stream audio add."""
    file = stream.parent / "in.wav"
    write_clicks(file, num_samples, CLICKS)
    run_audio(Audio(Add(stream, file, name, **options)))


def test_the_commands(stream: Path, tmp_path: Path) -> None:
    before = files_of(stream)
    length = first_sample(10, StreamReader(stream).manifest.fps)
    write_clicks(tmp_path / "in.wav", length + 5000, CLICKS)
    audio = ("swings-stream", "audio")
    run_ok(*audio, "add", stream, tmp_path / "in.wav")
    assert "10 frames in 3 segments are intact" in run_ok("swings-stream", "verify", stream)
    run_ok(*audio, "extract", stream, tmp_path / "out.wav")
    with wave.open(str(tmp_path / "out.wav")) as file:
        assert (file.getnchannels(), file.getnframes()) == (2, length)
        found = np.frombuffer(file.readframes(length), "<i2").reshape(-1, 2)
    with wave.open(str(tmp_path / "in.wav")) as file:
        given = np.frombuffer(file.readframes(length), "<i2").reshape(-1, 2)
    assert best_shift(given[:, 0], found[:, 0], 30) == 0
    run_ok(*audio, "remove", stream)
    assert files_of(stream) == before
    (tmp_path / "notes.txt").write_text("no sound")
    told = run(*audio, "add", stream, tmp_path / "notes.txt")
    assert told.returncode == 1
    assert told.stderr.splitlines() == [
        f"swings-stream: {tmp_path}/notes.txt: its sound cannot be read: Invalid data found when "
        "processing input; give WAV, FLAC, Opus, or a video with sound"
    ]


def test_a_segment_decodes_by_itself(stream: Path) -> None:
    add(stream, num_samples=40000, at_m=(0, 1, 2))
    reader = StreamReader(stream)
    (source,) = reader.manifest.sound
    assert source == SoundSource("main", 1, PLACE)
    whole = heard(stream).astype(float)
    found = read_sound(reader, 1, source)
    alone = np.concatenate(list(decode(found.packets, 1))).astype(float)
    begin = first_sample(reader.records[1].first_frame, reader.manifest.fps)
    from_begin = alone[begin + found.pre_skip - found.first :]
    count = min(len(from_begin), len(whole) - begin)
    assert count > 1000
    error = from_begin[:count] - whole[begin : begin + count]
    assert np.sqrt(np.mean(error**2)) < 0.05 * np.sqrt(np.mean(whole**2)) + 1


def test_static_export_carries_it(stream: Path, tmp_path: Path) -> None:
    add(stream)
    export_static(stream, tmp_path / "static")
    verify_stream(tmp_path / "static")
    for n in range(3):
        name = f"segments/{n}/audio-main"
        assert (tmp_path / "static" / name).read_bytes() == (stream / name).read_bytes()
    (stream / "segments" / "1" / "audio-main").write_bytes(b"SWA1")
    with pytest.raises(CorruptError, match="segments/1/audio-main: byte 0: sound"):
        pack_stream(stream, tmp_path / "s.swings")


def test_any_changed_byte_is_found(stream: Path) -> None:
    add(stream)
    path = stream / "segments" / "1" / "audio-main"
    data = path.read_bytes()
    for at in range(0, len(data), 7):
        for wrong in (data[:at] + bytes([data[at] ^ 0x55]) + data[at + 1 :], data[:at]):
            refused(CodecError, "", SoundObject.parse, wrong)
    path.write_bytes(data[:-1])
    refused(CorruptError, "audio-main", verify_stream, stream)


def write_tone(path: Path, codec: str, late_s: float = 0.0) -> None:
    """Writes half a second with a stereo tone of 1 kHz from 100 ms on, beside a video unless it is
    an .ogg or .opus file. late_s: time of the sound's first sample."""
    tone = (12000 * np.sin(np.arange(24000) * 2 * np.pi / 48)).astype(np.int16)
    tone[:4800] = 0
    with av.open(str(path), "w") as out:
        video = path.suffix in (".mp4", ".mkv")
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


@pytest.mark.parametrize(
    ("name", "codec", "late_s", "offset_s"),
    [
        ("a.opus", "libopus", 0, 0),
        ("a.mp4", "aac", 0, 0),
        ("a.mkv", "libopus", 0, 0),
        ("a.ogg", "flac", 0, 0),
        ("a.mkv", "flac", 0.08, 0),
        ("a.ogg", "flac", 0, 0.05),
        ("a.ogg", "flac", 0, -0.05),
    ],
)
def test_the_tone_begins_where_the_file_and_the_offset_say(
    stream: Path, tmp_path: Path, name: str, codec: str, late_s: float, offset_s: float
) -> None:
    write_tone(tmp_path / name, codec, late_s)
    add_sound(stream, tmp_path / name, SoundSource("main", 2), offset_s=offset_s)
    found = heard(stream)[:, 0].astype(int)
    begin = int(np.flatnonzero(np.abs(found) > 6000)[0])
    wanted = round((0.1 + late_s + offset_s) * SAMPLE_RATE)
    assert abs(begin - wanted) < (240 if codec != "flac" else 30)
    assert np.abs(found[wanted + 1200 : 14000]).max() > 9000


def test_a_source_moves_along_the_places_of_a_file(stream: Path, tmp_path: Path) -> None:
    path = tmp_path / "path.json"
    path.write_text("[[0, 0, 1, 0], [2.5, 4, 1, 0]]")
    add(stream, path=path)
    (source,) = StreamReader(stream).manifest.sound
    assert source == SoundSource("main", 1, ((0.0, 0.0, 1.0, 0.0), (2.5, 4.0, 1.0, 0.0)))
    assert source.position_m(1.25) == (2.0, 1.0, 0.0)
    before = files_of(stream)
    for wrong in ("[]", "{", "[[0, 1, 2]]", '[["a", 0, 0, 0]]', "[[1, 0, 0, 0], [0, 0, 0, 0]]"):
        path.write_text(wrong)
        assert "\n" not in str(refused(SwingsError, "", add, stream, name="other", path=path))
    path.write_text("[[0, 0, 0, 0]]")
    refused(SwingsError, "not both", add, stream, name="other", path=path, at_m=(0, 0, 0))
    assert files_of(stream) == before


def objects_of(whole: Any, fps: float) -> Any:
    """What a `StreamWriter` asks for the sound of a segment."""
    return lambda first, end: {
        "audio-main": segment_sound(whole, first_sample(first, fps), first_sample(end, fps)).pack()
    }


def test_a_live_stream_has_sound_as_far_as_it_goes(tmp_path: Path) -> None:
    path, fps = tmp_path / "s", tiny_manifest().fps
    write_clicks(tmp_path / "in.wav", 40000, CLICKS)
    whole = encode(read_samples(tmp_path / "in.wav", 2), 2, first_sample(10, fps), 96000)
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
        writer.sound = objects_of(whole, fps)
        append_tiny(writer, birth + 1)
    writer.close()
    verify_stream(path)
    write_tiny(tmp_path / "plain", 10)
    add(tmp_path / "plain", num_samples=40000)
    for name in ("manifest.json", *(f"segments/{n}/audio-main" for n in range(3))):
        assert (path / name).read_bytes() == (tmp_path / "plain" / name).read_bytes()


def test_edits_of_all_frames_keep_the_sound(stream: Path, tmp_path: Path) -> None:
    add(stream)
    add(stream, name="voice", at_m=(0, 1, 2))
    edit_stream(stream, tmp_path / "c", CropOptions(sphere=(0, 0, 0, 1e4)))
    edit_stream(stream, tmp_path / "t", TransformOptions(2, move=(1, 0, 0)))
    for name in ("c", "t"):
        verify_stream(tmp_path / name)
        for part in stream.glob("segments/*/audio-*"):
            assert (tmp_path / name / part.relative_to(stream)).read_bytes() == part.read_bytes()
    main, voice = StreamReader(tmp_path / "t").manifest.sound
    assert main == SoundSource("main", 2)
    np.testing.assert_allclose(voice.keys, [(0.0, 1.0, 2.0, 4.0)], atol=0.01)


@pytest.mark.parametrize("first", [3, 4])
def test_trimmed_and_joined_streams_keep_it(stream: Path, tmp_path: Path, first: int) -> None:
    add(stream)
    fps = StreamReader(stream).manifest.fps
    trim_stream(stream, tmp_path / "cut", FrameRange(first, 9))
    join_streams([stream, stream], tmp_path / "both")
    verify_stream(tmp_path / "cut")
    verify_stream(tmp_path / "both")
    whole, cut, both = (heard(path) for path in (stream, tmp_path / "cut", tmp_path / "both"))
    begin, stop = first_sample(first, fps), first_sample(9, fps)
    assert len(cut) == first_sample(9 - first, fps)
    count = min(stop - begin, len(cut))
    assert best_shift(whole[begin : begin + count], cut[:count], 30) == 0
    assert len(both) == first_sample(20, fps)
    half = first_sample(10, fps)
    again = both[half : half + len(whole)]
    assert best_shift(whole[: len(again)], again, 30) == 0


def test_a_joined_source_that_moves_is_left_out_and_named(stream: Path, tmp_path: Path) -> None:
    (tmp_path / "path.json").write_text("[[0, 0, 1, 2], [0.2, 4, 1, 2]]")
    add(stream, name="steps", path=tmp_path / "path.json")
    said = run_ok("swings-stream", "edit", "join", stream, tmp_path / "j", "--then", stream)
    assert "left out: steps" in said
    assert not StreamReader(tmp_path / "j").manifest.sound
    trim_stream(stream, tmp_path / "t", FrameRange(3, 9))
    (steps,) = StreamReader(tmp_path / "t").manifest.sound
    assert steps.keys[1][0] == pytest.approx(0.2 - 3 / StreamReader(stream).manifest.fps)


def test_sound_that_cannot_be_cut_leaves_no_stream(stream: Path, tmp_path: Path) -> None:
    add(stream)
    path = stream / "segments" / "1" / "audio-main"
    data = path.read_bytes()
    path.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    out, before = tmp_path / "out", sorted(tmp_path.iterdir())
    for cut in (
        lambda: trim_stream(stream, out, FrameRange(3, 9)),
        lambda: join_streams([stream, stream], out),
    ):
        refused(CodecError, "segments/1/audio-main", cut)
        assert sorted(tmp_path.iterdir()) == before


VTT = """\
WEBVTT - of the walk

NOTE not shown

1
00:00.000 --> 00:01.000 line:0
Good <i>day</i> &amp; <c.loud>night</c>

00:00:00.500 --> 00:00:02.000
- <v Ann>Two
- lines

00:03.000 --> 00:02.000
never
"""
CUES = (Cue(0.0, 1.0, "Good day & night"), Cue(0.5, 2.0, "- Two\n- lines"))


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "in.vtt"
    path.write_text(VTT)
    return path


def test_add_replace_and_remove(stream: Path, file: Path) -> None:
    before, captions = files_of(stream), ("swings-stream", "captions")
    said = run_ok(*captions, "add", stream, file)
    assert said.strip() == f"{stream}: captions en, 2 cues"
    run_ok(*captions, "add", stream, file, "--language", "pt-BR", "--label", "Português")
    add_captions(stream, file, Captions("en", "English"))
    found = StreamReader(stream).manifest.captions
    assert found == (Captions("pt-BR", "Português"), Captions("en", "English"))
    assert (stream / "captions-en.vtt").read_text() == VTT
    for one in (Captions("PT-br", "P"), Captions("en", "English")):
        add_captions(stream, file, one)
    found = StreamReader(stream).manifest.captions
    assert found == (Captions("PT-br", "P"), Captions("en", "English"))
    files = {path.name for path in stream.glob("*.vtt")}
    assert files == {"captions-en.vtt", "captions-PT-br.vtt"}
    verify_stream(stream)
    refused = run(*captions, "remove", stream, "--language", "fr")
    assert refused.returncode == 1
    assert "no captions have the language 'fr'; there are: PT-br, en" in refused.stderr
    for language in ("pt-BR", "en"):
        remove_captions(stream, language)
    assert files_of(stream) == before


@pytest.mark.anyio
async def test_captions_go_with_the_stream_but_for_cuts(
    stream: Path, file: Path, tmp_path: Path
) -> None:
    add_captions(stream, file, Captions("en", "English"))
    export_static(stream, tmp_path / "static")
    assert (tmp_path / "static" / "captions-en.vtt").read_text() == VTT
    verify_stream(tmp_path / "static")
    edit_stream(stream, tmp_path / "moved", TransformOptions(move=(1, 0, 0)))
    verify_stream(tmp_path / "moved")
    assert (tmp_path / "moved" / "captions-en.vtt").read_text() == VTT
    said = run_ok("swings-stream", "edit", "trim", stream, tmp_path / "cut", "--frames", "2:8")
    assert "captions     left out" in str(said)
    (stream / "captions-fr.vtt").write_text(VTT)  # the manifest does not name it

    async with served(tmp_path) as (_, client):
        async with client.get("/v1/streams/s/captions-en.vtt") as answer:
            assert answer.headers["Content-Type"] == "text/vtt; charset=utf-8"
            assert await answer.text() == VTT
        for name in ("captions-fr.vtt", "captions-.vtt", "other.vtt"):
            async with client.get(f"/v1/streams/s/{name}") as answer:
                assert answer.status == 404


def test_damaged_files_are_found(stream: Path, file: Path) -> None:
    add_captions(stream, file, Captions("en", "English"))
    path = stream / "captions-en.vtt"
    path.write_text("1\n00:00.000 --> 00:01.000\nSRT\n")
    refused(CorruptError, r"en\.vtt: byte 0: captions: this is not WebVTT", verify_stream, stream)
    path.write_bytes(b"WEBVTT\n" + b" " * MAX_CAPTIONS_BYTES)
    for _ in range(2):
        refused(CodecError, r"captions-en\.vtt", verify_stream, stream)
        path.unlink(missing_ok=True)


def test_cues_are_read() -> None:
    for text in (VTT, "\ufeff" + VTT, VTT.replace("\n", "\r\n"), VTT.replace("\n", "\r")):
        assert parse_webvtt(text.encode()) == CUES


def test_numbers_of_thousands_of_digits_are_no_crash() -> None:
    long = "9" * 5000
    assert parse_webvtt(f"WEBVTT\n\n{long}:00:00.000 --> {long}:00:01.000\na".encode()) == ()
    text = f"(&#{long};) (&#x{'f' * 5000};) (&#{'0' * 5000}65;)"
    (cue,) = parse_webvtt(f"WEBVTT\n\n00:00.000 --> 00:01.000\n{text}".encode())
    assert cue.text == "(\ufffd) (\ufffd) (A)"


@given(st.binary(max_size=300))
def test_any_bytes_are_cues_or_an_error(data: bytes) -> None:
    for begin in (b"", b"WEBVTT\n\n", b"WEBVTT\n\n00:00.000 --> 00:01.000\n"):
        try:
            cues = parse_webvtt(begin + data)
        except CorruptError:
            continue
        assert all(cue.start_s < cue.end_s and cue.text for cue in cues)


def test_several_sources_of_other_formats(stream: Path, tmp_path: Path) -> None:
    with av.open(str(tmp_path / "voice.flac"), "w") as out:
        track = out.add_stream("flac", rate=44100)
        frame = av.AudioFrame.from_ndarray(np.full((1, 2 * 8192), 900, np.int16), "s16", "stereo")
        frame.sample_rate = 44100
        out.mux([*track.encode(frame), *track.encode(None)])
    add(stream)
    add_sound(stream, tmp_path / "voice.flac", SoundSource("voice", 1, PLACE))
    verify_stream(stream)
    assert [source.name for source in StreamReader(stream).manifest.sound] == ["main", "voice"]
    assert abs(len(heard(stream, "voice")) - 8192 * SAMPLE_RATE / 44100) <= 2
    remove_sound(stream, "main")
    assert [source.name for source in StreamReader(stream).manifest.sound] == ["voice"]


def test_a_stream_that_grows_while_it_is_joined(stream: Path, tmp_path: Path) -> None:
    fps = StreamReader(stream).manifest.fps
    add_clicks(stream, [2, 7])
    (source,) = StreamReader(stream).manifest.sound
    writer = StreamWriter.create(tmp_path / "live", replace(tiny_manifest(), sound=(source,)))
    hush = encode([np.zeros((first_sample(16, fps), 2), np.int16)], 2, 1 << 20, 96000)
    writer.sound = objects_of(hush, fps)
    append_tiny(writer, 8)
    join_streams(
        [tmp_path / "live", stream], tmp_path / "both", progress=lambda *_: append_tiny(writer, 16)
    )
    writer.close()
    assert StreamReader(tmp_path / "live").num_frames == 16
    verify_stream(tmp_path / "both")
    found, begin = heard(tmp_path / "both"), first_sample(8, fps)
    assert len(found) == first_sample(18, fps)
    assert best_shift(heard(stream), found[begin:], 30) == 0
