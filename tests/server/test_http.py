"""The HTTP surface over real sockets: responses, compared with the directory."""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path

import pytest

from tests.server.hostile.serverprocess import samples
from tests.support.server.running_server import (
    fetch,
    make_stream,
    quick_config,
    raw_get,
    running,
    served,
)
from tests.support.tiny_stream import files_of

pytestmark = pytest.mark.anyio


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("root")
    make_stream(folder / "walk", 12, title="A <walk> & back")
    make_stream(folder / "dance.2", 3, slice_size=9)
    (folder / "secret.txt").write_text("not for you")
    return folder


async def test_every_file_is_served_as_it_lies_on_disk(root: Path) -> None:
    seen: set[tuple[str, str]] = set()
    async with served(root) as (server, client):
        for stream in ("walk", "dance.2"):
            for name, data in files_of(root / stream).items():
                found = await fetch(client, f"/v1/streams/{stream}/{name}")
                assert (found.status, found.body) == (200, data), name
                assert found.headers["Accept-Ranges"] == "bytes"
                assert found.headers["ETag"] == f'"{hashlib.sha256(data).hexdigest()}"'
                immutable = "immutable" in found.headers["Cache-Control"]
                assert immutable == name.startswith("segments")
                seen.add((name.partition("/")[0], name.rpartition("/")[2]))
        parts = {"skipmaps", *"0123", *(f"keyframe-{n}" for n in range(4))}
        objects = {("segments", part) for part in parts}
        assert seen == objects | {(name, name) for name in ("index.bin", "manifest.json")}
        # Each part is one label, and there are no others.
        labels = re.findall(r'layer_bytes_total{layer="([^"]+)"', server.state.metrics.text())
        assert set(labels) == parts


NO_OBJECTS = (
    "3/0 0/4 0/+1 %D9%A1/0 99999999999999999999/0 3/skipmaps 0/skipmap 0/skipmaps0 0/Skipmaps "
    "0/keyframe 0/keyframe-4 0/keyframe-00 0/keyframe- 0/keyframe-999999999 0/keyframe-%D9%A1"
)
NOWHERE = [
    "/nope",
    "/v1",
    "/v1/streams/",
    "/v1/streams/nobody/manifest.json",
    "/v1/streams/" + "a" * 3000 + "/manifest.json",
    *(f"/web/{name}" for name in ("", "nothing.js", "tsconfig.json", "a" * 3000)),
    *(f"/v1/streams/walk{rest}" for rest in ("", "/", "/nope", "/segments/skipmaps/0")),
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


@pytest.mark.parametrize("origin", ["*", "https://a.example", ""])
async def test_pages_of_other_origins_may_read_or_not(root: Path, origin: str) -> None:
    url = "/v1/streams/walk/segments/0/0"
    async with served(root, quick_config(cors_origin=origin)) as (_, client):
        for path, method in ((url, "GET"), ("/nope", "GET"), (url, "HEAD")):
            headers = (await fetch(client, path, method)).headers
            assert headers.get("Access-Control-Allow-Origin", "") == origin
            if origin:
                assert "ETag" in headers["Access-Control-Expose-Headers"]
            else:
                assert not [name for name in headers if "Access-Control" in name]
        answer = await fetch(client, url, "OPTIONS")
        assert answer.status == 204
        assert not origin or "Range" in answer.headers["Access-Control-Allow-Headers"]


async def test_health_readiness_and_metrics(root: Path) -> None:
    async with served(root) as (server, client):
        for path in ("/healthz", "/readyz", "/nope", "/v1/streams/walk/segments/0/1"):
            await fetch(client, path)
        for path, method, allowed in (
            ("/healthz", "POST", "GET,HEAD"),
            ("/v1/streams/walk/play", "HEAD", "GET"),
        ):
            refused = await fetch(client, path, method)
            assert (refused.status, refused.headers["Allow"]) == (405, allowed)
        answer = await fetch(client, "/metrics")
        assert answer.headers["Content-Type"].startswith("text/plain; version=0.0.4")
        found = samples(answer.text)
        assert found["swings_requests_total", "/healthz", "200"] == 1
        assert found["swings_requests_total", "404", "unmatched"] == 1
        size = (root / "walk" / "segments" / "0" / "1").stat().st_size
        assert found["swings_layer_bytes_total", "1", "object"] == size
        assert found["swings_active_plays",] == 0
        assert found["swings_ttfb_seconds_count",] == 1  # the object was read from disk
        server.state.stopping.set()
        assert (await fetch(client, "/readyz")).status == 503


async def test_a_damaged_object_is_a_500_that_tells_no_path(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = make_stream(tmp_path / "s", 6) / "segments" / "0" / "0"
    async with served(tmp_path) as (_, client):
        path.write_bytes(path.read_bytes()[:-1])
        damaged = await fetch(client, "/v1/streams/s/segments/0/0")
        assert damaged.status == 500
        assert str(tmp_path) not in damaged.text
        assert (await fetch(client, "/v1/streams/s/segments/0/1")).status == 200
    assert str(path) in caplog.text
    assert "Traceback" not in caplog.text
