"""nginx and Caddy with the files of deploy/, in front of a real swings-serve."""

from __future__ import annotations

import contextlib
import hashlib
import json
import re
import shutil
import subprocess
import time
from base64 import urlsafe_b64encode
from collections.abc import Iterator
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from codec.stream import StreamWriter
from codec.stream.playrecord import (
    EndRecord,
    ErrorRecord,
    Record,
    RecordParser,
    SliceRecord,
    StartRecord,
)
from server.operate.sign.signing import Signer, add_key, read_keys, sign_for_nginx
from server.servecommand import SAMPLE
from tests.deploy.proxied import Proxy, Start, caddy, need, nginx
from tests.support.commands import run_ok, serving
from tests.support.hosted_streams import (
    SEGMENT_FRAMES,
    answering,
    random_slice,
    small_manifest,
    write_stream,
)
from tests.support.ports import kept_port

PROXIES: dict[str, Start] = {"nginx": nginx, "caddy": caddy}
FRAMES = 20
OBJECT = "/v1/streams/walk/segments/1/2"


@pytest.fixture(scope="module", params=sorted(PROXIES))
def name(request: pytest.FixtureRequest) -> str:
    name: str = request.param
    need(name)
    return name


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_stream(tmp_path_factory.mktemp("root") / "walk", FRAMES, fps=10.0).parent


@pytest.fixture(scope="module")
def writer(name: str, root: Path) -> Iterator[StreamWriter]:
    yield growing(root / name)
    shutil.rmtree(root / name)


@pytest.fixture(scope="module")
def proxy(
    name: str, root: Path, writer: StreamWriter, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Proxy]:
    with serving(root) as url:
        port = int(url.rpartition(":")[2])
        with PROXIES[name](port, tmp_path_factory.mktemp(name)) as running:
            yield running


def test_objects_come_whole_in_parts_and_not_at_all(proxy: Proxy, root: Path) -> None:
    data = (root / "walk" / "segments" / "1" / "2").read_bytes()
    for _ in range(3):  # from the server, and from a cache
        status, headers, body = proxy.ask(OBJECT)
        assert (status, body) == (200, data)
        assert "immutable" in headers["Cache-Control"]
        tag = headers["ETag"]
        assert tag.startswith('"'), "a strong tag must stay strong"
        assert headers["Access-Control-Allow-Origin"] == "*"
        status, headers, body = proxy.ask(OBJECT, {"Range": "bytes=3-9"})
        assert (status, body) == (206, data[3:10])
        assert headers["Content-Range"] == f"bytes 3-9/{len(data)}"
        status, _, body = proxy.ask(OBJECT, {"Range": "bytes=-5", "If-Range": tag})
        assert (status, body) == (206, data[-5:])
        status, headers, body = proxy.ask(OBJECT, {"If-None-Match": tag})
        assert (status, body, headers["ETag"]) == (304, b"", tag)
        status, _, body = proxy.ask(OBJECT, method="HEAD")
        assert (status, body) == (200, b"")


def test_an_object_and_a_range_of_it_do_not_get_mixed_up(proxy: Proxy, root: Path) -> None:
    """Whatever codings a browser takes, both are of the object as stored on disk."""
    path = "/v1/streams/walk/segments/2/0"
    data = (root / "walk" / "segments" / "2" / "0").read_bytes()
    zstd = {"Accept-Encoding": "gzip, zstd"}
    for _ in range(2):
        assert proxy.ask(path, zstd)[2] == data
        status, headers, body = proxy.ask(path, zstd | {"Range": "bytes=1-4"})
        assert (status, body) == (206, data[1:5])
        assert headers["Content-Encoding"] is None
        assert proxy.ask(path)[1]["Content-Encoding"] is None


@pytest.mark.parametrize("name", ["nginx"], indirect=True)
def test_nginx_keeps_objects_and_nothing_else(proxy: Proxy) -> None:
    path = "/v1/streams/walk/segments/3/1"
    assert [proxy.ask(path)[1]["X-Cache"] for _ in range(2)] == ["MISS", "HIT"]
    for other in ("manifest.json", "index.bin"):
        assert proxy.ask(f"/v1/streams/walk/{other}")[1]["X-Cache"] is None


def test_caddy_sends_objects_of_open_streams_from_disk(root: Path, tmp_path: Path) -> None:
    need("caddy")
    data = (root / "walk" / "segments" / "1" / "2").read_bytes()
    (root / "walk" / "segments" / "1" / "secret").write_bytes(b"not an object")
    # No server is behind it: everything that it does not send itself is a 502.
    with caddy(kept_port(), tmp_path, root) as proxy:
        status, headers, body = proxy.ask(OBJECT)
        assert (status, body) == (200, data)
        assert headers["Access-Control-Allow-Origin"] == "*"
        status, headers, body = proxy.ask(OBJECT, {"Range": "bytes=3-9"})
        assert (status, body) == (206, data[3:10])
        assert proxy.ask(OBJECT, {"If-None-Match": headers["ETag"]})[0] == 304
        for other in (
            "manifest.json",
            "segments/1/secret",
            "segments/..%2fmanifest.json",
            "segments/9/0",
        ):
            assert proxy.ask(f"/v1/streams/walk/{other}")[0] == 502
        assert proxy.ask(f"/t/1.a.b{OBJECT}")[0] == 502
        assert proxy.ask(OBJECT, method="DELETE")[0] == 502


def test_what_is_told_of_the_server_itself_stays_inside(proxy: Proxy) -> None:
    assert proxy.ask("/healthz")[0] == 200
    assert proxy.ask("/metrics")[0] == 404
    assert proxy.ask("/v1/streams/nobody/manifest.json")[0] == 404


def growing(path: Path) -> StreamWriter:
    """The writer of an unfinished stream with one segment at `path`."""
    writer = StreamWriter.create(path, small_manifest(fps=10.0), exact=True)
    append(writer, SEGMENT_FRAMES)
    return writer


def append(writer: StreamWriter, num_frames: int) -> None:
    for birth in range(writer.next_birth, num_frames):
        writer.append(random_slice(birth))


def check_play(proxy: Proxy, writer: StreamWriter, name: str, prefix: str = "") -> None:
    """Asserts that slices of a growing stream arrive while the play goes on, and status reports
    pass. prefix: of all paths."""
    connection, parser = proxy.connect(), RecordParser()
    records: list[Record] = []

    def births() -> list[int]:
        return [record.birth for record in records if isinstance(record, SliceRecord)]

    try:
        connection.request("GET", f"{prefix}/v1/streams/{name}/play?from=0&layers=1")
        response = connection.getresponse()
        assert response.status == 200
        # They come before there are others: no proxy keeps them back.
        while len(births()) < SEGMENT_FRAMES - 1:
            piece = response.read1(1 << 16)
            assert piece, records
            records += parser.feed(piece)
        report = json.dumps({"frame": 0}).encode()
        path = f"{prefix}/v1/streams/{name}/play/{response.headers['Swings-Play']}"
        assert proxy.ask(path, None, "POST", report)[0] == 204
        with writer:
            append(writer, FRAMES)
        while piece := response.read1(1 << 16):
            records += parser.feed(piece)
    finally:
        connection.close()
    assert isinstance(records[0], StartRecord)
    assert isinstance(records[-1], EndRecord), records[-1]
    assert not [record for record in records if isinstance(record, ErrorRecord)]
    assert births() == list(range(1, FRAMES))


def test_a_play_comes_slice_by_slice_and_its_status_reports_go_back(
    proxy: Proxy, writer: StreamWriter, name: str
) -> None:
    check_play(proxy, writer, name)


def test_behind_a_signed_url_a_play_comes_so_too_and_nothing_is_kept(
    name: str, tmp_path: Path
) -> None:
    root, keys, folder = tmp_path / "root", tmp_path / "keys", tmp_path / name
    write_stream(root / "walk", FRAMES, fps=10.0)
    writer = growing(root / "live")
    add_key(keys)
    signer, until_s = Signer(read_keys(keys)), int(time.time()) + 600
    folder.mkdir()
    with (
        serving(root, "--keys", keys) as url,
        PROXIES[name](int(url.rpartition(":")[2]), folder) as proxy,
    ):
        check_play(proxy, writer, "live", signer.sign("live", until_s))
        for _ in range(2):
            status, headers, _ = proxy.ask(signer.sign("walk", until_s) + OBJECT)
            assert (status, headers["X-Cache"]) == (200, None)
        assert proxy.ask(OBJECT)[0] == 403


def test_objects_of_open_streams_stay_in_the_cache_until_it_is_emptied(
    root: Path, tmp_path: Path
) -> None:
    need("nginx")
    port = kept_port()
    keys = tmp_path / "keys"
    add_key(keys)
    with nginx(port, tmp_path) as proxy:
        with serving(root, "--port", port):
            assert [proxy.ask(OBJECT)[1]["X-Cache"] for _ in range(2)] == ["MISS", "HIT"]
        with serving(root, "--port", port, "--keys", keys):
            assert proxy.ask(OBJECT)[0] == 200  # hence the advice of docs/OPERATE.md
            emptying = ["find", str(tmp_path / "cache" / "swings"), "-type", "f", "-delete"]
            subprocess.run(emptying, check=True)
            assert proxy.ask(OBJECT)[0] == 403


def test_nginx_sends_signed_objects_from_disk(root: Path, tmp_path: Path) -> None:
    need("nginx")
    streams = tmp_path / "streams"
    shutil.copytree(root / "walk", streams / "walk")
    shutil.copytree(root / "walk", streams / "other")
    (streams / "other" / "segments" / "9").mkdir()
    (streams / "other" / "segments" / "9" / "9").symlink_to("/etc/passwd")
    files = tmp_path / "keys"
    add_key(files)
    with files.open("a") as file:  # the longest name that a key may have
        file.write(f"{'k' * 32}:{'00' * 16}\n")
    keys = read_keys(files)
    (tmp_path / "swings-secrets.map").write_text(
        run_ok("swings-sign", files, "--nginx-secrets"), encoding="ascii"
    )
    until_s = int(time.time()) + 600
    good = sign_for_nginx(keys, "walk", until_s)
    data = (root / "walk" / "segments" / "1" / "2").read_bytes()
    port = kept_port()  # no server is there: responses come from the disk
    with nginx(port, tmp_path, streams) as proxy:

        def status(prefix: str, path: str = OBJECT) -> int:
            return proxy.ask(prefix + path)[0]

        got, headers, body = proxy.ask(good + OBJECT)
        assert (got, body, headers["Cache-Control"]) == (200, data, "private, no-cache")
        assert headers["Access-Control-Allow-Origin"] == "*"
        assert proxy.ask(good + OBJECT, {"Range": "bytes=3-9"})[2] == data[3:10]
        assert proxy.ask(good + OBJECT, {"If-None-Match": headers["ETag"]})[0] == 304
        index = (root / "walk" / "index.bin").read_bytes()
        assert proxy.ask(f"{good}/v1/streams/walk/index.bin")[2] == index
        assert status(good, "/v1/streams/walk/segments/9/9") == 404
        assert proxy.ask(good + OBJECT, None, "POST", b"x")[0] == 405
        other, linked = OBJECT.replace("walk", "other"), "/v1/streams/other/segments/9/9"
        of_other = sign_for_nginx(keys, "other", until_s)
        kid, long = keys
        of_unknown = sign_for_nginx({"unknown": bytes(32)}, "walk", until_s)
        text = f"{until_s} unknown /v1/streams/walk "
        digest = urlsafe_b64encode(hashlib.md5(text.encode()).digest()).decode().rstrip("=")
        for prefix, path, wanted in (
            (of_other, other, 200),
            (sign_for_nginx({long: keys[long]}, "walk", until_s), OBJECT, 200),
            # Another stream, also by a path that leads to it.
            (good, other, 403),
            (good, OBJECT.replace("walk", "walk/../other"), 403),
            (good, OBJECT.replace("walk", "walk/..%2Fother"), 403),
            (good, OBJECT.replace("walk", "walk/%2e%2e/other"), 403),
            (good, OBJECT.replace("walk", "walk/../../streams//other"), 403),
            # Expired, prolonged, altered, of another key, and of a key without a secret.
            (sign_for_nginx(keys, "walk", int(time.time()) - 2), OBJECT, 403),
            (good.replace(str(until_s), str(until_s + 1)), OBJECT, 403),
            (good[:3] + ("A" if good[3] != "A" else "B") + good[4:], OBJECT, 403),
            (sign_for_nginx({kid: bytes(32)}, "walk", until_s), OBJECT, 403),
            (of_unknown, OBJECT, 403),
            (f"/n/{digest}/t/{of_unknown.partition('/t/')[2]}", OBJECT, 403),
            ("", f"/n/{'A' * 21}{OBJECT}", 404),
        ):
            assert status(prefix, path) == wanted, (prefix, path)
        assert status(of_other, linked) in (403, 404)  # swings-serve follows no links either
        writer = growing(streams / "live")
        with serving(streams, "--port", port, "--keys", files):
            check_play(proxy, writer, "live", sign_for_nginx(keys, "live", until_s))
            for path in ("manifest.json", "index.bin?after=1&wait=1"):
                assert status(good, f"/v1/streams/walk/{path}") == 200
                assert status(good, f"/v1/streams/other/{path}") == 403
            assert status(good, "/watch/walk") == 200
            for path in (OBJECT, "/v1/streams/walk/index.bin"):
                got, headers, _ = proxy.ask(good + path, None, "OPTIONS")
                assert (got, "Range" in headers["Access-Control-Allow-Headers"]) == (204, True)
            assert status(good, f"{OBJECT}?anything") == 200
            assert status(good, f"{other}?anything") == 403
            # A signature for nginx does not open what swings-serve verifies.
            token = good.rpartition(".")[2]
            assert status(good.replace(token, "A" * 43), "/v1/streams/walk/manifest.json") == 403
            assert status("", OBJECT) == 403
            assert status("", "/n/") == 404
    log = (tmp_path / "access.log").read_text()
    assert "GET /t/***/v1/streams/walk/segments/1/2 HTTP" in log
    assert not re.search(r"/[nt]/[^*/ ]{9}", log)


@contextlib.contextmanager
def echoing() -> Iterator[int]:
    """Runs a server that answers with the request's headers as JSON; gives its port."""

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            body = json.dumps({k.lower(): v for k, v in self.headers.items()}).encode()
            self.send_response(200)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *args: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    with answering(server):
        yield server.server_port


def test_the_server_learns_the_clients_address_and_no_lies(name: str, tmp_path: Path) -> None:
    with echoing() as port, PROXIES[name](port, tmp_path) as proxy:
        for path in ("/", "/v1/streams/walk/play", "/v1/streams/walk/manifest.json"):
            _, _, body = proxy.ask(path, {"X-Forwarded-For": "203.0.113.9"})
            headers = json.loads(body)
            assert headers["x-forwarded-for"] == "127.0.0.1", path
            assert headers["x-forwarded-proto"] == ("https" if proxy.tls else "http")
            assert headers["host"] == f"127.0.0.1:{proxy.port}"


@pytest.mark.realtime
@pytest.mark.parametrize("path", ["/watch/walk", "/v1/streams/walk/manifest.json"])
def test_a_slow_viewer_gets_as_many_layers_as_without_it(
    name: str, path: str, tmp_path: Path
) -> None:
    """By plays, and by objects: 3 Mbit/s and 20 ms, four times the sample of two seconds."""

    def played(url: str) -> tuple[float, int]:
        how = ["--link", "3M,20ms", "--loop", "4", "--size", "64x36", "--renderer", "cpu"]
        files = "--capture", tmp_path / "x.mp4", "--report", tmp_path / "x.json"
        run_ok("swings-play", url, *how, *files)
        report = json.loads((tmp_path / "x.json").read_text())
        layers = [frame["layers"] for frame in report["frames"]]
        return sum(layers) / len(layers), report["totals"]["stalls"]

    with serving(SAMPLE.parent) as url:
        layers, stalls = played(url + path)
        start = partial(nginx, tls=False) if name == "nginx" else caddy
        with start(int(url.rpartition(":")[2]), tmp_path) as proxy:
            found, found_stalls = played(f"http://127.0.0.1:{proxy.port}{path}")
    assert found >= 0.9 * layers
    assert found_stalls <= stalls
