"""The page of swings-serve in Chromium plays as expected, over any network."""

from __future__ import annotations

import random
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from email.message import Message
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from itertools import pairwise
from pathlib import Path

import pytest

from codec.stream import StreamReader, StreamWriter
from codec.stream.playrecord import SliceRecord, StartRecord, encode_record
from player.link.linkprocess import LinkProcess
from server.abr.link import Link, LinkStep
from tests.support.hosted_streams import (
    ServerProcess,
    answering,
    random_slice,
    served,
    small_manifest,
    write_stream,
)
from tests.support.waiting import BOUND_S, wait_until
from tests.support.web.canvas import wait_for_picture
from tests.support.web.chromium import Page
from tests.support.web.site import (
    LINKS,
    LONG_FRAMES,
    SLOW_DOWN,
    WHOLE_FRAMES,
    Site,
    player_host,
    watch,
)


@pytest.mark.parametrize(("name", "num_frames"), [("whole", WHOLE_FRAMES), ("long", LONG_FRAMES)])
def test_it_plays_as_a_person_drives_it(
    page: Page, server: ServerProcess, name: str, num_frames: int
) -> None:
    watch(page, f"{server.url}/watch/{name}?autoplay=0", 480, 320)
    assert page.value("document.title") == name
    page.click("swings-player .play")
    page.wait("state.frame >= 10")
    page.press("k")
    page.wait("!state.playing")
    page.press("Home")
    page.wait("player.shownFrame === 0")
    page.press("ArrowRight")
    page.wait(f"player.shownFrame === {num_frames // 10}")
    page.run("part('.scrub').value = value; part('.scrub').dispatchEvent(new Event('change'))", 41)
    page.wait("player.shownFrame === 41")
    page.press("End")
    page.wait(f"player.shownFrame === {num_frames - 1}")
    page.press("k")  # loops
    page.wait(f"state.playing && player.shownFrame < {num_frames - 10}")


@pytest.mark.parametrize(("name", "frame"), [("whole", 0), ("whole", 37), ("long", 77)])
def test_the_picture_is_the_cpu_renderer_s_with_all_layers_though_it_is_paused(
    page: Page, server: ServerProcess, site: Site, name: str, frame: int
) -> None:
    reader = site.reader(name)
    layers = reader.manifest.num_layers
    watch(page, f"{server.url}/watch/{name}?autoplay=0&t={(frame + 0.1) / 30}")
    wait_for_picture(page, reader, frame, layers)
    page.wait(f"state.layers === {layers}")


def test_another_number_of_layers_does_not_begin_anew(page: Page, server: ServerProcess) -> None:
    choose = "element.layers = value"
    watch(page, f"{server.url}/watch/long", 480, 320)
    page.run(
        "window.shown = []; element.playbackRate = 3; element.layers = value;"
        "player.addEventListener('shown', () => shown.push(player.shownFrame))",
        2,  # all three would leave the choice to the server, which goes by a busy machine
    )
    page.wait("state.frame > 30 && state.layers === 2")
    many = page.value("player.renderer.numDrawn")
    page.run(choose, 1)
    page.wait(f"player.renderer.numDrawn < {many} / 1.5 && state.layers === 1")
    page.run(choose, 2)
    page.wait(f"player.renderer.numDrawn > {many} / 1.5 && state.layers === 2")
    for frame, after in pairwise(page.value("shown")):
        assert frame < after or (frame > LONG_FRAMES - 90 and after < 90), "a loop, if anything"


def test_a_server_that_is_killed_and_comes_back(page: Page, site: Site) -> None:
    page.expect("ERR_CONNECTION_REFUSED", "ERR_CONNECTION_RESET", "ERR_EMPTY_RESPONSE")
    page.expect("ERR_INCOMPLETE_CHUNKED_ENCODING")
    root = site.folder / "trained"
    note = "part('.note.soft').textContent"
    with served(root) as first:
        watch(page, f"{first.url}/watch/long")
        page.wait(f"state.endFrame - state.frame > 100 && {SLOW_DOWN}")
        first.kill()
        end = page.value("state.endFrame")
        page.run("element.playbackRate = 3")
        page.wait(f"{note}.includes('trying again')")
        second = ServerProcess(root, first.port)
        try:
            page.wait(f"{note} === '' && state.endFrame > {end + 30}")
            page.wait(f"player.shownFrame > {end + 10}")
        finally:
            second.kill()


@pytest.fixture
def start(site: Site) -> bytes:
    """The begin of a play of the stream "whole"."""
    manifest = (site.folder / "trained" / "whole" / "manifest.json").read_bytes()
    return encode_record(StartRecord(0, WHOLE_FRAMES, manifest))


@contextmanager
def breaking_server(start: bytes, folder: Path) -> Iterator[tuple[str, list[Message]]]:
    """A host of the stream `any` whose plays begin, and break off after the client has reported its
    status; gives its URL, and the request headers of plays."""
    asked: list[Message] = []
    reported = threading.Semaphore(0)

    class Handler(SimpleHTTPRequestHandler):
        def do_GET(self) -> None:
            if not self.path.startswith("/v1/streams/any/play?"):
                super().do_GET()
                return
            asked.append(self.headers)
            self.send_response(200)
            self.send_header("Swings-Play", f"play-{len(asked)}")
            self.end_headers()
            self.wfile.write(start)
            self.wfile.flush()
            reported.acquire(timeout=BOUND_S)

        def do_POST(self) -> None:
            self.rfile.read(int(self.headers["Content-Length"]))
            self.send_response(204)
            self.send_header("Swings-Rate", "12345678")
            self.end_headers()
            reported.release()

        def log_message(self, format: str, *args: object) -> None:
            pass

    (folder / "player").symlink_to(LINKS["player"])
    host = ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, directory=str(folder)))
    with answering(host):
        try:
            yield f"http://127.0.0.1:{host.server_port}", asked
        finally:
            reported.release(1000)


def test_a_play_goes_on_with_what_the_last_server_said_of_the_link(
    page: Page, start: bytes, tmp_path: Path
) -> None:
    page.expect("ERR_")
    with breaking_server(start, tmp_path) as (url, asked):
        page.open(f"{url}/player/watch.html?src=/v1/streams/any", 160, 120)
        wait_until(lambda: any(one["Swings-Rate"] for one in asked))
        first, *_, last = found = list(asked)
        assert (first["Swings-Rate"], first["Swings-Play"]) == (None, None)
        assert last["Swings-Rate"] == "12345678"
        assert last["Swings-Play"] == f"play-{len(found) - 1}"
        page.open("about:blank")


@pytest.mark.realtime
def test_a_link_of_12_4_and_12_mbit_s_without_a_stall(page: Page, tmp_path: Path) -> None:
    """The stream has about 7 Mbit/s: the drop is below it, but above its first layers."""
    write_stream(tmp_path / "stream", 300, 330)
    reader = StreamReader(tmp_path / "stream")
    size = sum(sum(record.object_bytes) for record in reader.records)
    assert 6e6 < 8 * size / 10 < 8e6
    steps = [LinkStep(3, 12e6, 0.02), LinkStep(3, 4e6, 0.02), LinkStep(60, 12e6, 0.02)]
    with served(tmp_path) as server, LinkProcess(Link(steps), "127.0.0.1", server.port) as link:
        host, port = link.address
        watch(page, f"http://{host}:{port}/watch/stream?loop=0", 480, 320)
        page.wait("state.frame >= 299")
        assert page.value("state.stalls") == 0


def test_a_live_stream_is_followed_to_its_end(page: Page, tmp_path: Path) -> None:
    manifest = small_manifest(fps=30, live=True)
    writer = StreamWriter.create(tmp_path / "live", manifest)

    def append(births: range) -> None:
        for birth in births:
            writer.append(random_slice(birth))

    append(range(1 - manifest.swin_size, 60))
    with served(tmp_path) as server:
        watch(page, f"{server.url}/watch/live", 480, 320)
        assert page.value("part('.badge').checkVisibility()")
        assert page.value("player.shownFrame") > 0  # at the edge, not at the beginning
        append(range(60, 120))
        page.wait("player.numFrames > 90")
        append(range(120, 150))
        writer.close()
        page.wait("!player.live")
        assert page.value("player.numFrames") == 150
        page.run("element.playbackRate = 3")
        page.wait("player.shownFrame === 149 || player.shownFrame < 30")
        assert not page.value("part('.badge').checkVisibility()")


def test_what_is_not_there_and_what_is_no_stream(page: Page, server: ServerProcess) -> None:
    page.expect("404")
    page.open(f"{server.url}/web/bundle/watch.html?src=/v1/streams/nobody", 160, 120)
    page.wait("part('.note:not(.soft)').textContent.includes('HTTP 404')")


HOSTILE: dict[str, Callable[[bytes], bytes]] = {
    "noise": lambda start: random.Random("noise").randbytes(1000),
    "flipped": lambda start: start[:9] + bytes([start[9] ^ 0x55]) + start[10:],
    "nothing": lambda start: start + encode_record(SliceRecord(0, (b"",), b"")),
    "far ahead": lambda start: start + encode_record(SliceRecord(2**31 - 1, (b"some",), b"")),
    "too many layers": lambda start: start + encode_record(SliceRecord(-3, (b"some",) * 9, b"")),
}
"""What a server sends, of the begin of a play."""


@pytest.mark.parametrize("kind", HOSTILE)
def test_a_hostile_server(page: Page, start: bytes, tmp_path: Path, kind: str) -> None:
    """The page reports the error; it does not break, and does not hang."""
    page.expect("404", "501")
    plays = tmp_path / "v1" / "streams" / "any"
    plays.mkdir(parents=True)
    (plays / "play").write_bytes(HOSTILE[kind](start))
    with player_host(tmp_path) as url:
        page.open(f"{url}/player/watch.html?src=/v1/streams/any", 160, 120)
        said = "(part('.note:not(.soft)')?.textContent || part('.note.soft')?.textContent)"
        page.wait(said)
        assert "player failed" not in page.value(said)
