"""swings-serve with keys: what a signed URL opens, as a process and in a browser."""

from __future__ import annotations

import json
import os
import re
import signal
import time
from collections.abc import Iterator
from email.message import Message
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import pytest

from codec.stream.playrecord import EndRecord
from server.abr.clientstatus import PLAY_HEADER
from server.operate.sign.keyfile import add_key, read_keys
from server.operate.sign.signing import Signer
from tests.server.hostile.serverprocess import get, server_process
from tests.support.commands import run, run_ok, serving
from tests.support.hosted_streams import write_stream
from tests.support.server.running_server import parse_records
from tests.support.waiting import wait_until

STREAM = "/v1/streams/walk"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("signed")
    write_stream(folder / "root" / "walk", 12)
    write_stream(folder / "root" / "other", 12)
    add_key(folder / "keys")
    return folder


@pytest.fixture(scope="module")
def url(folder: Path) -> Iterator[str]:
    with serving(folder / "root", "--keys", folder / "keys") as url:
        yield url


@pytest.fixture(scope="module")
def signer(folder: Path) -> Signer:
    return Signer(read_keys(folder / "keys"))


def send(url: str, method: str, body: bytes | None = None) -> tuple[int, Message, bytes]:
    try:
        with urlopen(Request(url, body, method=method), timeout=20) as response:
            return response.status, response.headers, response.read()
    except HTTPError as error:
        return error.code, error.headers, error.read()


def ask(url: str, method: str = "GET", body: bytes | None = None) -> tuple[int, str, bytes]:
    """Status, the play's token and body."""
    status, headers, received = send(url, method, body)
    return status, headers.get(PLAY_HEADER, ""), received


def soon() -> int:
    return int(time.time()) + 600


def test_a_signed_url_opens_all_of_its_stream(url: str, folder: Path) -> None:
    said = run_ok("swings-sign", folder / "keys", "walk", "--url", url)
    page, manifest = (line.split()[1] for line in said.splitlines())
    status, _, html = ask(page)
    assert status == 200
    assert b"og:" not in html
    found = re.findall(r'"\.\./web/([^"]+\.js)"', html.decode())
    assert found
    for asset in found:
        assert ask(f"{page.rsplit('/watch/', 1)[0]}/web/{asset}")[0] == 200
    base = manifest.rsplit("/", 1)[0]
    for name in ("manifest.json", "index.bin", "segments/0/0"):
        status, _, data = ask(f"{base}/{name}")
        assert (status, data) == (200, (folder / "root" / "walk" / name).read_bytes())
    status, token, body = ask(f"{base}/play?layers=1")
    assert status == 200
    assert isinstance(parse_records([body])[-1], EndRecord)
    # It is over; but the path led to whom it asks.
    status, _, body = ask(f"{base}/play/{token}", "POST", b'{"frame": 1}')
    assert status == 404
    assert b"no such play" in body


def test_a_url_for_all_opens_the_list(url: str, signer: Signer) -> None:
    base = url + signer.sign("*", soon())
    assert ask(f"{base}/")[0] == 200
    status, _, body = ask(f"{base}/v1/streams")
    assert [one["name"] for one in json.loads(body)["streams"]] == ["other", "walk"]
    assert ask(f"{base}{STREAM}/manifest.json")[0] == status == 200


def test_what_is_not_signed_for_it_is_403_in_one_line(url: str, signer: Signer) -> None:
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
        status, _, body = ask(url + path)
        assert status == 403, path
        message = json.loads(body)["error"]
        assert "\n" not in message
        assert len(message) < 120
    for path in ("/healthz", "/readyz"):
        assert ask(url + path)[0] == 200
    assert ask(f"{url}{STREAM}/manifest.json", "OPTIONS")[0] == 204
    assert ask(f"{url}{good}{STREAM}/play", "OPTIONS")[0] == 204


def cache_control(url: str, method: str = "GET") -> str:
    return str(send(url, method)[1]["Cache-Control"])


@pytest.mark.parametrize("method", ["GET", "HEAD"])
def test_no_shared_cache_may_keep_the_answer_to_a_signed_url(
    url: str, signer: Signer, method: str
) -> None:
    good = url + signer.sign("walk", soon())
    for _ in range(3):  # as it is read, and from the memory of the server
        match = re.fullmatch(
            r"private, max-age=(\d+), immutable",
            cache_control(f"{good}{STREAM}/segments/0/0", method),
        )
        assert match is not None
        assert 500 < int(match[1]) <= 600
    for path in (
        f"{STREAM}/manifest.json",
        f"{STREAM}/index.bin",
        "/watch/walk",
        "/web/watch.html",
    ):
        assert cache_control(good + path, method) == "private, no-cache", path
    assert cache_control(f"{good}{STREAM}/segments/9/9", method) == "no-store"
    assert cache_control(f"{url}{STREAM}/segments/0/0", method) == "no-store"
    # Files of the player are the same for all who ask without a signature.
    assert cache_control(f"{url}/web/watch.html", method) == "no-cache"
    assert cache_control(f"{good}{STREAM}/play?layers=1") == "no-store"
    in_ten_years = url + signer.sign("walk", soon() + 10 * 366 * 86400)
    assert (
        cache_control(f"{in_ten_years}{STREAM}/segments/0/0", method)
        == "private, max-age=31536000, immutable"
    )


def test_a_server_of_one_process_reads_its_keys_again_on_sighup(
    folder: Path, tmp_path: Path
) -> None:
    keys = tmp_path / "keys"
    add_key(keys)
    with server_process(folder / "root", tmp_path, "--keys", keys) as server:
        add_key(keys)
        fresh = Signer(read_keys(keys)).sign("walk", soon())
        assert get(server.port, f"{fresh}{STREAM}/manifest.json").status == 403
        os.kill(server.pid, signal.SIGHUP)
        wait_until(lambda: get(server.port, f"{fresh}{STREAM}/manifest.json").status == 200)
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
        f"/web/watch.html?src=http://host{edge}{STREAM}&{good.replace('.', '%2E')}",
        f"/web/watch.html?src=http%3A%2F%2Fhost{good.replace('/', '%2F')}%2Fv1%2Fstreams%2Fwalk",
    )
    with server_process(root, tmp_path, "--keys", keys) as server:
        statuses = [get(server.port, path).status for path in paths]
        for prefix in (good, edge):
            ask(f"http://127.0.0.1:{server.port}{prefix}{STREAM}/play", "OPTIONS")
    assert statuses[:2] == [200, 404]
    assert 200 not in statuses[2:-2]
    text = server.log.read_text()
    assert text.count("/t/***/") == 11
    assert "path=/v1/streams/walk/manifest.json" in text
    for prefix in (good, all_of_it):
        signature = prefix.rpartition(".")[2]
        assert signature[:20] not in text, text
    assert digest[:16] not in text, text


def test_other_machines_are_let_in_on_purpose_only(folder: Path) -> None:
    root, keys = folder / "root", folder / "keys"
    done = run("swings-serve", root, "--host", "0.0.0.0", "--port", 0)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.count("\n") == 1
    assert "--public" in done.stderr
    for options in (("--public",), ("--keys", keys)):
        with serving(root, "--host", "0.0.0.0", *options) as url:
            assert ask(f"{url}/healthz")[0] == 200
