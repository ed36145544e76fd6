"""A stream's poster and sound over HTTP: only what its manifest names."""

from __future__ import annotations

import asyncio
import hashlib
import json
import wave
from dataclasses import replace
from pathlib import Path
from typing import cast
from urllib.parse import quote

import numpy as np
import pytest
import yarl

from codec.files import write_atomic
from codec.storage.storage import Stamp
from codec.stream import StreamReader
from codec.stream.pictures import MAX_PICTURE_BYTES
from codec.stream.sound import SAMPLE_RATE, SoundSource
from codec.tracks.streamtracks import add_sound
from server.library.servedstream import ServedStream
from server.operate.prometheus import Metrics
from server.state.caches import ObjectCache
from tests.support.server.running_server import fetch, make_stream, raw_get, running, served

pytestmark = pytest.mark.anyio

JPEG = b"\xff\xd8\xff" + bytes(range(256)) * 40


def stream_with_poster(root: Path, stream: str, poster: str | None) -> Path:
    path = make_stream(root / stream, 3)
    manifest = replace(StreamReader(path).manifest, poster=poster)
    write_atomic(path / "manifest.json", manifest.to_json())
    return path


@pytest.fixture
def root(tmp_path: Path) -> Path:
    folder = tmp_path / "root"
    path = stream_with_poster(folder, "walk", "poster.jpg")
    (path / "poster.jpg").write_bytes(JPEG)
    (path / "other.jpg").write_bytes(JPEG)
    (folder / "secret.jpg").write_bytes(b"not for you")
    return folder


URL = "/v1/streams/walk/poster.jpg"


async def test_it_is_served_like_the_other_files(root: Path) -> None:
    async with served(root) as (_, client):
        found = await fetch(client, URL)
        assert (found.status, found.body) == (200, JPEG)
        headers = {
            "ETag": f'"{hashlib.sha256(JPEG).hexdigest()}"',
            "Content-Type": "image/jpeg",
            "Cache-Control": "no-cache",
            "Accept-Ranges": "bytes",
            "X-Content-Type-Options": "nosniff",
            "Access-Control-Allow-Origin": "*",
        }
        assert {name: found.headers[name] for name in headers} == headers
        assert (await fetch(client, URL, "POST")).status == 405
        for name, what in (("none.jpg", "picture"), ("captions-en.vtt", "captions")):
            missing = await fetch(client, f"/v1/streams/walk/{name}")
            assert missing.status == 404
            assert f"walk has no {what} '{name}'" in missing.text


async def test_one_that_is_replaced_or_comes_later_is_served_as_it_is(root: Path) -> None:
    path = root / "walk" / "poster.jpg"
    async with served(root) as (_, client):
        tag = (await fetch(client, URL)).headers["ETag"]
        write_atomic(path, JPEG + b"more")
        found = await fetch(client, URL, If_None_Match=tag)
        assert (found.status, found.body) == (200, JPEG + b"more")
        path.unlink()
        assert (await fetch(client, URL)).status == 404
        for size, status in ((MAX_PICTURE_BYTES, 200), (MAX_PICTURE_BYTES + 1, 404)):
            write_atomic(path, bytes(size))
            assert (await fetch(client, URL)).status == status


@pytest.mark.parametrize(
    ("name", "content_type"),
    [
        ("art/front view.PNG", "image/png"),
        ("é#?%.webp", "image/webp"),
        ("segments/0/0.jpeg", "image/jpeg"),
    ],
)
async def test_its_path_and_its_name_give_its_url_and_its_type(
    name: str, content_type: str, tmp_path: Path
) -> None:
    path = stream_with_poster(tmp_path, "walk", name) / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(JPEG)

    async with served(tmp_path) as (server, client):
        url = yarl.URL(f"{server.url}/v1/streams/walk/{quote(name)}", encoded=True)
        found = await fetch(client, url)
        assert (found.status, found.body) == (200, JPEG)
        assert found.headers["Content-Type"] == content_type


async def test_no_other_picture_is_served(root: Path) -> None:
    others = (
        "other.jpg poster.jpeg POSTER.JPG poster.jpg/ x/../poster.jpg ../secret.jpg poster.jpg%00"
    )
    async with running(root) as server:
        for path in (*(f"walk/{name}" for name in others.split()), "nobody/poster.jpg"):
            head, body = await raw_get(server.port, f"/v1/streams/{path}")
            assert head.startswith(b"HTTP/1.1 404 "), path
            assert len(json.loads(body)["error"]) < 200


@pytest.mark.parametrize(
    "poster",
    [None, "", "manifest.json", "index.bin", "segments/0/0", "page.html", "page.svg",
     "../secret.jpg", "x/../poster.jpg", "link.jpg", "out/secret.jpg"],
)  # fmt: skip
async def test_what_a_manifest_should_not_name_is_not_a_poster(
    poster: str | None, tmp_path: Path
) -> None:
    path = stream_with_poster(tmp_path, "walk", poster)
    (tmp_path / "secret.jpg").write_bytes(b"not for you")
    for name in ("page.html", "page.svg", "poster.jpg"):
        (path / name).write_bytes(b"<script>")
    (path / "link.jpg").symlink_to(tmp_path / "secret.jpg")
    (path / "out").symlink_to(tmp_path)

    async with running(tmp_path) as server:
        for name in {poster or "poster.jpg", "poster.jpg"}:
            head, body = await raw_get(server.port, f"/v1/streams/walk/{name}")
            assert b"not for you" not in body
            assert b"<script>" not in body
            if name not in ("manifest.json", "index.bin", "segments/0/0"):
                assert head.startswith(b"HTTP/1.1 404 "), head
            assert b"image/" not in head


async def test_they_are_served_like_the_other_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = make_stream(tmp_path / "root" / "walk", 3)
    with wave.open(str(tmp_path / "in.wav"), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(SAMPLE_RATE)
        tone = 8000 * np.sin(np.arange(9000) / 10)
        file.writeframes(tone.astype("<i2").tobytes())
    add_sound(path, tmp_path / "in.wav", SoundSource("main", 2))
    sound = (path / "segments" / "0" / "audio-main").read_bytes()
    (path / "segments" / "0" / "audio-other").write_bytes(sound)
    broken = make_stream(tmp_path / "root" / "broken", 3)
    add_sound(broken, tmp_path / "in.wav", SoundSource("main", 2))
    (broken / "segments" / "0" / "audio-main").write_bytes(sound[:-1])

    async with served(tmp_path / "root") as (_, client):
        url = "/v1/streams/walk/segments/0/audio-main"
        found = await fetch(client, url)
        assert (found.status, found.body) == (200, sound)
        assert found.headers["Cache-Control"] == "no-cache"
        assert (await fetch(client, url, If_None_Match=found.headers["ETag"])).status == 304
        for name in ("0/audio-other", "0/audio-", "0/audio-Main", "999/audio-main"):
            assert (await fetch(client, f"/v1/streams/walk/segments/{name}")).status == 404
        damaged = await fetch(client, "/v1/streams/broken/segments/0/audio-main")
        assert damaged.status == 500
        with monkeypatch.context() as patch:
            patch.setattr(ServedStream, "read_sound", None)  # cached objects are not read again
            assert (await fetch(client, url)).body == sound
        add_sound(broken, tmp_path / "in.wav", SoundSource("other", 1))
        other = (broken / "segments" / "0" / "audio-other").read_bytes()
        assert other != sound
        write_atomic(path / "segments" / "0" / "audio-main", other)
        assert (await fetch(client, url)).body == other


def test_the_cache_drops_the_least_recently_used() -> None:
    class Shelf:
        """A library with objects of 10 bytes."""

        generation = 1
        reads = 0

        def sound_stamp(self, segment: int, name: str) -> Stamp:
            return Stamp(10, (segment,))

        def read_sound(self, segment: int, name: str) -> bytes:
            self.reads += 1
            return bytes([segment]) * 10

    async def check() -> None:
        shelf = Shelf()
        stream, cache = cast(ServedStream, shelf), ObjectCache(25, Metrics())
        for segment, reads in ((0, 1), (1, 2), (0, 2), (2, 3), (0, 3), (1, 4)):
            content = await cache.load_sound(stream, segment, "audio-main")
            assert (content.data, shelf.reads) == (bytes([segment]) * 10, reads)
            assert cache.size_bytes <= 25

    asyncio.run(check())
