"""Pages for people: all streams, and the player of each one; no client can bend them."""

from __future__ import annotations

import asyncio
import json
import re
from dataclasses import replace
from html import unescape
from pathlib import Path
from urllib.parse import urljoin

import aiohttp
import pytest
from hypothesis import given
from hypothesis import strategies as st
from yarl import URL

from codec.errors import InvalidError
from codec.stream import StreamWriter
from server.answers import pages
from server.html.gallery import Card, card_html, clock_text
from server.html.webplayer import WebPlayer
from server.library import ServedStream
from tests.support.server.running_server import (
    SEGMENT_FRAMES,
    Running,
    births_of,
    make_stream,
    on_server,
    random_slice,
    raw_request,
    small_manifest,
)


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("root")
    make_stream(folder / "walk", 12, title="A <walk> & back")
    make_stream(folder / "dance.2", 3)
    return folder


def test_the_list_and_the_front_page_name_every_stream(root: Path) -> None:
    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        async with client.get("/v1/streams") as response:
            listed = (await response.json())["streams"]
        assert [one["name"] for one in listed] == ["dance.2", "walk"]
        assert listed[1]["num_frames"] == 12
        assert listed[1]["num_layers"] == 4
        async with client.get(listed[1]["manifest"]) as response:
            assert (await response.json())["title"] == "A <walk> & back"
        async with client.get("/") as response:
            page = await response.text()
            assert response.content_type == "text/html"
        links = re.findall('class="card" href="([^"]*)"', page)
        assert links == ["watch/dance.2", "watch/walk"]
        assert "A &lt;walk&gt; &amp; back" in page
        assert "32 Gaussians, 4 layers, 30 fps" in page
        assert "<walk>" not in page
        assert server.url in page

    on_server(root, check)


def test_a_poster_of_any_name_shows_on_the_front_page(tmp_path: Path) -> None:
    name = 'a "b" & <c>?.png'
    manifest = replace(small_manifest(), poster=name)
    with StreamWriter.create(tmp_path / "walk", manifest) as writer:
        for birth in births_of(1):
            writer.append(random_slice(birth, 8))
    (tmp_path / "walk" / name).write_bytes(b"\x89PNG\r\n\x1a\n and so on")

    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        async with client.get("/") as response:
            (picture,) = re.findall('<img src="([^"]*)"', await response.text())
        async with client.get(URL(f"{server.url}/{unescape(picture)}", encoded=True)) as response:
            assert (response.status, response.content_type) == (200, "image/png")

    on_server(tmp_path, check)


@pytest.mark.parametrize("fps", [1e-320, 1e-300])
def test_a_stream_of_hardly_any_frames_a_second_leaves_the_front_page_alone(
    tmp_path: Path, fps: float
) -> None:
    make_stream(tmp_path / "slow", 3)
    make_stream(tmp_path / "walk", 12)
    manifest = tmp_path / "slow" / "manifest.json"
    text = manifest.read_text()
    assert '"fps": 30' in text
    manifest.write_text(re.sub('"fps": [0-9.]+', f'"fps": {fps}', text))

    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        async with client.get("/") as response:
            assert response.status == 200
            assert re.findall('href="watch/([^"]*)"', await response.text()) == ["walk"]
        async with client.get("/v1/streams") as response:
            (broken,) = (await response.json())["broken"]
        assert broken["name"] == "slow"
        assert "fps" in broken["reason"]

    on_server(tmp_path, check)


def test_a_card_that_cannot_be_made_shows_its_name_among_the_others(
    root: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def about(stream: ServedStream) -> str:
        if stream.name == "walk":
            raise OverflowError("cannot convert float infinity to integer")
        return "what it has"

    monkeypatch.setattr(pages, "_about", about)

    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        async with client.get("/") as response:
            page = await response.text()
        assert response.status == 200
        assert re.findall('href="watch/([^"]*)"', page) == ["dance.2", "walk"]
        assert page.count("what it has") == 1
        assert '<span class="title">walk</span>' in page

    on_server(root, check)
    assert "only the name of walk" in caplog.text


def test_a_length_that_is_not_known_is_not_shown() -> None:
    assert '<span class="tag">0:01</span>' in card_html(Card("walk", "Walk", seconds=1.5))
    assert "tag" not in card_html(Card("walk", "Walk"))


def test_every_stream_has_a_page_that_plays_it(root: Path) -> None:
    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        async with client.get("/watch/walk") as response:
            page = await response.text()
            assert (response.status, response.content_type) == (200, "text/html")
            policy = response.headers["Content-Security-Policy"]
        assert "default-src 'none'; script-src 'self' blob:" in policy
        assert page.count("<title>A &lt;walk&gt; &amp; back</title>") == 1
        assert "<walk>" not in page
        assert f"swings-play {server.url}/watch/walk<" in page
        async with client.head("/watch/walk") as head:
            assert (head.status, int(head.headers["Content-Length"])) == (200, len(page))
        (base,) = re.findall('<base href="([^"]*)"', page)
        scripts = re.findall('src="([^"]*)"', page)
        assert scripts
        for script in scripts:
            asset = urljoin(urljoin(f"{server.url}/watch/walk", base), script)
            async with client.get(asset) as response:
                assert (response.status, response.content_type) == (200, "text/javascript")
                tag = response.headers["ETag"]
            async with client.get(asset, headers={"If-None-Match": tag}) as response:
                assert response.status == 304

    on_server(root, check)


@pytest.mark.parametrize(
    "name", ["", "nothing.js", "../pages.py", "%2e%2e/__init__.py", "tsconfig.json", "a" * 3000]
)
def test_only_files_of_the_player_are_served(root: Path, name: str) -> None:
    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        request = f"GET /web/{name} HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n"
        answer = await raw_request(server.port, request.encode())
        assert answer.startswith(b"HTTP/1.1 404 "), answer

    on_server(root, check)


@pytest.mark.parametrize(
    ("path", "has", "lacks"),
    [
        ("/", ("base-uri 'none'", "form-action 'none'", "frame-ancestors 'none'"), ()),
        # Pages of other hosts show it in frames; it has a <base> of its own.
        ("/watch/walk", ("base-uri 'self'", "form-action 'none'"), ("frame-ancestors",)),
    ],
)
def test_what_pages_allow(
    root: Path, path: str, has: tuple[str, ...], lacks: tuple[str, ...]
) -> None:
    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        async with client.get(path) as response:
            policy = response.headers["Content-Security-Policy"].split("; ")
            assert response.headers["Referrer-Policy"] == "no-referrer"
        assert set(has) <= set(policy)
        assert not [one for one in policy if one.startswith(lacks)]

    on_server(root, check)


def test_where_the_player_is_not_whole_no_server_starts(tmp_path: Path) -> None:
    (tmp_path / "watch.html").write_text("<html></html>")
    for folder in (tmp_path, tmp_path / "nothing"):
        with pytest.raises(InvalidError, match="does not hold the browser player; reinstall"):
            WebPlayer(folder)


@given(st.floats(0, 1e6))
def test_lengths_as_players_show_them(seconds: float) -> None:
    text = clock_text(seconds)
    parts = [int(part) for part in text.split(":")]
    assert sum(part * 60**n for n, part in enumerate(reversed(parts))) == int(seconds)
    assert re.fullmatch(r"(\d+:\d\d|[0-5]?\d):\d\d", text)


def test_a_live_stream_says_so_on_the_front_page(tmp_path: Path) -> None:
    writer = StreamWriter.create(tmp_path / "live", small_manifest(fps=1))

    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        async with client.get("/") as response:
            page = await response.text()
        assert ">LIVE<" in page
        assert ">0:00<" in page
        for birth in births_of(SEGMENT_FRAMES):
            writer.append(random_slice(birth, 8))
        await asyncio.sleep(0.05)
        async with client.get("/") as response:
            assert ">0:05<" in await response.text()
        writer.close()

    on_server(tmp_path, check)


@pytest.mark.parametrize("name", ["nobody", "..", "%2e%2e", "walk%2f..", "<script>", "a" * 3000])
def test_a_stream_that_is_not_there_has_a_page_that_says_so(root: Path, name: str) -> None:
    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        # Raw, because a client would tidy the path up.
        request = f"GET /watch/{name} HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n"
        answer = await raw_request(server.port, request.encode())
        head, _, body = answer.partition(b"\r\n\r\n")
        assert head.startswith(b"HTTP/1.1 404 "), head
        assert b"Content-Type: text/html" in head
        assert b"Content-Security-Policy: default-src 'none'" in head
        assert b"frame-ancestors" not in head
        assert b"Referrer-Policy: no-referrer" in head
        assert b'<a href="../">' in body
        assert name == ".." or name.encode() not in body

    on_server(root, check)


@pytest.mark.parametrize("host", ["", "a:99999999", "a:b", "a b", "<script>", "\xff", "x/../y"])
@pytest.mark.parametrize("path", ["/", "/watch/walk"])
def test_a_malformed_host_is_the_client_s_fault(
    root: Path, path: str, host: str, caplog: pytest.LogCaptureFixture
) -> None:
    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        request = f"GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n"
        answer = await raw_request(server.port, request.encode("latin-1"))
        assert answer.startswith(b"HTTP/1.1 400 "), answer
        assert "is not HOST" in json.loads(answer.partition(b"\r\n\r\n")[2])["error"]

    on_server(root, check)
    assert not caplog.records
