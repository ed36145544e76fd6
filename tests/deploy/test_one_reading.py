"""Bodies whose end two readers could place differently: a proxy and swings-serve must agree."""

from __future__ import annotations

import json
import re
import socket
import ssl
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import pytest

from tests.deploy.proxied import Proxy, Start, caddy, need, nginx
from tests.server.hostile.requestcases import smuggling
from tests.server.hostile.serverprocess import server_process
from tests.support.hosted_streams import write_stream
from tests.support.waiting import BOUND_S

WAIT_S = 1.5
"""Time without a response after which the proxy is taken to consider a request incomplete. If it is
only slow, the request is not compared."""


def targets_of_nginx(folder: Path) -> Counter[str]:
    """The targets in the access log, with the number of their requests."""
    text = (folder / "access.log").read_text()
    return Counter(re.findall(r'"[A-Z]+ (\S+) HTTP/[0-9.]+"', text))


def targets_of_caddy(folder: Path) -> Counter[str]:
    """The targets in the log, with the number of their requests."""
    records = map(json.loads, (folder / "out.log").read_text().splitlines())
    return Counter(record["request"]["uri"] for record in records if "request" in record)


PROXIES: dict[str, tuple[Start, Callable[[Path], Counter[str]]]] = {
    "nginx": (nginx, targets_of_nginx),
    "caddy": (caddy, targets_of_caddy),
}


def send(proxy: Proxy, sent: bytes, wait_s: float = WAIT_S) -> None:
    """Sends a request with a hidden one over one connection, and waits for the responses."""
    with suppress(OSError), socket.create_connection(("127.0.0.1", proxy.port), wait_s) as plain:
        sock: socket.socket = plain
        if proxy.tls:
            context = ssl._create_unverified_context()  # a certificate of the test
            context.set_alpn_protocols(["http/1.1"])
            sock = context.wrap_socket(plain)
        with sock:
            sock.sendall(sent)
            while sock.recv(1 << 16):
                pass


@pytest.mark.parametrize("name", sorted(PROXIES))
def test_a_proxy_and_the_server_read_the_same_requests(name: str, tmp_path: Path) -> None:
    """The proxy has read every request that the server reads."""
    need(name)
    start, targets_of = PROXIES[name]
    folder, root = tmp_path / name, tmp_path / "root"
    folder.mkdir()
    write_stream(root / "walk", 4, fps=10.0)
    # Each case has its own targets of the same length, so that lengths stay correct.
    requests = [
        case.sent.replace(b"/poison", b"/pois%02d" % number).replace(
            b"/nobody", b"/nobo%02d" % number
        )
        for number, case in enumerate(smuggling())
    ]
    with (
        server_process(root, tmp_path, "--log", "json", "--log-requests", "all") as server,
        start(server.port, folder) as proxy,
        ThreadPoolExecutor(16) as pool,
    ):
        send(proxy, b"GET /healthz HTTP/1.1\r\nHost: h\r\nConnection: close\r\n\r\n", BOUND_S)
        list(pool.map(lambda sent: send(proxy, sent), requests))
    lines = [json.loads(line) for line in server.log.read_text().splitlines() if line[:1] == "{"]
    read = Counter(line["path"] for line in lines if line.get("path"))
    forwarded = targets_of(folder)
    assert read["/healthz"] >= 1, "nothing came through"
    assert not read - forwarded, "the server read what the proxy did not"
