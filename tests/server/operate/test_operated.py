"""swings-serve for its operator: limits, overload, settings, the log and metrics."""

from __future__ import annotations

import resource
import socket
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.server.hostile.serverprocess import Answer, ask, exchange, figures, server_process
from tests.support.commands import run, run_ok
from tests.support.server.running_server import make_stream
from tests.support.waiting import wait_until

OBJECT = "/v1/streams/walk/segments/0/0"
PLAY = "/v1/streams/walk/play?layers=1"


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("root")
    make_stream(root / "walk", 300, title="A walk")
    make_stream(root / "wide", 900, slice_size=2000)
    return root


def forwarded(addresses: str) -> dict[str, str]:
    """The header in which a proxy names its clients."""
    return {"X-Forwarded-For": addresses}


def connect(stack: ExitStack, port: int) -> socket.socket:
    return stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=20))


def begin(stack: ExitStack, port: int, path: str, client: str = "127.0.0.1") -> socket.socket:
    """A connection that has asked for `path`, with its answer on the way."""
    sock = connect(stack, port)
    lines = f"Host: h\r\nX-Forwarded-For: {client}\r\nConnection: close"
    sock.sendall(f"GET {path} HTTP/1.1\r\n{lines}\r\n\r\n".encode())
    return sock


def test_one_address_has_so_many_connections(root: Path, tmp_path: Path) -> None:
    options = "--max-address-connections", 3, "--trusted-proxies", "10.0.0.0/8"
    with server_process(root, tmp_path, *options) as server, ExitStack() as stack:
        time.sleep(0.2)
        held = [connect(stack, server.port) for _ in range(3)]
        wait_until(lambda: ask(server.port, "/healthz").status == 429)
        assert ask(server.port, "/healthz").headers["retry-after"] == "5"
        held.pop().close()
        wait_until(lambda: ask(server.port, "/healthz").status == 200)


def test_one_client_of_a_proxy_has_so_many_plays(root: Path, tmp_path: Path) -> None:
    one, other = "198.51.100.7", "198.51.100.8"
    options = "--max-address-plays", 2
    with server_process(root, tmp_path, *options) as server, ExitStack() as stack:
        for _ in range(2):
            assert begin(stack, server.port, PLAY, one).recv(12) == b"HTTP/1.1 200"
        refused = ask(server.port, PLAY, forwarded(one))
        assert refused.status == 429
        assert int(refused.headers["retry-after"]) > 0
        # What stands left of the proxy's own word is the client's.
        assert ask(server.port, PLAY, forwarded(f"1.2.3.4, {one}")).status == 429
        assert begin(stack, server.port, PLAY, other).recv(12) == b"HTTP/1.1 200"
        stack.close()
        wait_until(lambda: ask(server.port, f"{PLAY}&until=3", forwarded(one)).status == 200)


def test_a_stranger_cannot_say_who_it_is(root: Path, tmp_path: Path) -> None:
    options = "--max-address-plays", 1, "--trusted-proxies", "10.0.0.0/8"
    with server_process(root, tmp_path, *options) as server, ExitStack() as stack:
        begin(stack, server.port, PLAY, "198.51.100.7").recv(12)
        assert ask(server.port, PLAY, forwarded("198.51.100.8")).status == 429


def test_connections_above_the_limit_wait_and_are_served(root: Path, tmp_path: Path) -> None:
    with server_process(root, tmp_path, "--max-connections", 4) as server, ExitStack() as stack:
        held = [connect(stack, server.port) for _ in range(4)]
        time.sleep(0.5)
        waiting = [begin(stack, server.port, "/healthz") for _ in range(8)]
        time.sleep(0.5)
        for sock in waiting:
            sock.setblocking(False)
            with pytest.raises(BlockingIOError):
                sock.recv(1)
            sock.settimeout(20)
        for sock in held:
            sock.close()
        assert [sock.recv(12) for sock in waiting] == [b"HTTP/1.1 200"] * 8


@pytest.mark.realtime
@pytest.mark.skipif(sys.platform != "linux", reason="limits of open files as on Linux")
def test_idle_clients_beyond_all_descriptors_are_waited_out_quietly(
    root: Path, tmp_path: Path
) -> None:
    """Without room for 150 connections the log stays short, and later clients are served soon."""

    def few_files() -> None:
        resource.setrlimit(resource.RLIMIT_NOFILE, (128, 128))

    options = "--request-timeout-s", 3
    with (
        server_process(root, tmp_path, *options, before=few_files) as server,
        ExitStack() as stack,
    ):
        for _ in range(150):
            connect(stack, server.port)
        time.sleep(1)
        began_s = time.monotonic()
        last = begin(stack, server.port, "/healthz")
        assert last.recv(12) == b"HTTP/1.1 200"
        assert time.monotonic() - began_s < 12
        time.sleep(0.5)
        assert len(server.log_lines()) <= 11, server.log.read_text()[:2000]


def test_too_much_egress_sheds_layers_then_refuses_and_recovers(root: Path, tmp_path: Path) -> None:
    options = "--max-egress-bps", 6e6, "--smooth-s", 0.3, "--recover-per-s", 0.5
    with server_process(root, tmp_path, *options) as server, ExitStack() as stack:
        # Clients request far more than that, and read it as fast as it arrives.
        def shed() -> float:
            return figures(server.port)["swings_shed_layers",]

        assert shed() == 0
        script = (
            "import sys, urllib.request as u\n"
            "with u.urlopen(sys.argv[1]) as r:\n"
            "    while r.read(65536): pass\n"
        )
        url = f"http://127.0.0.1:{server.port}/v1/streams/wide/play"
        for _ in range(3):
            taker = subprocess.Popen([sys.executable, "-c", script, url])
            stack.callback(taker.wait)
            stack.callback(taker.kill)
        wait_until(lambda: shed() >= 1)
        refused: list[Answer] = []

        def is_refused() -> bool:
            refused.append(ask(server.port, f"{PLAY}&until=2"))
            return refused[-1].status == 503

        wait_until(is_refused)
        assert int(refused[-1].headers["retry-after"]) > 0
        stack.close()
        wait_until(lambda: shed() == 0)
        assert ask(server.port, f"{PLAY}&until=2").status == 200


def test_settings_come_from_the_environment(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SWINGS_SERVE_MAX_PLAYS", "1")
    assert "SWINGS_SERVE_MAX_PLAYS=1\n" in run_ok("swings-serve", root, "--check-config")
    with server_process(root, tmp_path) as server, ExitStack() as stack:
        assert begin(stack, server.port, PLAY).recv(12) == b"HTTP/1.1 200"
        assert ask(server.port, PLAY).status == 503
    monkeypatch.setenv("SWINGS_SERVE_MAX_PLAY", "1")
    done = run("swings-serve", root, "--check-config")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "SWINGS_SERVE_MAX_PLAYS?" in done.stderr


def test_every_line_of_a_json_log_is_json(root: Path, tmp_path: Path) -> None:
    escapes = '/\x1b[2J%1b]0;x%07"quoted"'
    with server_process(root, tmp_path, "--log", "json") as server:
        ask(server.port, OBJECT)
        ask(server.port, f"{PLAY}&until=2")
        exchange(server.port, f"GET {escapes} HTTP/1.1\r\nHost: h\r\n\r\n".encode())
        ask(server.port, "/%1b%5b2J", {"User-Agent": "\t\xff"})
        time.sleep(0.6)
    lines, told = server.log_lines(), server.events()
    assert len(told) == len(lines) - 1  # the first one is its URL
    assert all(line.isascii() and line.isprintable() for line in lines)
    assert OBJECT in [one.get("path") for one in told]
    play = next(one for one in told if str(one.get("path", "")).endswith("/play"))
    assert play["outcome"] == "complete"


def test_any_worker_tells_what_both_have_counted(root: Path, tmp_path: Path) -> None:
    with server_process(root, tmp_path, "--workers", 2) as server:
        for _ in range(40):
            assert ask(server.port, "/healthz").status == 200

        counted = "swings_requests_total", "/healthz", "200"
        wait_until(lambda: figures(server.port).get(counted) == 40)
        assert [figures(server.port)[counted] for _ in range(6)] == [40] * 6  # whoever is asked
        # Both see the same streams, and no load.
        wait_until(lambda: figures(server.port).get(("swings_streams", "served")) == 2)
        assert figures(server.port)["swings_shed_layers",] == 0
