"""The HTTP surface over real sockets: responses, compared with the directory."""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path

import aiohttp
import pytest
from prometheus_client.parser import text_string_to_metric_families

from tests.support.server.running_server import (
    Running,
    make_stream,
    on_server,
    quick_config,
    raw_get,
    running,
    served,
)

pytestmark = pytest.mark.anyio


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("root")
    make_stream(folder / "walk", 12, title="A <walk> & back")
    make_stream(folder / "dance.2", 3, slice_size=9)
    (folder / "secret.txt").write_text("not for you")
    return folder


def test_every_file_is_served_as_it_lies_on_disk(root: Path) -> None:
    files = [path for path in sorted(root.rglob("*")) if path.is_file()]

    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        for path in files:
            if path.name == "secret.txt":
                continue
            data, (stream, *rest) = path.read_bytes(), path.relative_to(root).parts
            async with client.get(f"/v1/streams/{stream}/{'/'.join(rest)}") as response:
                assert response.status == 200, path
                assert await response.read() == data, path
                assert response.headers["Accept-Ranges"] == "bytes"
                assert response.headers["ETag"] == f'"{hashlib.sha256(data).hexdigest()}"'
                immutable = "immutable" in response.headers["Cache-Control"]
                assert immutable == (rest[0] == "segments")
                seen.add((rest[0], rest[-1]))
        parts = {"masks", *"0123", *(f"snapshot-{n}" for n in range(4))}
        objects = {("segments", part) for part in parts}
        assert seen == objects | {(name, name) for name in ("index.bin", "manifest.json")}
        # Each part is one label, and there are no others.
        labels = re.findall(r'layer_bytes_total{layer="([^"]+)"', server.state.metrics.text())
        assert set(labels) == parts

    seen: set[tuple[str, str]] = set()
    on_server(root, check)


NO_OBJECTS = (
    "3/0 0/4 0/+1 %D9%A1/0 99999999999999999999/0 3/masks 0/mask 0/masks0 0/Masks 0/snapshot "
    "0/snapshot-4 0/snapshot-00 0/snapshot- 0/snapshot-999999999 0/snapshot-%D9%A1"
)
NOWHERE = [
    "/nope",
    "/v1",
    "/v1/streams/",
    "/v1/streams/nobody/manifest.json",
    "/v1/streams/" + "a" * 3000 + "/manifest.json",
    *(f"/web/{name}" for name in ("", "nothing.js", "tsconfig.json", "a" * 3000)),
    *(f"/v1/streams/walk{rest}" for rest in ("", "/", "/nope", "/segments/masks/0")),
    *(f"/v1/streams/walk/segments/{place}" for place in NO_OBJECTS.split()),
]


async def test_what_is_not_there_is_a_404_in_one_line_of_json(root: Path) -> None:
    async with running(root) as server:
        for path in NOWHERE:
            head, body = await raw_get(server.port, path)
            assert head.startswith(b"HTTP/1.1 404 "), path
            message = json.loads(body)["error"]
            assert message
            assert "\n" not in message
            assert len(message) < 200
        assert "layer_bytes_total{" not in server.state.metrics.text()


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


async def test_health_readiness_and_metrics(root: Path) -> None:
    async with served(root) as (server, client):
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


async def test_a_damaged_object_is_a_500_that_tells_no_path(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = make_stream(tmp_path / "s", 6) / "segments" / "0" / "0"

    async with served(tmp_path) as (_, client):
        path.write_bytes(path.read_bytes()[:-1])
        async with client.get("/v1/streams/s/segments/0/0") as response:
            assert response.status == 500
            assert str(tmp_path) not in await response.text()
        async with client.get("/v1/streams/s/segments/0/1") as response:
            assert response.status == 200
    assert str(path) in caplog.text
    assert "Traceback" not in caplog.text
