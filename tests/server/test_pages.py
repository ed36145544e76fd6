"""Pages for users: all streams, and the player of each one; no client can manipulate them."""

from __future__ import annotations

import re
from base64 import b64encode
from dataclasses import replace
from hashlib import sha256
from html import unescape
from pathlib import Path
from urllib.parse import urljoin

import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from yarl import URL

from codec.errors import InvalidError
from codec.stream import StreamWriter
from server.answers import pages
from server.html.gallery import Card, card_html, clock_text
from server.html.webplayer import WebPlayer
from server.library import ServedStream
from tests.support.server.running_server import (
    append_frames,
    births_of,
    eventually,
    live_stream,
    make_stream,
    random_slice,
    raw_get,
    running,
    served,
    small_manifest,
)

pytestmark = pytest.mark.anyio


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("root")
    make_stream(folder / "walk", 12, title="A <walk> & back")
    make_stream(folder / "dance.2", 3)
    return folder


async def test_the_list_and_the_front_page_name_every_stream(root: Path) -> None:
    async with served(root) as (server, client):
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
            assert response.headers["Referrer-Policy"] == "no-referrer"
            policy = response.headers["Content-Security-Policy"].split("; ")
        assert {"base-uri 'none'", "form-action 'none'", "frame-ancestors 'none'"} <= set(policy)
        links = re.findall('class="card" href="([^"]*)"', page)
        assert links == ["watch/walk", "watch/dance.2"]  # by title
        assert "A &lt;walk&gt; &amp; back" in page
        assert "32 Gaussians, 4 layers, 30 fps" in page
        assert "<walk>" not in page
        assert server.url in page


async def test_a_poster_of_any_name_shows_on_the_front_page(tmp_path: Path) -> None:
    name = 'a "b" & <c>?.png'
    manifest = replace(small_manifest(), poster=name)
    with StreamWriter.create(tmp_path / "walk", manifest) as writer:
        for birth in births_of(1):
            writer.append(random_slice(birth, 8))
    (tmp_path / "walk" / name).write_bytes(b"\x89PNG\r\n\x1a\n and so on")

    async with served(tmp_path) as (server, client):
        async with client.get("/") as response:
            (picture,) = re.findall('<img src="([^"]*)"', await response.text())
        async with client.get(URL(f"{server.url}/{unescape(picture)}", encoded=True)) as response:
            assert (response.status, response.content_type) == (200, "image/png")


@pytest.mark.parametrize("fps", [1e-320, 1e-300])
async def test_a_stream_of_hardly_any_frames_a_second_leaves_the_front_page_alone(
    tmp_path: Path, fps: float
) -> None:
    make_stream(tmp_path / "slow", 3)
    make_stream(tmp_path / "walk", 12)
    manifest = tmp_path / "slow" / "manifest.json"
    text = manifest.read_text()
    assert '"fps": 30' in text
    manifest.write_text(re.sub('"fps": [0-9.]+', f'"fps": {fps}', text))

    async with served(tmp_path) as (_, client):
        async with client.get("/") as response:
            assert response.status == 200
            assert re.findall('href="watch/([^"]*)"', await response.text()) == ["walk"]
            page = await client.get("/")
            assert "1 stream cannot be played" in await page.text()
        async with client.get("/v1/streams") as response:
            (broken,) = (await response.json())["broken"]
        assert broken["name"] == "slow"
        assert "fps" in broken["reason"]


async def test_a_card_that_cannot_be_made_shows_its_name_among_the_others(
    root: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def about(stream: ServedStream) -> str:
        if stream.name == "walk":
            raise OverflowError("cannot convert float infinity to integer")
        return "what it has"

    monkeypatch.setattr(pages, "_about", about)

    async with served(root) as (_, client):
        async with client.get("/") as response:
            page = await response.text()
        assert response.status == 200
        assert re.findall('href="watch/([^"]*)"', page) == ["walk", "dance.2"]
        assert page.count("what it has") == 1
        assert '<span class="title">walk</span>' in page
    assert "only the name of walk" in caplog.text


def test_a_length_that_is_not_known_is_not_shown() -> None:
    assert '<span class="tag">0:01.5</span>' in card_html(Card("walk", "Walk", seconds=1.5))
    assert "tag" not in card_html(Card("walk", "Walk"))


async def test_every_stream_has_a_page_that_plays_it(root: Path) -> None:
    async with served(root) as (server, client):
        async with client.get("/watch/walk") as response:
            page = await response.text()
            assert (response.status, response.content_type) == (200, "text/html")
            assert response.headers["Referrer-Policy"] == "no-referrer"
            policy = response.headers["Content-Security-Policy"]
        assert "unsafe" not in policy
        assert "blob:" not in policy
        assert "require-trusted-types-for 'script'; trusted-types swings-worker" in policy
        for kind in ("script", "style"):
            (text,) = re.findall(f"<{kind}>(.*?)</{kind}>", page, re.DOTALL)
            digest = b64encode(sha256(text.encode()).digest()).decode()
            assert f"'sha256-{digest}'" in policy
        assert page.count("<title>A &lt;walk&gt; &amp; back</title>") == 1
        assert "<walk>" not in page
        assert f"swings-play {server.url}/watch/walk<" in page
        async with client.head("/watch/walk") as head:
            assert (head.status, int(head.headers["Content-Length"])) == (200, len(page))
        scripts = set(re.findall('modulepreload" href="([^"]*)"', page))
        assert len(scripts) == 3
        assert set(re.findall('script type="module" src="([^"]*)"', page)) < scripts
        for script in scripts:
            asset = urljoin(f"{server.url}/watch/walk", script)
            async with client.get(asset, headers={"Accept-Encoding": "gzip"}) as response:
                assert (response.status, response.content_type) == (200, "text/javascript")
                assert response.headers["Cache-Control"] == "public, max-age=31536000, immutable"
                assert response.headers["Content-Encoding"] == "gzip"
                tag, content = response.headers["ETag"], await response.read()
            stem = f"{server.url}/web/bundle/{script.rpartition('/')[2]}"
            async with client.get(stem, headers={"Accept-Encoding": "identity"}) as response:
                assert response.headers["Cache-Control"] == "no-cache"
                assert "Content-Encoding" not in response.headers
                assert response.headers["ETag"] != tag
                assert await response.read() == content
            accepted = {"If-None-Match": tag, "Accept-Encoding": "gzip"}
            async with client.get(asset, headers=accepted) as response:
                assert response.status == 304


async def test_a_page_describes_itself_to_those_that_link_to_it(root: Path) -> None:
    async with served(root) as (server, client):
        async with client.get("/watch/walk") as response:
            page = await response.text()
        graph = dict(re.findall('<meta property="og:([^"]*)" content="([^"]*)">', page))
        assert graph["title"] == "A &lt;walk&gt; &amp; back"
        assert graph["url"] == f"{server.url}/watch/walk"
        assert graph["description"] == "32 Gaussians, 4 layers, 30 fps"
        (link,) = re.findall('type="application/json\\+oembed" href="([^"]*)"', page)
        async with client.get(link, params={"url": graph["url"], "maxwidth": "320"}) as response:
            found = await response.json()
        assert (found["version"], found["type"]) == ("1.0", "video")
        assert found["title"] == "A <walk> & back"
        assert (found["width"], found["height"]) == (320, 240)
        assert f'src="{server.url}/watch/walk"' in found["html"]
        assert 'title="A &lt;walk&gt; &amp; back" width="320"' in found["html"]
        (shown,) = re.findall('<pre id="code">(.*?)</pre>', page, re.DOTALL)
        assert found["html"].replace("320", "720").replace("240", "540") == unescape(shown)
        async with client.get(link, params={"maxheight": "120"}) as response:
            found = await response.json()
        assert (found["width"], found["height"]) == (160, 120)
        for query, status in (("format=xml", 501), ("maxwidth=-1", 400), ("maxheight=1e9", 400)):
            async with client.get(f"{link}?{query}") as response:
                assert response.status == status
                assert "error" in await response.json()


@pytest.mark.parametrize(("name", "kind"), [("poster.jpg", "JPEG"), ("a & b.png", "PNG")])
async def test_the_thumbnail_for_other_sites_is_the_poster(
    tmp_path: Path, name: str, kind: str
) -> None:
    """It has its size, or is omitted."""
    stream = tmp_path / "walk"
    with StreamWriter.create(stream, replace(small_manifest(), poster=name)) as writer:
        for birth in births_of(1):
            writer.append(random_slice(birth, 8))

    async with served(tmp_path) as (_, client):

        async def thumbnail(**query: str) -> dict[str, object]:
            async with client.get("/v1/streams/walk/oembed.json", params=query) as response:
                found = await response.json()
            return {key: found[key] for key in found if key.startswith("thumbnail")}

        assert await thumbnail() == {}
        (stream / name).write_bytes(b"no picture")
        assert await thumbnail() == {}
        Image.new("RGB", (160, 90)).save(stream / name, kind)
        found = await thumbnail()
        assert (found["thumbnail_width"], found["thumbnail_height"]) == (160, 90)
        async with client.get(URL(str(found["thumbnail_url"]), encoded=True)) as response:
            assert await response.read() == (stream / name).read_bytes()
        assert await thumbnail(maxwidth="160", maxheight="90") == found
        assert await thumbnail(maxwidth="159") == {}
        assert await thumbnail(maxheight="89") == {}


def test_where_the_player_is_not_whole_no_server_starts(tmp_path: Path) -> None:
    (tmp_path / "watch.html").write_text("<html></html>")
    for folder in (tmp_path, tmp_path / "nothing"):
        with pytest.raises(InvalidError, match="does not hold the browser player; reinstall"):
            WebPlayer(folder)


@given(st.floats(0, 1e6))
def test_lengths_as_players_show_them(seconds: float) -> None:
    text = clock_text(seconds)
    parts = [float(part) for part in text.split(":")]
    shown = sum(part * 60**n for n, part in enumerate(reversed(parts)))
    assert -1e-9 < seconds - shown < (0.1 if seconds < 10 else 1)
    assert re.fullmatch(r"0:0\d\.\d|(\d+:\d\d|[0-5]?\d):\d\d", text)


async def test_a_live_stream_says_so_on_the_front_page(tmp_path: Path) -> None:
    writer = live_stream(tmp_path / "live", fps=1)

    async with served(tmp_path) as (server, client):
        async with client.get("/") as response:
            page = await response.text()
        assert ">LIVE<" in page
        assert ">0:00.0<" in page
        append_frames(writer)
        await eventually(lambda: server.state.library.streams["live"].num_frames == 5)
        async with client.get("/") as response:
            assert ">0:05.0<" in await response.text()
        writer.close()


@pytest.mark.parametrize("name", ["nobody", "..", "%2e%2e", "walk%2f..", "<script>", "a" * 3000])
async def test_a_stream_that_is_not_there_has_a_page_that_says_so(root: Path, name: str) -> None:
    async with running(root) as server:
        head, body = await raw_get(server.port, f"/watch/{name}")
        assert head.startswith(b"HTTP/1.1 404 "), head
        assert b"Content-Type: text/html" in head
        assert b"Content-Security-Policy: default-src 'none'" in head
        assert b"frame-ancestors" not in head
        assert b"Referrer-Policy: no-referrer" in head
        assert b'<a href="../">' in body
        assert name == ".." or name.encode() not in body
