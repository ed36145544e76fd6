"""Static hosts that break, vanish or grow: nothing is fetched twice, and the play continues. What
comes over which link is for test_hosted_play.py and test_static_link.py."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path

import pytest

from codec.errors import CorruptError, SwingsError
from codec.stream import StreamReader, StreamWriter
from player.network.fetch import Fetcher, FetchError, RetryConfig
from player.network.target import BrokenError
from player.source.opener import SourceConfig, opened
from player.source.source import Packets, SlicePackets
from tests.support.delivery.assembled import assembled, check_packets, checked
from tests.support.delivery.rangehost import RangeHost, range_host
from tests.support.hosted_streams import (
    SLICE_SIZE,
    SWIN_SIZE,
    ServerProcess,
    random_slice,
    served,
    small_manifest,
    static_host,
    write_stream,
)

PATIENT = SourceConfig(RetryConfig(86400, first_delay_s=0.01, max_delay_s=0.01))
QUICK = SourceConfig(RetryConfig(0.3, first_delay_s=0.01, max_delay_s=0.05))
NUM_FRAMES = 40

both = pytest.mark.parametrize("adaptive", [False, True])


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("root")
    write_stream(path / "s", NUM_FRAMES, 400)
    return path


@pytest.fixture
def host(root: Path) -> Iterator[RangeHost]:
    with range_host(root) as host:
        yield host


def check(reader: StreamReader, packets: list[Packets], whole: bool) -> None:
    """Each packet is that of the stream and came once, with layer 0 of all slices; all layers of
    all slices where it is a `whole` play."""
    come: list[tuple[int, int]] = []
    for one in packets:
        check_packets(reader, one)
        if isinstance(one, SlicePackets):
            layers = range(one.first_layer, one.first_layer + len(one.packets))
            come += [(one.birth, layer) for layer in layers]
    assert len(set(come)) == len(come)
    layers = range(3 if whole else 1)
    assert {(birth, n) for birth in range(1, reader.num_frames) for n in layers} <= {*come}


def check_all(root: Path, name: str, config: SourceConfig = PATIENT, adaptive: bool = False) -> int:
    """Plays the whole stream; returns the received bytes."""
    with opened(name, config=config, adaptive=adaptive) as source:
        packets = list(source.packets())
        received_bytes = source.received_bytes
    check(StreamReader(root / "s"), packets, not adaptive)
    return received_bytes


def size_of(root: Path) -> int:
    """Bytes of the files that a play from frame 0 on reads."""
    files = [path for path in (root / "s").rglob("*") if path.is_file()]
    read = [f for f in files if f.parent.name == "0" or not f.name.startswith("keyframe")]
    return sum(path.stat().st_size for path in read)


def test_what_broke_off_is_resumed_from_the_byte_that_is_missing(
    root: Path, host: RangeHost
) -> None:
    host.cut_bytes = 20_000
    # Bytes received before a response broke off are not requested again.
    assert check_all(root, f"{host.url}/s") == size_of(root)
    assert sum(asked != "" for _, asked in host.asked) > 10
    host.cut_bytes = 9_000
    every = sum(path.stat().st_size for path in (root / "s").rglob("*") if path.is_file())
    assert check_all(root, f"{host.url}/s", adaptive=True) <= every


def test_a_host_without_ranges_starts_again(
    root: Path, host: RangeHost, monkeypatch: pytest.MonkeyPatch
) -> None:
    host.knows_ranges = False
    host.refusals = [(503, {}), (429, {"Retry-After": "0"})]
    with pytest.raises(BrokenError, match="HTTP 503"):
        check_all(root, f"{host.url}/s")  # opening reports it at once
    host.refusals = []
    assert check_all(root, f"{host.url}/s") == size_of(root)
    # Such a host never delivers a complete body if every body breaks off.
    host.cut_bytes = 4_000
    with pytest.raises(BrokenError, match=r"segments/0/keyframe-0: .* \(tried for"):
        check_all(root, f"{host.url}/s", QUICK)
    host.cut_bytes, pauses_s = None, list[float]()
    monkeypatch.setattr(Fetcher, "pause", lambda _, seconds: pauses_s.append(seconds))
    with opened(f"{host.url}/s", config=PATIENT) as source:
        host.refusals = [(503, {"Retry-After": "77"})]
        next(source.packets())
    assert pauses_s == [77]


def test_pieces_of_two_contents_are_not_put_together(root: Path, tmp_path: Path) -> None:
    """The other host has the correct files, but the first one broke off amid different bytes."""
    shutil.copytree(root / "s", tmp_path / "s")
    for path in (tmp_path / "s" / "segments").glob("*/0"):
        path.write_bytes(bytes(path.stat().st_size))
    with range_host(tmp_path) as wrong, range_host(root) as right:
        wrong.cut_bytes = 20_000
        check_all(root, f"{wrong.url}/s,{right.url}/s")
        assert wrong.objects()
        assert right.objects()


@both
def test_when_a_host_is_gone_the_next_one_is_asked(root: Path, adaptive: bool) -> None:
    with range_host(root) as first, range_host(root) as second:
        name = f"{first.url}/s,{second.url}/s"
        with opened(name, config=PATIENT, adaptive=adaptive) as source:
            packets = source.packets()
            came = [next(packets)]
            assert not second.asked
            leave(first, 3)
            came += packets
        check(StreamReader(root / "s"), came, whole=not adaptive)
        assert first.objects()
        assert second.objects()
        # And back, if that host has nothing either.
        first.gone, second.gone = False, True
        check_all(root, name, adaptive=adaptive)
        with opened(name, config=QUICK, adaptive=adaptive) as source:
            leave(first, len(first.objects()) + 3)
            with pytest.raises(BrokenError, match=r"segments/\d/\S+: .*tried for"):
                list(source.packets())


def leave(host: RangeHost, after: int) -> None:
    """Makes `host` close the connection of every request after `after` requested objects."""
    answer = host.answer

    def counting(handler: object) -> None:
        if len(host.objects()) >= after:
            host.gone = True
            host.answer = answer  # type: ignore[method-assign]
        answer(handler)  # type: ignore[arg-type]

    host.answer = counting  # type: ignore[method-assign]


def test_a_host_that_lacks_a_file_is_passed_over(root: Path, tmp_path: Path) -> None:
    shutil.copytree(root / "s", tmp_path / "s")
    shutil.rmtree(tmp_path / "s" / "segments" / "3")
    with range_host(tmp_path) as poor, range_host(root) as rich:
        check_all(root, f"{poor.url}/s,{rich.url}/s")
        assert rich.objects()[0].startswith("/s/segments/3/")
        with pytest.raises(FetchError, match="segments/3/skipmaps: HTTP 404"):
            check_all(root, f"{poor.url}/s")


def test_a_play_goes_on_without_a_file_above_layer_0(root: Path, tmp_path: Path) -> None:
    shutil.copytree(root / "s", tmp_path / "s")
    (tmp_path / "s" / "segments" / "1" / "2").unlink()
    with range_host(tmp_path) as host:
        check_all(root, f"{host.url}/s", adaptive=True)
        with pytest.raises(FetchError):
            check_all(root, f"{host.url}/s")
        (tmp_path / "s" / "segments" / "1" / "0").unlink()
        with pytest.raises(FetchError):
            check_all(root, f"{host.url}/s", adaptive=True)


def test_several_servers_of_one_stream(root: Path) -> None:
    with served(root) as first, served(root) as second:
        name = f"{first.url}/watch/s,{second.url}"
        reader = StreamReader(root / "s")
        with opened(name, layers=3, config=PATIENT) as source:
            for one in checked(reader, assembled(source), 3):
                if one.frame == 0:
                    first.process.kill()
        assert one.frame == NUM_FRAMES - 1
        with opened(name, layers=3, config=PATIENT) as source:
            assert len(list(assembled(source))) == NUM_FRAMES


HOSTED = [(kind, yes) for kind in ("static", "ranges", "files of swings") for yes in (False, True)]


@pytest.mark.parametrize(("kind", "adaptive"), [*HOSTED, ("swings", False), ("folder", False)])
def test_a_live_stream_is_followed_to_its_end(tmp_path: Path, kind: str, adaptive: bool) -> None:
    root, num_frames = tmp_path / "library", 23
    writer = StreamWriter.create(root / "s", small_manifest(live=True))
    births = iter(range(1 - SWIN_SIZE, num_frames))

    def write_until(end: int) -> None:
        for birth in births:
            writer.append(random_slice(birth))
            if birth + 1 == end:
                break
        if end == num_frames:
            writer.close()

    hosts = {"static": static_host, "ranges": range_host, "folder": nullcontext}
    paths = {"files of swings": "v1/streams/s/manifest.json", "swings": "watch/s"}
    with hosts.get(kind, served)(root) as host:  # type: ignore[operator]
        url = host.url if isinstance(host, RangeHost | ServerProcess) else host
        layers = None if adaptive else 3
        came = list[Packets]()
        name = f"{url}/{paths.get(kind, 's')}"
        with opened(name, layers=layers, config=PATIENT, adaptive=adaptive) as source:
            assert source.frames.end is None
            write_until(11)
            for one in source.packets():
                came.append(one)
                if one.first_frame == 9 and writer.next_birth == 11:
                    write_until(num_frames)  # only now: it follows, and waits for no end
            assert source.manifest.live == (kind == "swings")  # then it is that of the beginning
    check(StreamReader(root / "s"), came, whole=not adaptive)


@both
def test_a_stream_that_was_replaced_is_not_mixed_with_the_old_one(
    tmp_path: Path, adaptive: bool
) -> None:
    write_stream(tmp_path / "s", NUM_FRAMES)
    # In larger objects: the answers are longer than the index says.
    write_stream(tmp_path / "new", NUM_FRAMES, 2 * SLICE_SIZE, seed=10_000)
    came = list[Packets]()
    with (
        static_host(tmp_path) as host,
        opened(f"{host}/s", config=QUICK, adaptive=adaptive) as source,
    ):
        packets = source.packets()
        if adaptive:
            came.append(next(packets))
        shutil.copytree(tmp_path / "s", tmp_path / "old")
        shutil.rmtree(tmp_path / "s")
        (tmp_path / "new").rename(tmp_path / "s")
        with pytest.raises(SwingsError) as caught:
            came += packets
    assert isinstance(caught.value, CorruptError)
    assert "/s: the stream was replaced by another one; play it again" in str(caught.value)
    for one in came:
        check_packets(StreamReader(tmp_path / "old"), one)
