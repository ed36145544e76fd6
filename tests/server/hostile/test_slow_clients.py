"""A thousand slow clients and their effect on other clients."""

from __future__ import annotations

import contextlib
import os
import resource
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from bench.serve.processes import family, rss_bytes
from tests.server.hostile.serverprocess import ServerProcess, server_process
from tests.support.commands import ROOT, environment
from tests.support.hosted_streams import write_stream
from tests.support.waiting import wait_until

CUT_S = 10.0
"""Seconds after which a client that makes no progress is cut."""
SLACK_S = 5.0
"""Additional time for a busy machine, and until the server checks."""
MEMORY_BYTES = 100 << 20
"""Memory that all slow clients together may cost the server."""

pytestmark = [
    pytest.mark.realtime,
    pytest.mark.skipif(
        sys.platform != "linux", reason="clients of many loopback addresses, and /proc: Linux only"
    ),
]


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("slow")
    write_stream(root / "big", 5, slice_size=24_000)  # objects of some MB, larger than any buffer
    write_stream(root / "small", 5)
    return root


@pytest.fixture(scope="module")
def server(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServerProcess]:
    with server_process(
        root, tmp_path_factory.mktemp("log"), "--write-timeout-s", 8, "--request-timeout-s", 8
    ) as running:
        yield running


def how_many() -> int:
    """Number of clients: 1,000, or fewer if this machine has too few descriptors."""
    return min(1000, (resource.getrlimit(resource.RLIMIT_NOFILE)[0] - 100) // 2)


def num_sockets(pid: int) -> int:
    """Sockets of the process and its children. Connections that the server has closed do not count,
    even if the kernel still keeps them."""
    count = 0
    for member in family(pid):
        for descriptor in Path(f"/proc/{member}/fd").glob("*"):
            with contextlib.suppress(OSError):
                count += os.readlink(descriptor).startswith("socket:")
    return count


def first_byte_s(port: int, path: str) -> float:
    """Seconds from a request on a new connection to the first byte of its answer."""
    began_s = time.monotonic()
    with socket.create_connection(("127.0.0.1", port), timeout=20) as sock:
        sock.sendall(f"GET {path} HTTP/1.1\r\nHost: h\r\nConnection: close\r\n\r\n".encode())
        assert sock.recv(12) == b"HTTP/1.1 200"
        took_s = time.monotonic() - began_s
        while sock.recv(1 << 16):
            pass
    return took_s


def p99(values: list[float]) -> float:
    return sorted(values)[int(0.99 * (len(values) - 1))]


@pytest.mark.parametrize("kind", ["heads", "readers"])
def test_a_thousand_slow_clients_are_cut_and_the_others_hardly_feel_them(
    kind: str, server: ServerProcess
) -> None:
    ordinary, attacked = "/v1/streams/small/segments/0/0", "/v1/streams/big/segments/0/2"
    port, count = server.port, how_many()
    if count < 50:
        pytest.skip("this machine allows too few descriptors: raise `ulimit -n`")
    begin = len(server.settled_log())
    first_byte_s(port, attacked)  # the memory of this read is not due to the attack
    alone_s = [first_byte_s(port, ordinary) for _ in range(300)]
    before_bytes, most_bytes = rss_bytes(server.pid), 0
    before_sockets = num_sockets(server.pid)
    words = [kind, port, count, CUT_S + SLACK_S + 5, attacked]
    command = [sys.executable, "-m", "tests.server.hostile.attack", *map(str, words)]
    attack = subprocess.Popen(
        command, cwd=ROOT, env=environment(), stdout=subprocess.PIPE, text=True
    )
    try:
        assert attack.stdout is not None
        assert attack.stdout.readline() == "connected\n"
        began_s = time.monotonic()
        wait_until(lambda: num_sockets(server.pid) >= before_sockets + 0.9 * count, 3)
        with_s = []
        while time.monotonic() < began_s + CUT_S / 2:  # before any is cut
            with_s.append(first_byte_s(port, ordinary))
            most_bytes = max(most_bytes, rss_bytes(server.pid))
        left = count
        while left > 0 and time.monotonic() < began_s + CUT_S + SLACK_S:
            most_bytes = max(most_bytes, rss_bytes(server.pid))
            left = num_sockets(server.pid) - before_sockets
    finally:
        attack.terminate()
        attack.communicate()
    assert left <= 0, f"{left} of {count} are kept after {CUT_S + SLACK_S} s"
    assert most_bytes - before_bytes <= MEMORY_BYTES
    assert p99(with_s) <= 2 * p99(alone_s) + 0.02, f"{p99(alone_s)} s, {p99(with_s)} s attacked"
    lines = server.settled_log()[begin:]
    assert not any("Traceback" in line for line in lines)
    assert len(lines) <= 50 + len(alone_s) + len(with_s) + 2 * count, "more than a line each"
