"""Captions added to real streams, by the commands and by hand."""

from __future__ import annotations

import json
from pathlib import Path

import aiohttp
import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.edit.editing import edit_stream
from codec.edit.recolour import ColourOptions
from codec.errors import CodecError, CorruptError
from codec.stream import StreamReader
from codec.stream.captions import MAX_CAPTIONS_BYTES, Captions, Cue, parse_webvtt
from codec.stream.packedstorage import open_place
from codec.tools.audit import verify_stream
from codec.tools.packing import pack_stream
from codec.tools.static import export_static
from codec.tools.streamcaptions import add_captions, remove_captions
from tests.support.commands import run, run_ok
from tests.support.server.running_server import Running, on_server
from tests.support.tiny_stream import files_of, write_tiny

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
def stream(tmp_path: Path) -> Path:
    path = tmp_path / "s"
    write_tiny(path, 10)
    return path


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


def test_captions_go_with_the_stream_but_for_cuts(stream: Path, file: Path, tmp_path: Path) -> None:
    add_captions(stream, file, Captions("en", "English"))
    export_static(stream, tmp_path / "static")
    assert (tmp_path / "static" / "captions-en.vtt").read_text() == VTT
    verify_stream(tmp_path / "static")
    pack_stream(stream, tmp_path / "one.swings")
    verify_stream(tmp_path / "one.swings")
    assert open_place(tmp_path / "one.swings").read("captions-en.vtt", 1 << 20).decode() == VTT
    edit_stream(stream, tmp_path / "dark", ColourOptions(exposure=-1))
    verify_stream(tmp_path / "dark")
    assert (tmp_path / "dark" / "captions-en.vtt").read_text() == VTT
    said = run_ok("swings-stream", "edit", "trim", stream, tmp_path / "cut", "--frames", "2:8")
    assert "captions     left out" in str(said)
    (stream / "captions-fr.vtt").write_text(VTT)  # the manifest does not name it

    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        async with client.get("/v1/streams/s/captions-en.vtt") as answer:
            assert answer.headers["Content-Type"] == "text/vtt; charset=utf-8"
            assert await answer.text() == VTT
        for name in ("captions-fr.vtt", "captions-.vtt", "other.vtt"):
            async with client.get(f"/v1/streams/s/{name}") as answer:
                assert answer.status == 404

    on_server(tmp_path, check)


def test_damaged_files_are_found(stream: Path, file: Path) -> None:
    add_captions(stream, file, Captions("en", "English"))
    path = stream / "captions-en.vtt"
    path.write_text("1\n00:00.000 --> 00:01.000\nSRT\n")
    with pytest.raises(CorruptError, match=r"en\.vtt: byte 0: captions: this is not WebVTT"):
        verify_stream(stream)
    path.write_bytes(b"WEBVTT\n" + b" " * MAX_CAPTIONS_BYTES)
    for _ in range(2):
        with pytest.raises(CodecError, match=r"captions-en\.vtt"):
            verify_stream(stream)
        path.unlink(missing_ok=True)


@pytest.mark.parametrize(
    "captions",
    [
        {},
        [{"language": "../en", "label": "x"}],
        [{"language": "en", "label": ""}],
        [{"language": "en", "label": "a\nb"}],
        [{"language": "en", "label": "a" * 81}],
        [{"language": "en"}],
        [{"language": "en", "label": "a"}, {"language": "EN", "label": "b"}],
        [{"language": f"l{n}", "label": "a"} for n in range(17)],
    ],
)
def test_other_manifests_are_refused(stream: Path, captions: object) -> None:
    path = stream / "manifest.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "captions": captions}))
    with pytest.raises(CodecError, match=r"manifest: (captions|two captions|label|17 captions)"):
        StreamReader(stream)


def test_cues_are_read() -> None:
    for text in (VTT, "\ufeff" + VTT, VTT.replace("\n", "\r\n"), VTT.replace("\n", "\r")):
        assert parse_webvtt(text.encode()) == CUES


def test_numbers_of_thousands_of_digits_are_no_crash() -> None:
    long = "9" * 5000
    for hours in (long, "9" * 400, "9" * 7):
        assert parse_webvtt(f"WEBVTT\n\n{hours}:00:00.000 --> {hours}:00:01.000\na".encode()) == ()
    (cue,) = parse_webvtt(b"WEBVTT\n\n999999:00:00.000 --> 999999:00:01.000\na")
    assert cue == Cue(3600.0 * 999999, 3600.0 * 999999 + 1, "a")
    for reference, text in (
        (f"&#{long};", "\ufffd"),
        (f"&#{long}", "\ufffd"),
        (f"&#x{'f' * 5000};", "\ufffd"),
        (f"&#{'0' * 5000}65;", "A"),
        (f"&#{'0' * 5000};", "\ufffd"),
        ("&#00000128512;", "\U0001f600"),
    ):
        (cue,) = parse_webvtt(f"WEBVTT\n\n00:00.000 --> 00:01.000\n({reference})".encode())
        assert cue.text == f"({text})"


@given(st.binary(max_size=300))
def test_any_bytes_are_cues_or_an_error(data: bytes) -> None:
    for begin in (b"", b"WEBVTT\n\n", b"WEBVTT\n\n00:00.000 --> 00:01.000\n"):
        try:
            cues = parse_webvtt(begin + data)
        except CorruptError:
            continue
        assert all(cue.start_s < cue.end_s and cue.text for cue in cues)
