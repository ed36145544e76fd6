"""The HTTP surface over real sockets: the response, and what the directory holds."""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import Iterator
from pathlib import Path

import aiohttp
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from prometheus_client.parser import text_string_to_metric_families

from codec.stream import StreamReader, StreamWriter
from tests.support.server.running_server import (
    SEGMENT_FRAMES,
    Running,
    births_of,
    make_stream,
    on_server,
    quick_config,
    random_slice,
    raw_request,
    running,
    small_manifest,
)


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("root")
    make_stream(folder / "walk", 12, title="A <walk> & back")
    make_stream(folder / "dance.2", 3, slice_size=16_000)
    (folder / "secret.txt").write_text("not for you")
    return folder


def test_every_file_is_served_as_it_lies_on_disk(root: Path) -> None:
    files = [path for path in sorted(root.rglob("*")) if path.is_file()]

    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        for path in files:
            if path.name == "secret.txt":
                continue
            stream, *rest = path.relative_to(root).parts
            async with client.get(f"/v1/streams/{stream}/{'/'.join(rest)}") as response:
                assert response.status == 200, path
                assert await response.read() == path.read_bytes(), path
                assert response.headers["Accept-Ranges"] == "bytes"
                assert re.fullmatch('"[0-9a-f]{64}"', response.headers["ETag"])
                immutable = "immutable" in response.headers["Cache-Control"]
                assert immutable == (rest[0] == "segments")

    on_server(root, check)


def test_the_tag_of_an_object_is_its_hash_and_answers_304(root: Path) -> None:
    record = StreamReader(root / "walk").records[1]
    url = "/v1/streams/walk/segments/1/2"
    tag = f'"{record.object_sha256[2].hex()}"'

    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        async with client.get(url) as response:
            assert response.headers["ETag"] == tag
        for value, status in (
            (tag, 304),
            (f"W/{tag}", 304),
            ("*", 304),
            (f'"other", {tag}', 304),
            ('"other"', 200),
            ("", 200),
        ):
            async with client.get(url, headers={"If-None-Match": value}) as response:
                assert response.status == status, value
                assert response.headers["ETag"] == tag
                assert bool(await response.read()) == (status == 200)
        async with client.head(url, headers={"If-None-Match": tag}) as response:
            assert response.status == 304

    on_server(root, check)


def test_head_says_what_get_would_send(root: Path) -> None:
    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        for name in ("manifest.json", "index.bin", "segments/0/3"):
            url = f"/v1/streams/walk/{name}"
            async with client.head(url) as head, client.get(url) as get:
                assert (head.status, await head.read()) == (200, b"")
                assert int(head.headers["Content-Length"]) == len(await get.read())
                for key in ("ETag", "Content-Type", "Cache-Control"):
                    assert head.headers[key] == get.headers[key]
        async with client.head(
            "/v1/streams/walk/segments/0/3", headers={"Range": "bytes=2-4"}
        ) as r:
            assert (r.status, r.headers["Content-Length"]) == (206, "3")
        async with client.head("/v1/streams/walk/play") as response:
            assert response.status == 405

    on_server(root, check)


def test_ranges_are_slices_of_the_object(root: Path) -> None:
    data = (root / "dance.2" / "segments" / "0" / "0").read_bytes()
    assert len(data) > 1 << 20  # more than one piece
    url = "/v1/streams/dance.2/segments/0/0"
    size = len(data)

    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        async def get(**headers: str) -> tuple[int, str | None, bytes]:
            async with client.get(url, headers=headers) as r:
                return r.status, r.headers.get("Content-Range"), await r.read()

        for text, start, stop in (
            ("0-0", 0, 1),
            ("5-", 5, size),
            ("100-700000", 100, 700001),
            ("-7", size - 7, size),
            (f"10-{size + 5}", 10, size),
        ):
            expected = (206, f"bytes {start}-{stop - 1}/{size}", data[start:stop])
            assert await get(Range=f"bytes={text}") == expected
        status, content_range, _ = await get(Range=f"bytes={size}-")
        assert (status, content_range) == (416, f"bytes */{size}")
        for text in ("bytes=3-2", "bytes=0-1,4-5", "lines=1-2", "nonsense"):
            assert await get(Range=text) == (200, None, data)
        tag = (await client.head(url)).headers["ETag"]
        assert (await get(Range="bytes=0-9", **{"If-Range": tag}))[0] == 206
        assert await get(Range="bytes=0-9", **{"If-Range": '"older"'}) == (200, None, data)
        assert (await get(Range="bytes=0-9", **{"If-Range": f"W/{tag}"}))[0] == 200

    on_server(root, check)


@pytest.mark.parametrize(
    "path",
    [
        "/nope",
        "/v1",
        "/v1/streams/",
        "/v1/streams/nobody/manifest.json",
        "/v1/streams/walk",
        "/v1/streams/walk/",
        "/v1/streams/walk/nope",
        "/v1/streams/walk/segments/3/0",
        "/v1/streams/walk/segments/0/4",
        "/v1/streams/walk/segments/00/0",
        "/v1/streams/walk/segments/0/+1",
        "/v1/streams/walk/segments/-1/0",
        "/v1/streams/walk/segments/%D9%A1/0",
        "/v1/streams/walk/segments/99999999999999999999/0",
        "/v1/streams/../secret.txt",
        "/v1/streams/../../etc/passwd",
        "/v1/streams/%2e%2e/secret.txt",
        "/v1/streams/..%2fsecret.txt/manifest.json",
        "/v1/streams/%2e%2e%2f%2e%2e%2fetc%2fpasswd/index.bin",
        "/v1/streams/walk%2f..%2fdance.2/manifest.json",
        "/v1/streams/walk/segments/..%2f..%2fmanifest.json/0",
        "/v1/streams/walk/segments/0/0/../../../secret.txt",
        "/v1/streams/walk%00/manifest.json",
        "/v1/streams/" + "a" * 3000 + "/manifest.json",
        "//secret.txt",
    ],
)
def test_what_is_not_there_is_a_404_in_one_line_of_json(root: Path, path: str) -> None:
    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        # Raw, because a client would tidy the path up.
        request = f"GET {path} HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n"
        answer = await raw_request(server.port, request.encode())
        head, _, body = answer.partition(b"\r\n\r\n")
        assert head.startswith(b"HTTP/1.1 404 "), head
        message = json.loads(body)["error"]
        assert message
        assert "\n" not in message
        assert len(message) < 200
        assert b"not for you" not in body
        assert b"root:" not in body

    on_server(root, check)


class Garbage:
    """A server on a loop of its own that is sent raw bytes."""

    def __init__(self, root: Path) -> None:
        self._loop = asyncio.Runner()
        self._context = running(root, quick_config(keepalive_timeout_s=0.2))
        self._port = self._loop.run(self._context.__aenter__()).port

    def send(self, data: bytes) -> bytes:
        """What the server sends back for `data` until it closes the connection."""
        try:
            return self._loop.run(raw_request(self._port, data))
        except ConnectionError:
            return b""

    def stop(self) -> None:
        self._loop.run(self._context.__aexit__(None, None, None))
        self._loop.close()


@pytest.fixture(scope="module")
def garbage(root: Path) -> Iterator[Garbage]:
    server = Garbage(root)
    yield server
    server.stop()


HEALTH = b"GET /healthz HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n"


@given(st.binary(max_size=300))
@settings(max_examples=40, deadline=None)
def test_garbage_gets_a_400_or_nothing(garbage: Garbage, data: bytes) -> None:
    answer = garbage.send(data + b"\r\n\r\n")
    assert answer == b"" or answer.startswith(b"HTTP/1.1 4") or answer.startswith(b"HTTP/1.0 4")
    assert garbage.send(HEALTH).startswith(b"HTTP/1.1 200 ")


def test_garbage_leaves_no_traceback(garbage: Garbage, caplog: pytest.LogCaptureFixture) -> None:
    for data in (
        b"\x16\x03\x01\x02\r\n\r\n",
        b"GET / HTTP/9.9\r\n\r\n",
        b"GET /\0 HTTP/1.1\r\n\r\n",
    ):
        garbage.send(data)
    garbage.send(b"GET / HTTP/1.1\r\nHost: x\r\n" + b"A: " + b"a" * 100_000 + b"\r\n\r\n")
    assert not caplog.records


def test_pages_of_other_origins_may_read_or_not(root: Path) -> None:
    url = "/v1/streams/walk/segments/0/0"

    async def open_to_all(server: Running, client: aiohttp.ClientSession) -> None:
        for request in (client.get(url), client.get("/nope"), client.head(url)):
            async with request as response:
                assert response.headers["Access-Control-Allow-Origin"] == "*"
                assert "ETag" in response.headers["Access-Control-Expose-Headers"]
        async with client.options(url) as response:
            assert response.status == 204
            assert "Range" in response.headers["Access-Control-Allow-Headers"]

    async def closed(server: Running, client: aiohttp.ClientSession) -> None:
        async with client.get(url) as response:
            assert response.status == 200
            assert not [name for name in response.headers if "Access-Control" in name]

    async def one_origin(server: Running, client: aiohttp.ClientSession) -> None:
        async with client.get(url) as response:
            assert response.headers["Access-Control-Allow-Origin"] == "https://a.example"

    on_server(root, open_to_all)
    on_server(root, closed, quick_config(cors_origin=""))
    on_server(root, one_origin, quick_config(cors_origin="https://a.example"))


def test_health_readiness_and_metrics(root: Path) -> None:
    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        for path in ("/healthz", "/readyz", "/nope", "/v1/streams/walk/segments/0/1"):
            async with client.get(path) as response:
                await response.read()
        async with client.post("/healthz") as response:
            assert response.status == 405
            assert response.headers["Allow"] == "GET,HEAD"
        async with client.get("/metrics") as response:
            assert response.headers["Content-Type"].startswith("text/plain; version=0.0.4")
            text = await response.text()
        found = {
            (sample.name, *sorted(sample.labels.items())): sample.value
            for family in text_string_to_metric_families(text)
            for sample in family.samples
        }
        assert found["swings_requests_total", ("code", "200"), ("route", "/healthz")] == 1
        assert found["swings_requests_total", ("code", "404"), ("route", "unmatched")] == 1
        size = (root / "walk" / "segments" / "0" / "1").stat().st_size
        assert found["swings_layer_bytes_total", ("layer", "1"), ("via", "object")] == size
        assert found["swings_active_plays",] == 0
        assert found["swings_ttfb_seconds_count",] == 1  # the object was read from disk
        server.state.stopping.set()
        async with client.get("/readyz") as response:
            assert response.status == 503

    on_server(root, check)


def test_a_growing_stream_grows_for_clients(tmp_path: Path) -> None:
    writer = StreamWriter.create(tmp_path / "live", small_manifest())
    for birth in births_of(SEGMENT_FRAMES):
        writer.append(random_slice(birth, 8))

    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        async with client.get("/v1/streams/live/index.bin") as response:
            before, tag = await response.read(), response.headers["ETag"]
        assert (await client.get("/v1/streams/live/segments/1/0")).status == 404
        for birth in range(SEGMENT_FRAMES, 2 * SEGMENT_FRAMES):
            writer.append(random_slice(birth, 8))
        await server.state.library.look()
        changed = {"If-None-Match": tag}
        async with client.get("/v1/streams/live/index.bin", headers=changed) as response:
            assert response.status == 200
            after = await response.read()
        assert after.startswith(before)
        assert len(after) == 2 * len(before)
        # The tail alone, as a player that follows asks for it.
        tail = {"Range": f"bytes={len(before)}-"}
        async with client.get("/v1/streams/live/index.bin", headers=tail) as response:
            assert await response.read() == after[len(before) :]
        assert (await client.get("/v1/streams/live/segments/1/0")).status == 200
        writer.close()
        await server.state.library.look()
        async with client.get("/v1/streams/live/manifest.json") as response:
            assert (await response.json())["live"] is False

    on_server(tmp_path, check)


def test_a_damaged_object_is_a_500_that_tells_no_path(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = make_stream(tmp_path / "s", 6) / "segments" / "0" / "0"

    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        path.write_bytes(path.read_bytes()[:-1])
        async with client.get("/v1/streams/s/segments/0/0") as response:
            assert response.status == 500
            assert str(tmp_path) not in await response.text()
        async with client.get("/v1/streams/s/segments/0/1") as response:
            assert response.status == 200

    on_server(tmp_path, check)
    assert str(path) in caplog.text
    assert "Traceback" not in caplog.text


def test_many_clients_get_every_byte(root: Path) -> None:
    files = {
        f"/v1/streams/walk/segments/{n}/{layer}": (
            root / "walk" / "segments" / str(n) / str(layer)
        ).read_bytes()
        for n in range(3)
        for layer in range(4)
    }

    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        async def get(url: str, data: bytes) -> bool:
            async with client.get(url) as response:
                return await response.read() == data

        async with asyncio.TaskGroup() as group:
            tasks = [group.create_task(get(*item)) for _ in range(20) for item in files.items()]
        assert all(task.result() for task in tasks)
        assert server.state.metrics.cache_misses.value() == len(files)

    on_server(root, check)


def test_an_idle_or_endless_head_is_cut(root: Path) -> None:
    async def drip(port: int) -> None:
        """Sends a head letter by letter until the connection is closed."""
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(b"GET / HTTP/1.1\r\nA: ")
        answer = asyncio.create_task(reader.read())
        async with asyncio.timeout(3):
            while not answer.done():
                writer.write(b"x")
                await asyncio.sleep(0.02)
        assert (await answer).startswith(b"HTTP/1.1 408 ")
        writer.transport.abort()

    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        assert await raw_request(server.port, b"") == b""
        await drip(server.port)

    on_server(root, check, quick_config(keepalive_timeout_s=0.3))
