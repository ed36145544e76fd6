"""Pages for users: all streams, and the player of each one; no client can manipulate them."""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import AsyncIterator
from hashlib import sha256
from html import unescape
from pathlib import Path
from urllib.parse import urljoin

import aiohttp
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from yarl import URL

from codec.errors import InvalidError
from server.answers import pages
from server.html.htmlpages import Card, card_html, clock_text
from server.html.webplayer import WebPlayer
from server.library import ServedStream
from tests.server.test_poster_and_sound import stream_with_poster
from tests.support.server.running_server import (
    Running,
    append_frames,
    eventually,
    fetch,
    live_stream,
    make_stream,
    raw_get,
    served,
)

pytestmark = pytest.mark.anyio


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("root")
    make_stream(folder / "walk", 12, title="A <walk> & back")
    make_stream(folder / "dance.2", 3)
    make_stream(folder / "still", 1)
    return folder


Site = tuple[Running, aiohttp.ClientSession]


@pytest.fixture
async def site(root: Path) -> AsyncIterator[Site]:
    async with served(root) as site:
        yield site


async def test_the_list_and_the_front_page_name_every_stream(site: Site) -> None:
    server, client = site
    listed = (await fetch(client, "/v1/streams")).json()["streams"]
    assert [one["name"] for one in listed] == ["dance.2", "still", "walk"]
    assert (listed[2]["num_frames"], listed[2]["num_layers"]) == (12, 4)
    assert (await fetch(client, listed[2]["manifest"])).json()["title"] == "A <walk> & back"
    front = await fetch(client, "/")
    assert front.headers["Content-Type"].startswith("text/html")
    assert front.headers["Referrer-Policy"] == "no-referrer"
    policy = front.headers["Content-Security-Policy"].split("; ")
    assert {"base-uri 'none'", "form-action 'none'", "frame-ancestors 'none'"} <= set(policy)
    links = re.findall('class="card" href="([^"]*)"', front.text)
    assert links == ["watch/walk", "watch/dance.2", "watch/still"]  # by title
    still = front.text.partition('"watch/still"')[2]
    assert "up to 32 Gaussians, 4 layers</span>" in still
    assert "tag" not in still
    for text in ("A &lt;walk&gt; &amp; back", "up to 32 Gaussians, 4 layers, 30 fps", server.url):
        assert text in front.text
    assert "<walk>" not in front.text


async def test_cards_of_equal_titles_show_the_names_of_their_streams(tmp_path: Path) -> None:
    for name in ("take-1", "take-2", "Walk"):
        make_stream(tmp_path / name, 1, title="Walk")
    async with served(tmp_path) as (_, client):
        front = await fetch(client, "/")
    titles = re.findall('class="title">([^<]*)', front.text)
    assert sorted(titles) == ["Walk", "Walk (take-1)", "Walk (take-2)"]


async def test_a_poster_of_any_name_shows_on_the_front_page(tmp_path: Path) -> None:
    name = 'a "b" & <c>?.png'
    stream = stream_with_poster(tmp_path, "walk", name)
    (stream / name).write_bytes(b"\x89PNG\r\n\x1a\n and so on")
    async with served(tmp_path) as (server, client):
        (picture,) = re.findall('<img src="([^"]*)"', (await fetch(client, "/")).text)
        found = await fetch(client, URL(f"{server.url}/{unescape(picture)}", encoded=True))
        assert (found.status, found.headers["Content-Type"]) == (200, "image/png")


@pytest.mark.parametrize(
    ("prefix", "below"),
    [("/video", "/video"), ("/a/b/", "/a/b"), ("", ""), ("//x", ""), ("/<", "")],
)
async def test_what_chats_show_is_where_the_proxy_has_it_and_no_picture_before_it_is_drawn(
    tmp_path: Path, prefix: str, below: str
) -> None:
    stream = stream_with_poster(tmp_path, "walk", "poster.jpg")
    manifest = stream / "manifest.json"
    manifest.write_text(manifest.read_text().replace('"live": false', '"live": true'))
    async with served(tmp_path) as (server, client):
        for drawn in (False, True):
            if drawn:
                (stream / "poster.jpg").write_bytes(b"\xff\xd8\xff and so on")
            page = await fetch(client, "/watch/walk", X_Forwarded_Prefix=prefix)
            urls = dict(re.findall('property="og:(url|image)" content="([^"]*)"', page.text))
            assert urls["url"] == f"{server.url}{below}/watch/walk"
            picture = f"{server.url}{below}/v1/streams/walk/poster.jpg"
            assert urls.get("image") == (picture if drawn else None)
            assert ("poster=" in page.text) == drawn


async def test_a_stream_of_hardly_any_frames_a_second_leaves_the_front_page_alone(
    tmp_path: Path,
) -> None:
    make_stream(tmp_path / "slow", 3)
    make_stream(tmp_path / "walk", 12)
    manifest = tmp_path / "slow" / "manifest.json"
    altered = re.sub('"fps": 30[0-9.]*', '"fps": 1e-300', manifest.read_text())
    assert altered != manifest.read_text()
    manifest.write_text(altered)
    async with served(tmp_path) as (_, client):
        front = await fetch(client, "/")
        assert re.findall('href="watch/([^"]*)"', front.text) == ["walk"]
        assert "1 stream cannot be played" in front.text
        (broken,) = (await fetch(client, "/v1/streams")).json()["broken"]
        assert broken["name"] == "slow"
        assert "fps" in broken["reason"]


async def test_a_card_that_cannot_be_made_shows_its_name_among_the_others(
    site: Site, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def about(stream: ServedStream) -> str:
        if stream.name == "walk":
            raise OverflowError("cannot convert float infinity to integer")
        return "what it has"

    monkeypatch.setattr(pages, "_about", about)
    front = await fetch(site[1], "/")
    assert re.findall('href="watch/([^"]*)"', front.text) == ["walk", "dance.2", "still"]
    assert front.text.count("what it has") == 2
    assert '<span class="title">walk</span>' in front.text
    assert "only the name of walk" in caplog.text


def test_a_length_that_is_not_known_is_not_shown() -> None:
    assert '<span class="tag">0:01.5</span>' in card_html(Card("walk", "Walk", seconds=1.5))
    assert "tag" not in card_html(Card("walk", "Walk"))


async def test_every_stream_has_a_page_that_plays_it(site: Site) -> None:
    server, client = site
    watch = await fetch(client, "/watch/walk")
    page = watch.text
    assert watch.status == 200
    assert watch.headers["Content-Type"].startswith("text/html")
    assert watch.headers["Referrer-Policy"] == "no-referrer"
    policy = watch.headers["Content-Security-Policy"]
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
    head = await fetch(client, "/watch/walk", "HEAD")
    assert (head.status, int(head.headers["Content-Length"])) == (200, len(page))
    scripts = set(re.findall('modulepreload" href="([^"]*)"', page))
    assert len(scripts) == 5
    assert set(re.findall('script type="module" src="([^"]*)"', page)) < scripts
    for script in scripts:
        asset = urljoin(f"{server.url}/watch/walk", script)
        coded = await fetch(client, asset, Accept_Encoding="gzip")
        assert coded.headers["Content-Type"].startswith("text/javascript")
        assert coded.headers["Cache-Control"] == "public, max-age=31536000, immutable"
        assert coded.headers["Content-Encoding"] == "gzip"
        stem = f"{server.url}/web/bundle/{script.rpartition('/')[2]}"
        plain = await fetch(client, stem, Accept_Encoding="identity")
        assert plain.headers["Cache-Control"] == "no-cache"
        assert "Content-Encoding" not in plain.headers
        tag = coded.headers["ETag"]
        assert plain.headers["ETag"] != tag
        assert plain.body == coded.body
        again = await fetch(client, asset, Accept_Encoding="gzip", If_None_Match=tag)
        assert again.status == 304


async def test_a_page_describes_itself_to_those_that_link_to_it(site: Site) -> None:
    server, client = site
    page = (await fetch(client, "/watch/walk")).text
    graph = dict(re.findall('<meta property="og:([^"]*)" content="([^"]*)">', page))
    assert graph["title"] == "A &lt;walk&gt; &amp; back"
    assert graph["url"] == f"{server.url}/watch/walk"
    assert graph["description"] == "up to 32 Gaussians, 4 layers, 30 fps"
    (link,) = re.findall('type="application/json\\+oembed" href="([^"]*)"', page)
    found = (await fetch(client, f"{link}?url={graph['url']}&maxwidth=320")).json()
    assert (found["version"], found["type"]) == ("1.0", "video")
    assert found["title"] == "A <walk> & back"
    assert (found["width"], found["height"]) == (320, 240)
    assert f'src="{server.url}/watch/walk"' in found["html"]
    assert 'title="A &lt;walk&gt; &amp; back" width="320"' in found["html"]
    (shown,) = re.findall('<pre id="code">(.*?)</pre>', page, re.DOTALL)
    small, large = 'width="320" height="240"', 'width="720" height="540"'
    assert found["html"].replace(small, large) == unescape(shown)
    found = (await fetch(client, f"{link}?maxheight=120")).json()
    assert (found["width"], found["height"]) == (160, 120)
    for query, status in (("format=xml", 501), ("maxwidth=-1", 400), ("maxheight=1e9", 400)):
        refused = await fetch(client, f"{link}?{query}")
        assert refused.status == status
        assert "error" in refused.json()


@pytest.mark.parametrize(("name", "kind"), [("poster.jpg", "JPEG"), ("a & b.png", "PNG")])
async def test_the_thumbnail_for_other_sites_is_the_poster(
    tmp_path: Path, name: str, kind: str
) -> None:
    """It has its size, or is omitted."""
    stream = stream_with_poster(tmp_path, "walk", name)
    async with served(tmp_path) as (_, client):

        async def thumbnail(query: str = "") -> dict[str, object]:
            found = (await fetch(client, f"/v1/streams/walk/oembed.json?{query}")).json()
            return {key: found[key] for key in found if key.startswith("thumbnail")}

        assert await thumbnail() == {}
        (stream / name).write_bytes(b"no picture")
        assert await thumbnail() == {}
        Image.new("RGB", (160, 90)).save(stream / name, kind)
        found = await thumbnail()
        assert (found["thumbnail_width"], found["thumbnail_height"]) == (160, 90)
        picture = await fetch(client, URL(str(found["thumbnail_url"]), encoded=True))
        assert picture.body == (stream / name).read_bytes()
        assert await thumbnail("maxwidth=160&maxheight=90") == found
        assert await thumbnail("maxwidth=159") == await thumbnail("maxheight=89") == {}


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
        page = (await fetch(client, "/")).text
        assert ">LIVE<" in page
        assert ">0:00.0<" in page
        append_frames(writer)
        await eventually(lambda: server.state.library.streams["live"].num_frames == 5)
        assert ">0:05.0<" in (await fetch(client, "/")).text
        writer.close()


@pytest.mark.parametrize("name", ["nobody", "..", "%2e%2e", "walk%2f..", "<script>", "a" * 3000])
async def test_a_stream_that_is_not_there_has_a_page_that_says_so(site: Site, name: str) -> None:
    head, body = await raw_get(site[0].port, f"/watch/{name}")
    assert head.startswith(b"HTTP/1.1 404 "), head
    assert b"Content-Type: text/html" in head
    assert b"Content-Security-Policy: default-src 'none'" in head
    assert b"frame-ancestors" not in head
    assert b"Referrer-Policy: no-referrer" in head
    assert b'<a href="../">' in body
    assert name == ".." or name.encode() not in body
