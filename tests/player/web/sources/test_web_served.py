"""The page of swings-serve in Chromium plays as expected, over any network."""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from email.message import Message
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from codec.stream import StreamReader, StreamWriter
from codec.stream.playrecord import SliceRecord, StartRecord, encode_record
from player.link.linkprocess import LinkProcess
from server.abr.link.link import Link, LinkStep
from tests.support.hosted_streams import (
    ServerProcess,
    answering,
    random_slice,
    served,
    small_manifest,
    static_host,
    write_stream,
)
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout
from tests.support.web.canvas import (
    ELEMENT,
    LEAST_PSNR_DB,
    PIXELS,
    PLAYER,
    STATE,
    canvas_of,
    expected_of,
    psnr_db,
)
from tests.support.web.chromium import Page

ROOT = Path(__file__).parents[4]
WIDTH_PX, HEIGHT_PX = 480, 320
NUM_FRAMES = 600
SLICE_SIZE = 500
ROOT_NODE = f"{ELEMENT}.shadowRoot"


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two streams of 20 s: whole slices of 2,000 Gaussians a frame, and slots that last."""
    folder = tmp_path_factory.mktemp("served")
    write_stream(folder / "slices", NUM_FRAMES, SLICE_SIZE)
    write_busy_stream(folder / "slots", NUM_FRAMES, small_layout(1, (20, 20, 10), 0, 15))
    return folder


@pytest.fixture(scope="module")
def server(root: Path) -> Iterator[ServerProcess]:
    with served(root) as running:
        yield running


@contextmanager
def watching(page: Page, url: str, name: str, query: str = "") -> Iterator[Page]:
    """Opens the page of a stream, and waits until a frame shows."""
    page.open(f"{url}/watch/{name}{query}", WIDTH_PX, HEIGHT_PX, scripts=[PIXELS])
    page.wait(f"{PLAYER}?.shownFrame >= 0", 60)
    yield page
    assert not page.complaints


def chosen(part: str) -> str:
    return f"{ROOT_NODE}.querySelector('{part}')"


@pytest.mark.parametrize("name", [pytest.param("slices", marks=pytest.mark.slow), "slots"])
def test_it_plays_as_a_person_drives_it(page: Page, server: ServerProcess, name: str) -> None:
    with watching(page, server.url, name, "?autoplay=0"):
        assert page.run("return document.title") == name
        page.click("swings-player .play")
        page.wait(f"{STATE}.frame >= 10", 60)
        page.press("k")
        page.wait(f"!{STATE}.playing")
        page.press("Home")
        page.wait(f"{PLAYER}.shownFrame === 0", 30)
        page.press("ArrowRight")  # a tenth of 20 s
        page.wait(f"{PLAYER}.shownFrame === 60", 30)
        page.run(
            f"{chosen('.scrub')}.value = 411; {chosen('.scrub')}.dispatchEvent(new Event('change'))"
        )
        page.wait(f"{PLAYER}.shownFrame === 411", 30)
        page.press("End")
        page.wait(f"{PLAYER}.shownFrame === {NUM_FRAMES - 1}", 30)
        page.press("k")  # loops
        page.wait(f"{STATE}.playing && {PLAYER}.shownFrame < 200", 30)


def test_the_body_is_coded_as_the_browser_asks(page: Page, server: ServerProcess) -> None:
    with watching(page, server.url, "slices", "?autoplay=0"):
        url = f"{server.url}/v1/streams/slices/play?plain=1&until=5"
        coding = page.run("return (await fetch(value)).headers.get('Content-Encoding')", url)
        assert coding in ("zstd", "gzip")


@pytest.mark.parametrize(("name", "frame"), [("slices", 0), ("slices", 77), ("slots", 77)])
def test_the_picture_is_the_cpu_renderer_s_with_all_layers_though_it_is_paused(
    page: Page, server: ServerProcess, root: Path, name: str, frame: int
) -> None:
    reader = StreamReader(root / name)
    with watching(page, server.url, name, f"?autoplay=0&t={(frame + 0.1) / 30}"):
        page.wait(f"{PLAYER}.shownFrame === {frame}", 30)
        width_px, height_px = page.run(f"return [{PLAYER}.canvas.width, {PLAYER}.canvas.height]")
        expected = expected_of(reader, reader.manifest.camera().fitted(width_px, height_px), frame)
        found_db = 0.0
        for _ in range(100):
            found_db = psnr_db(canvas_of(page), expected)
            if found_db >= LEAST_PSNR_DB:
                page.wait(f"{STATE}.layers === {reader.manifest.num_layers}")
                return
            time.sleep(0.1)
        raise AssertionError(f"{found_db} dB")


@pytest.mark.parametrize("name", [pytest.param("slices", marks=pytest.mark.slow), "slots"])
def test_another_number_of_layers_does_not_begin_anew(
    page: Page, server: ServerProcess, name: str
) -> None:
    choose = f"const menu = {chosen('.quality')}; menu.value = value;" + (
        "menu.dispatchEvent(new Event('change'))"
    )
    drawn = f"{PLAYER}.renderer.numDrawn"
    with watching(page, server.url, name):
        page.run(
            "window.shown = [];"
            f"{PLAYER}.addEventListener('shown', () => shown.push({PLAYER}.shownFrame))"
        )
        page.wait(f"{STATE}.frame > 30")
        page.run(choose, "1")
        page.wait(f"{STATE}.frame > 240", 60)  # frames received with more layers have been shown
        page.wait(f"{STATE}.layers === 1")
        few = page.run(f"return {drawn}")
        page.run(choose, "0")
        page.wait(f"{drawn} > 1.5 * {few} && {STATE}.layers === 3", 60)
        shown = page.run("return shown")
        assert shown == sorted(set(shown))
        assert page.run(f"return {STATE}.stalls") == 0


def test_three_seconds_without_a_network(page: Page, server: ServerProcess) -> None:
    with watching(page, server.url, "slots"):
        page.wait(f"{STATE}.endFrame - {STATE}.frame > 150", 60)
        page.set_offline(True)
        frame, stalls = page.run(f"return [{STATE}.frame, {STATE}.stalls]")
        time.sleep(3)
        page.set_offline(False)
        page.wait(f"{STATE}.frame > {frame + 60}")
        page.wait(f"{STATE}.endFrame - {STATE}.frame > 150", 30)
        assert page.run(f"return {STATE}.stalls") == stalls


def test_a_server_that_is_killed_and_comes_back(page: Page, root: Path) -> None:
    with served(root) as first:
        page.open(f"{first.url}/watch/slots", WIDTH_PX, HEIGHT_PX)
        page.wait(f"{STATE}?.endFrame - {STATE}?.frame > 100", 60)
        first.kill()
        end = page.run(f"return {STATE}.endFrame")
        page.wait(f"{chosen('.note.soft')}.textContent.includes('trying again')", 30)
        second = ServerProcess(root, first.port)
        try:
            page.wait(f"{chosen('.note.soft')}.textContent === ''", 30)
            page.wait(f"{STATE}.endFrame > {end + 30}", 30)
            page.wait(f"{PLAYER}.shownFrame > {end + 10}", 30)
        finally:
            second.kill()


@contextmanager
def breaking_server(root: Path, folder: Path) -> Iterator[tuple[str, list[Message]]]:
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
            self.wfile.write(play_body(root))
            self.wfile.flush()
            reported.acquire(timeout=30)

        def do_POST(self) -> None:
            self.rfile.read(int(self.headers["Content-Length"]))
            self.send_response(204)
            self.send_header("Swings-Rate", "12345678")
            self.end_headers()
            reported.release()

        def log_message(self, format: str, *args: object) -> None:
            pass

    (folder / "web").symlink_to(ROOT / "player" / "web")
    host = ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, directory=str(folder)))
    with answering(host):
        try:
            yield f"http://127.0.0.1:{host.server_port}", asked
        finally:
            reported.release(1000)


def test_a_play_goes_on_with_what_the_last_server_said_of_the_link(
    page: Page, root: Path, tmp_path: Path
) -> None:
    with breaking_server(root, tmp_path) as (url, asked):
        page.open(f"{url}/web/watch.html?src=/v1/streams/any", WIDTH_PX, HEIGHT_PX)
        until_s = time.monotonic() + 30
        while not (asked and asked[-1]["Swings-Rate"]):
            assert time.monotonic() < until_s, [one.items() for one in asked]
            time.sleep(0.05)
        assert asked[0]["Swings-Rate"] is None
        assert asked[0]["Swings-Play"] is None
        assert asked[-1]["Swings-Rate"] == "12345678"
        assert asked[-1]["Swings-Play"] == f"play-{len(asked) - 1}"
        page.open("about:blank")


def test_a_link_of_12_4_and_12_mbit_s_without_a_stall(
    page: Page, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """The stream has about 7 Mbit/s: the drop is below it, but above its first layers."""
    folder = tmp_path_factory.mktemp("link")
    write_stream(folder / "stream", 300, 330)
    reader = StreamReader(folder / "stream")
    size = sum(sum(record.object_bytes) for record in reader.records)
    assert 6e6 < 8 * size / 10 < 8e6
    steps = [LinkStep(3, 12e6, 0.02), LinkStep(3, 4e6, 0.02), LinkStep(60, 12e6, 0.02)]
    with (
        served(folder) as server,
        LinkProcess(Link(steps), "127.0.0.1", server.port) as link,
    ):
        host, port = link.address
        with watching(page, f"http://{host}:{port}", "stream", "?loop=0"):
            page.wait(f"{STATE}.frame >= 299", 60)
            assert page.run(f"return {STATE}.stalls") == 0


def test_a_live_stream_is_followed_to_its_end(page: Page, tmp_path: Path) -> None:
    manifest = small_manifest(fps=30, live=True)
    writer = StreamWriter.create(tmp_path / "live", manifest)
    for birth in range(1 - manifest.swin_size, 60):
        writer.append(random_slice(birth))

    def publish() -> None:
        for birth in range(60, 240):
            writer.append(random_slice(birth))
            time.sleep(1 / 40)
        writer.close()

    with served(tmp_path) as server:
        thread = threading.Thread(target=publish)
        with watching(page, server.url, "live"):
            assert page.run(f"return {chosen('.badge')}.checkVisibility()")
            assert page.run(f"return {PLAYER}.shownFrame") > 0  # at the edge, not at the beginning
            thread.start()
            page.wait(f"{PLAYER}.numFrames > 150", 30)
            page.wait(f"!{PLAYER}.live", 30)
            thread.join()
            assert page.run(f"return {PLAYER}.numFrames") == 240
            page.wait(f"{PLAYER}.shownFrame === 239 || {PLAYER}.shownFrame < 30", 30)
            assert not page.run(f"return {chosen('.badge')}.checkVisibility()")


def test_what_is_not_there_and_what_is_no_stream(page: Page, server: ServerProcess) -> None:
    page.open(f"{server.url}/web/watch.html?src=/v1/streams/nobody", WIDTH_PX, HEIGHT_PX)
    page.wait(f"{chosen('.note:not(.soft)')}.textContent.includes('HTTP 404')", 30)


def play_body(root: Path) -> bytes:
    manifest = (root / "slices" / "manifest.json").read_bytes()
    records = [StartRecord(0, NUM_FRAMES, manifest)]
    return b"".join(map(encode_record, records))


@pytest.mark.parametrize("kind", ["noise", "flipped", "nothing", "far ahead", "too many layers"])
def test_a_hostile_server(page: Page, root: Path, tmp_path: Path, kind: str) -> None:
    """The page reports the error; it does not break, and does not hang."""
    body = play_body(root)
    rng = random.Random(kind)
    if kind == "noise":
        body = rng.randbytes(1000)
    elif kind == "flipped":
        body = body[:9] + bytes([body[9] ^ 0x55]) + body[10:]
    elif kind == "nothing":
        body += encode_record(SliceRecord(0, (b"",), b""))
    elif kind == "far ahead":
        body += encode_record(SliceRecord(2**31 - 1, (b"some bytes",), b""))
    else:
        body += encode_record(SliceRecord(-3, (b"some bytes",) * 9, b""))
    (tmp_path / "web").symlink_to(ROOT / "player" / "web")
    plays = tmp_path / "v1" / "streams" / "any"
    plays.mkdir(parents=True)
    (plays / "play").write_bytes(body)
    with static_host(tmp_path) as url:
        page.open(f"{url}/web/watch.html?src=/v1/streams/any", WIDTH_PX, HEIGHT_PX)
        said = f"({chosen('.note:not(.soft)')}?.textContent || {chosen('.note.soft')}?.textContent)"
        page.wait(f"Boolean({said})", 30)
        assert "player failed" not in page.run(f"return {said}")
        assert not page.complaints
