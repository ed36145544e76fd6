"""A packed stream on static hosts: plays, seeks and adapts like its source folder, by ranges of one
file."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from codec.errors import CorruptError
from codec.framerange import FrameRange
from codec.stream import StreamReader
from codec.stream.streampacker import pack_stream
from player.network.fetch import FetchError, RetryConfig
from player.script.openscene import Scene
from player.source.opener import Opener, SourceConfig, opened
from player.source.source import SlicePackets, Source
from player.source.webstorage import WebStorage
from tests.support.delivery.assembled import assembled, check_packets, checked
from tests.support.delivery.rangehost import RangeHost, range_host
from tests.support.hosted_streams import static_host, write_stream

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


def births_of(source: Source, reader: StreamReader) -> set[int]:
    """The births whose skip maps and layer 0 have come; each packet is the one in the folder."""
    here = set()
    for one in source.packets():
        check_packets(reader, one)
        if isinstance(one, SlicePackets) and one.skip_map is not None:
            here.add(one.birth)
    return here


@pytest.mark.parametrize(("first", "layers"), [(0, None), (17, 2), (NUM_FRAMES - 1, None)])
def test_every_frame_shows_what_the_folder_shows(
    made: Path, host: RangeHost, first: int, layers: int | None
) -> None:
    reader, frames = StreamReader(made / "s"), FrameRange(first)
    with opened(f"{host.url}/s.swings", frames, layers) as source:
        shown = list(checked(reader, assembled(source), layers or 3))
    assert [one.frame for one in shown] == list(range(first, NUM_FRAMES))
    with opened(f"{host.url}/s.swings", frames, adaptive=True) as source:
        assert source.adaptive
        assert births_of(source, reader) >= set(range(first + 1, NUM_FRAMES))


def test_the_first_picture_takes_one_request_less_than_from_a_folder(
    made: Path, host: RangeHost, monkeypatch: pytest.MonkeyPatch
) -> None:
    def counts(path: str) -> tuple[int, int]:
        """Requests until the source is open, and until a frame has come."""
        host.asked.clear()
        with opened(f"{host.url}/{path}") as source, closing(source.packets()) as packets:  # type: ignore[type-var]
            open_count = len(host.asked)
            next(one for one in packets if isinstance(one, SlicePackets) and not one.first_layer)
            return open_count, len(host.asked)

    to_open, to_show = counts("s")
    assert to_open == 2
    assert counts("s.swings") == (1, to_show - 1)
    index_bytes = (made / "s" / "index.bin").stat().st_size
    monkeypatch.setattr("codec.stream.packedlayout.FIRST_BYTES", index_bytes // 2)
    assert counts("s.swings") == (2, to_show)


def test_a_part_that_breaks_off_goes_on_and_seeks_need_no_other_head(
    made: Path, host: RangeHost
) -> None:
    with closing(Opener(f"{host.url}/s.swings", config=PATIENT)) as opener:
        for adaptive in (False, True):
            with closing(opener.open(FrameRange(0, 12), None, adaptive)) as source:
                host.cut_bytes = 1500
                births = births_of(source, StreamReader(made / "s"))
                host.cut_bytes = None
            assert births >= set(range(1, 12))
    assert sum(asked.startswith("bytes=0-") for _, asked in host.asked) == 1


def test_what_is_not_a_packed_stream_is_said(made: Path, tmp_path: Path, host: RangeHost) -> None:
    whole = (made / "s.swings").read_bytes()
    for name, data in (("cut", whole[:-1]), ("page", b"<html>" + bytes(200)), ("empty", b"")):
        (tmp_path / f"{name}.swings").write_bytes(data)
    with range_host(tmp_path) as other, static_host(made) as plain:
        for url, complaint in (
            (f"{other.url}/cut", "by its index it has"),
            (f"{other.url}/page", r"page\.swings: byte 0: packed stream: does .*not a stream$"),
            (f"{other.url}/empty", "HTTP 416"),
            (f"{other.url}/none", "HTTP 404"),
            (f"{plain}/s", r"s\.swings: the host does not send parts of a file, as "),
        ):
            with pytest.raises(FetchError, match=complaint), opened(f"{url}.swings"):
                pass
    with opened(f"{host.url}/s.swings", adaptive=True) as source:
        host.knows_ranges = False
        with pytest.raises(FetchError, match="does not send parts"):
            list(assembled(source))


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
        for path in ("manifest.json", "index.bin", "segments/3/skipmaps"):
            assert storage.read(path, 1 << 20) == (made / "s" / path).read_bytes()
        with pytest.raises(CorruptError, match=r"s\.swings/segments/99/0 is missing; of course$"):
            storage.read("segments/99/0", 10, if_missing="of course")
    with Scene.open(url, renderer="cpu") as scene, Scene.open(made / "s", renderer="cpu") as same:
        assert scene.num_frames == same.num_frames
        assert (scene.render(9) == same.render(9)).all()
    with Scene.open(made / "s.swings", renderer="cpu") as scene:
        assert scene.num_frames == NUM_FRAMES


def test_the_poster_comes_out_of_the_file(tmp_path: Path) -> None:
    poster = b"\x89PNG\r\n\x1a\n" + bytes(2000)
    file = write_stream(tmp_path / "s", 1, poster="köder/poster.png") / "köder" / "poster.png"
    file.parent.mkdir()
    file.write_bytes(poster)
    pack_stream(tmp_path / "s", tmp_path / "s.swings")
    with range_host(tmp_path) as host:
        for name in (f"{host.url}/s.swings", str(tmp_path / "s.swings")):
            with closing(Opener(name)) as opener:
                preview = opener.preview()
                assert preview is not None
                assert preview.poster == poster
        assert len(host.asked) == 2
