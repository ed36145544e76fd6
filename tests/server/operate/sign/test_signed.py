"""swings-serve with keys: access by signed URLs, as a process and in a browser."""

from __future__ import annotations

import json
import os
import re
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from codec.stream.playrecord import EndRecord
from server.abr.clientstatus import PLAY_HEADER
from server.operate.sign.signing import Signer, add_key, read_keys
from tests.server.hostile.serverprocess import ask, server_process
from tests.support.commands import run, run_ok
from tests.support.hosted_streams import write_stream
from tests.support.server.running_server import parse_records
from tests.support.waiting import wait_until

WATCH = "/web/bundle/watch.html"
STREAM = "/v1/streams/walk"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("signed")
    write_stream(folder / "root" / "walk", 12)
    write_stream(folder / "root" / "other", 12)
    add_key(folder / "keys")
    return folder


@pytest.fixture(scope="module")
def port(folder: Path) -> Iterator[int]:
    with server_process(folder / "root", folder, "--keys", folder / "keys") as server:
        yield server.port


@pytest.fixture(scope="module")
def signer(folder: Path) -> Signer:
    return Signer(read_keys(folder / "keys"))


def soon() -> int:
    return int(time.time()) + 600


def test_a_signed_url_opens_all_of_its_stream(port: int, folder: Path) -> None:
    url = f"http://127.0.0.1:{port}"
    said = run_ok("swings-sign", folder / "keys", "walk", "--url", url)
    page, manifest = (line.split()[1].removeprefix(url) for line in said.splitlines())
    shown = ask(port, page)
    assert shown.status == 200
    assert b"og:" not in shown.body
    found = re.findall(r'"\.\./web/([^"]+\.js)"', shown.body.decode())
    assert found
    for asset in found:
        assert ask(port, f"{page.rsplit('/watch/', 1)[0]}/web/{asset}").status == 200
    base = manifest.rsplit("/", 1)[0]
    for name in ("manifest.json", "index.bin", "segments/0/0"):
        answer = ask(port, f"{base}/{name}")
        assert answer.status == 200
        assert answer.body == (folder / "root" / "walk" / name).read_bytes()
    play = ask(port, f"{base}/play?layers=1")
    assert play.status == 200
    assert isinstance(parse_records([play.body])[-1], EndRecord)
    # It is over; but the path led to whom it asks.
    token = play.headers[PLAY_HEADER.lower()]
    report = ask(port, f"{base}/play/{token}", method="POST", body=b'{"frame": 1}')
    assert report.status == 404
    assert b"no such play" in report.body


def test_a_url_for_all_opens_the_list(port: int, signer: Signer) -> None:
    base = signer.sign("*", soon())
    assert ask(port, f"{base}/").status == 200
    listed = ask(port, f"{base}/v1/streams")
    assert [one["name"] for one in json.loads(listed.body)["streams"]] == ["other", "walk"]
    assert ask(port, f"{base}{STREAM}/manifest.json").status == listed.status == 200


def test_what_is_not_signed_for_it_is_403_in_one_line(port: int, signer: Signer) -> None:
    good, late = signer.sign("walk", soon()), signer.sign("walk", int(time.time()) - 1)
    altered = good[:-1] + ("A" if good[-1] != "A" else "B")
    for path in (
        f"{STREAM}/manifest.json",
        f"{STREAM}/play",
        "/watch/walk",
        "/",
        "/v1/streams",
        f"{good}/v1/streams/other/manifest.json",
        f"{good}/watch/other",
        f"{good}/v1/streams",
        f"{good}/",
        f"{late}{STREAM}/manifest.json",
        f"{altered}{STREAM}/manifest.json",
        f"{good}/v1/streams/walk/../other/manifest.json",
        f"{good}{good}{STREAM}/manifest.json",
        "/t/1.a.b/",
    ):
        answer = ask(port, path)
        assert answer.status == 403, path
        message = json.loads(answer.body)["error"]
        assert "\n" not in message
        assert len(message) < 120
        shown = ask(port, path, {"Accept": "text/html,*/*;q=0.8"})
        assert (shown.status, shown.headers["cache-control"]) == (403, "no-store")
        assert (b"<h1>This link has expired</h1>" in shown.body) is path.startswith(late)
    for path in ("/healthz", "/readyz"):
        assert ask(port, path).status == 200
    for path in (f"{STREAM}/manifest.json", f"{good}{STREAM}/play"):
        assert ask(port, path, method="OPTIONS").status == 204


@pytest.mark.parametrize("method", ["GET", "HEAD"])
def test_no_shared_cache_may_keep_the_answer_to_a_signed_url(
    port: int, signer: Signer, method: str
) -> None:
    def caching(path: str, method: str = method) -> str:
        return ask(port, path, method=method).headers["cache-control"]

    good = signer.sign("walk", soon())
    for _ in range(3):  # as it is read, and from the memory of the server
        found = caching(f"{good}{STREAM}/segments/0/0")
        match = re.fullmatch(r"private, max-age=(\d+), immutable", found)
        assert match is not None
        assert 500 < int(match[1]) <= 600
    for path in (
        f"{STREAM}/manifest.json",
        f"{STREAM}/index.bin",
        "/watch/walk",
        WATCH,
    ):
        assert caching(good + path) == "private, no-cache", path
    assert caching(f"{good}{STREAM}/segments/9/9") == "no-store"
    assert caching(f"{STREAM}/segments/0/0") == "no-store"
    # Files of the player are the same for all who ask without a signature.
    assert caching(WATCH) == "no-cache"
    assert caching(f"{good}{STREAM}/play?layers=1", "GET") == "no-store"
    in_ten_years = signer.sign("walk", soon() + 10 * 366 * 86400)
    found = caching(f"{in_ten_years}{STREAM}/segments/0/0")
    assert found == "private, max-age=31536000, immutable"


def test_a_server_of_one_process_reads_its_keys_again_on_sighup(
    folder: Path, tmp_path: Path
) -> None:
    keys = tmp_path / "keys"
    add_key(keys)
    with server_process(folder / "root", tmp_path, "--keys", keys) as server:
        add_key(keys)
        fresh = Signer(read_keys(keys)).sign("walk", soon())
        assert ask(server.port, f"{fresh}{STREAM}/manifest.json").status == 403
        os.kill(server.pid, signal.SIGHUP)
        wait_until(lambda: ask(server.port, f"{fresh}{STREAM}/manifest.json").status == 200)
    assert "keys and certificate were reloaded" in server.log.read_text()


def test_the_log_has_no_signature(folder: Path, tmp_path: Path, signer: Signer) -> None:
    root, keys = folder / "root", folder / "keys"
    good, all_of_it = signer.sign("walk", soon()), signer.sign("*", soon())
    digest = "Q0jYl9-_0nGvXJmV4tTzAA"
    edge = f"/n/{digest}{good}"
    paths = (
        f"{good}{STREAM}/manifest.json",  # 200
        f"{good}{STREAM}/segments/9/9",  # 404
        f"{good}/v1/streams/other/manifest.json",  # the rest are refused
        f"{good}/favicon.ico",
        f"{good}/healthz",
        f"{all_of_it}{good}/watch/walk",
        f"/{good}/watch/walk",
        f"/web{good}",
        f"{good[:-1]}/watch/walk",
        f"{good[:9]}%2E{good[9:]}/watch/walk",
        good,
        f"{edge}{STREAM}/segments/0/0",
        f"/web/none?u={edge.replace('/', '%2F').replace('.', '%2E')}",
        f"{WATCH}?src=http://host{edge}{STREAM}&{good.replace('.', '%2E')}",
        f"{WATCH}?src=http%3A%2F%2Fhost{good.replace('/', '%2F')}%2Fv1%2Fstreams%2Fwalk",
    )
    with server_process(root, tmp_path, "--keys", keys, "--log-requests", "all") as server:
        statuses = [ask(server.port, path).status for path in paths]
        for prefix in (good, edge):
            ask(server.port, f"{prefix}{STREAM}/play", method="OPTIONS")
    assert statuses[:2] == [200, 404]
    assert 200 not in statuses[2:-2]
    text = server.log.read_text()
    assert text.count("/t/***/") == 11
    assert "path=/v1/streams/walk/manifest.json" in text
    for prefix in (good, all_of_it):
        signature = prefix.rpartition(".")[2]
        assert signature[:20] not in text, text
    assert digest[:16] not in text, text


def test_other_machines_are_let_in_on_purpose_only(folder: Path, tmp_path: Path) -> None:
    root, keys = folder / "root", folder / "keys"
    done = run("swings-serve", root, "--host", "0.0.0.0", "--port", 0)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.count("\n") == 1
    assert "--public" in done.stderr
    for options in (("--public",), ("--keys", keys)):
        with server_process(root, tmp_path, "--host", "0.0.0.0", *options) as server:
            assert ask(server.port, "/healthz").status == 200
