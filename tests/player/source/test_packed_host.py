"""A packed stream on static hosts: plays, seeks and adapts like its source folder, by ranges of one
file."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from codec.errors import CorruptError
from codec.framerange import FrameRange
from codec.stream import StreamReader
from codec.tools.packing import pack_stream
from player.network.faults import BrokenError
from player.network.fetch import FetchError
from player.network.retry import RetryConfig
from player.script.openscene import Scene
from player.sound.decodedsound import DecodedSound, SegmentLoader
from player.source.opener import Opener, SourceConfig, opened
from player.source.source import SlicePackets, Source
from player.source.webstorage import WebStorage
from tests.support.delivery.assembled import assembled, check_packets, checked
from tests.support.delivery.rangehost import RangeHost, range_host
from tests.support.hosted_streams import static_host, write_stream
from tests.support.sounding import add_clicks, heard

NUM_FRAMES = 40
PATIENT = SourceConfig(RetryConfig(10, first_delay_s=0.01, max_delay_s=0.05))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("root")
    write_stream(root / "s", NUM_FRAMES)
    pack_stream(root / "s", root / "s.swings")
    return root


@pytest.fixture
def host(made: Path) -> Iterator[RangeHost]:
    with range_host(made) as found:
        yield found


@pytest.mark.parametrize(("first", "layers"), [(0, None), (17, 2), (NUM_FRAMES - 1, None)])
def test_every_frame_shows_what_the_folder_shows(
    made: Path, host: RangeHost, first: int, layers: int | None
) -> None:
    reader, frames = StreamReader(made / "s"), FrameRange(first)
    with opened(f"{host.url}/s.swings", frames, layers) as source:
        shown = list(checked(reader, assembled(source), layers or 3))
    assert [one.frame for one in shown] == list(range(first, NUM_FRAMES))


def births_of(source: Source, reader: StreamReader) -> set[int]:
    """The births whose masks and layer 0 have come; each packet is the one in the folder."""
    here = set()
    for one in source.packets():
        check_packets(reader, one)
        if isinstance(one, SlicePackets) and one.mask is not None:
            here.add(one.birth)
    return here


def test_an_adaptive_play_gets_the_packets_of_the_folder(made: Path, host: RangeHost) -> None:
    with opened(f"{host.url}/s.swings", FrameRange(17), adaptive=True) as source:
        assert source.adaptive
        births = births_of(source, StreamReader(made / "s"))
    assert births >= set(range(18, NUM_FRAMES))


def play_one_frame(source: Source) -> None:
    with closing(source.packets()) as packets:  # type: ignore[type-var]
        for one in packets:
            if isinstance(one, SlicePackets) and one.first_layer == 0:
                return


@pytest.mark.parametrize("long_index", [False, True])
def test_the_first_picture_takes_one_request_less_than_from_a_folder(
    made: Path, host: RangeHost, monkeypatch: pytest.MonkeyPatch, long_index: bool
) -> None:
    if long_index:
        index_bytes = (made / "s" / "index.bin").stat().st_size
        monkeypatch.setattr("codec.stream.packedlayout.FIRST_BYTES", index_bytes // 2)
    counts: list[int] = []
    for path in ("s", "s.swings"):
        host.asked.clear()
        with opened(f"{host.url}/{path}") as source:
            counts.append(len(host.asked))
            play_one_frame(source)
            counts.append(len(host.asked))
    assert counts[0] == 2
    assert counts[2] == 1 + long_index
    assert counts[3] == counts[1] - 1 + long_index


def test_an_opener_seeks_without_asking_for_the_head_again(host: RangeHost) -> None:
    with closing(Opener(f"{host.url}/s.swings")) as opener:
        for first in (0, 30, 8):
            with closing(opener.open(FrameRange(first), None)) as source:
                play_one_frame(source)
    heads = [asked for _, asked in host.asked if asked.startswith("bytes=0-")]
    assert len(heads) == 1


def test_a_part_that_breaks_off_goes_on_where_it_broke(made: Path, host: RangeHost) -> None:
    with closing(Opener(f"{host.url}/s.swings", config=PATIENT)) as opener:
        for adaptive in (False, True):
            with closing(opener.open(FrameRange(0, 12), None, adaptive)) as source:
                host.cut_bytes = 1500
                births = births_of(source, StreamReader(made / "s"))
                host.cut_bytes = None
            assert births >= set(range(1, 12))


def test_a_host_without_ranges_is_refused_in_one_line(made: Path, host: RangeHost) -> None:
    with (
        static_host(made) as plain,
        pytest.raises(FetchError, match=r"s\.swings: the host does not send parts of a file, as "),
        opened(f"{plain}/s.swings"),
    ):
        pass
    with opened(f"{host.url}/s.swings", adaptive=True) as source:
        host.knows_ranges = False
        with pytest.raises(FetchError, match="does not send parts"):
            list(assembled(source))


def test_what_is_not_a_packed_stream_is_said(made: Path, tmp_path: Path) -> None:
    whole = (made / "s.swings").read_bytes()
    (tmp_path / "cut.swings").write_bytes(whole[:-1])
    (tmp_path / "page.swings").write_bytes(b"<html>" + bytes(200))
    (tmp_path / "empty.swings").write_bytes(b"")
    with range_host(tmp_path) as host:
        for name, complaint in (
            ("cut", "by its index it has"),
            ("page", r"page\.swings: byte 0: packed stream: does not begin as one.*not a stream$"),
            ("empty", "HTTP 416"),
            ("none", "HTTP 404"),
        ):
            kind = BrokenError if name == "empty" else FetchError
            with pytest.raises(kind, match=complaint), opened(f"{host.url}/{name}.swings"):
                pass


@pytest.mark.parametrize("adaptive", [False, True])
def test_a_file_that_is_replaced_is_said(made: Path, tmp_path: Path, adaptive: bool) -> None:
    """The new file has another size, or the same size."""
    write_stream(tmp_path / "longer", NUM_FRAMES + 8)
    pack_stream(tmp_path / "longer", tmp_path / "longer.swings")
    whole = bytearray((made / "s.swings").read_bytes())
    for at in range(len(whole) // 8, len(whole) - 4000):
        whole[at] ^= 1
    with range_host(tmp_path) as host:
        for other in ((tmp_path / "longer.swings").read_bytes(), bytes(whole)):
            shutil.copy(made / "s.swings", tmp_path / "s.swings")
            with opened(f"{host.url}/s.swings", adaptive=adaptive) as source:
                (tmp_path / "s.swings").write_bytes(other)
                with pytest.raises((FetchError, CorruptError)) as caught:
                    list(assembled(source))
            message = str(caught.value)
            assert "replaced by another one" in message or "s.swings/segments/" in message


def test_a_script_reads_it(made: Path, host: RangeHost) -> None:
    url = f"{host.url}/s.swings"
    with closing(WebStorage(url)) as storage:
        assert storage.last_name == "s.swings"
        for path in ("manifest.json", "index.bin", "segments/3/masks"):
            assert storage.read(path, 1 << 20) == (made / "s" / path).read_bytes()
        with pytest.raises(CorruptError, match=r"s\.swings/segments/99/0 is missing; of course$"):
            storage.read("segments/99/0", 10, if_missing="of course")
    with Scene.open(url, renderer="cpu") as scene, Scene.open(made / "s", renderer="cpu") as same:
        assert scene.num_frames == same.num_frames
        assert (scene.render(9) == same.render(9)).all()
    with Scene.open(made / "s.swings", renderer="cpu") as scene:
        assert scene.num_frames == NUM_FRAMES


def test_the_poster_comes_out_of_the_file(made: Path, tmp_path: Path) -> None:
    shutil.copytree(made / "s", tmp_path / "s")
    manifest = replace(StreamReader(made / "s").manifest, poster="köder/poster.png")
    (tmp_path / "s" / "manifest.json").write_bytes(manifest.to_json())
    poster = b"\x89PNG\r\n\x1a\n" + bytes(2000)
    (tmp_path / "s" / "köder").mkdir()
    (tmp_path / "s" / "köder" / "poster.png").write_bytes(poster)
    pack_stream(tmp_path / "s", tmp_path / "s.swings")
    with range_host(tmp_path) as host:
        for name in (f"{host.url}/s.swings", str(tmp_path / "s.swings")):
            with closing(Opener(name)) as opener:
                preview = opener.preview()
                assert preview is not None
                assert preview.poster == poster
        assert len(host.asked) == 2


def test_sound_comes_by_ranges(tmp_path: Path) -> None:
    stream = write_stream(tmp_path / "s", 23)
    add_clicks(stream, (0, 4, 5, 10, 19, 22))
    pack_stream(stream, tmp_path / "s.swings")
    whole = heard(stream)
    with range_host(tmp_path) as host:
        for source in (f"{host.url}/s.swings", str(tmp_path / "s.swings")):
            with closing(Opener(source)) as opener:
                opener.open(FrameRange(), None).close()
                manifest = opener.manifest
                assert manifest is not None
                decoded, files = DecodedSound(manifest), opener.sound_files()
                with closing(files):
                    loader = SegmentLoader(manifest, files.read)
                    for segment in range(5):
                        decoded.put(segment, loader.load(segment))
            mixed = decoded.mix(0, len(whole), manifest.camera())
            np.testing.assert_array_equal(np.rint(mixed * 32768), whole)
        assert {path for path, _ in host.asked} == {"/s.swings"}
        assert all(asked for _, asked in host.asked)
