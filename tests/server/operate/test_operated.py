"""swings-serve for its operator: limits, overload, settings, the log and metrics."""

from __future__ import annotations

import asyncio
import os
import resource
import signal
import socket
import sys
from contextlib import ExitStack, closing
from dataclasses import replace
from http.client import HTTPConnection
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import urlopen

import aiohttp
import pytest

from server.operate.admission import AdmissionConfig
from server.operate.overload import OverloadConfig
from server.state.config import ServerConfig
from tests.server.hostile.serverprocess import ask, exchange, figures, samples, server_process
from tests.support.commands import run, run_ok, serving
from tests.support.server.running_server import (
    Running,
    eventually,
    make_stream,
    quick_config,
    running,
    served,
)
from tests.support.waiting import BOUND_S, wait_until

pytestmark = pytest.mark.anyio

OBJECT = "/v1/streams/walk/segments/0/0"
PLAY = "/v1/streams/walk/play?layers=1"


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("root")
    make_stream(root / "walk", 300, title="A walk")
    make_stream(root / "wide", 5, slice_size=24_000)
    return root


def forwarded(addresses: str) -> dict[str, str]:
    """The header in which a proxy names its clients."""
    return {"X-Forwarded-For": addresses}


def connect(stack: ExitStack, port: int) -> socket.socket:
    return stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=BOUND_S))


def begin(stack: ExitStack, port: int, path: str) -> socket.socket:
    """A connection that has asked for `path`, with its answer on the way."""
    sock = connect(stack, port)
    sock.sendall(f"GET {path} HTTP/1.1\r\nHost: h\r\nConnection: close\r\n\r\n".encode())
    return sock


def limited(**limits: Any) -> ServerConfig:
    """A config that trusts no proxy on this machine. limits: of its AdmissionConfig."""
    return replace(
        quick_config(), admission=AdmissionConfig(**limits), trusted_proxies="10.0.0.0/8"
    )


async def status_of(server: Running, path: str, **fields: str) -> int:
    """Status of the answer over a connection of its own, which need not be read to its end."""
    async with (
        aiohttp.ClientSession(server.url) as client,
        client.get(path, headers=fields) as response,
    ):
        if response.status == 429:
            assert int(response.headers["Retry-After"]) > 0
        return response.status


async def test_one_address_has_so_many_connections(root: Path) -> None:
    async with running(root, limited(max_address_connections=3)) as server:
        with ExitStack() as stack:
            held = [connect(stack, server.port) for _ in range(3)]
            await eventually(lambda: server.state.connections.num_held == 3)
            assert await status_of(server, "/healthz") == 429
            held.pop().close()
            await eventually(lambda: server.state.connections.num_held == 2)
            assert await status_of(server, "/healthz") == 200


async def test_one_client_of_a_proxy_has_so_many_plays(root: Path) -> None:
    one, other = forwarded("198.51.100.7"), forwarded("198.51.100.8")
    trusting = replace(limited(max_address_plays=2), trusted_proxies="127.0.0.0/8")
    async with (
        served(root, trusting) as (server, client),
        client.get(PLAY, headers=one),
        client.get(PLAY, headers=one),
    ):
        assert await status_of(server, PLAY, **one) == 429
        # What stands left of the proxy's own word is the client's.
        assert await status_of(server, PLAY, **forwarded("1.2.3.4, 198.51.100.7")) == 429
        assert await status_of(server, PLAY, **other) == 200


async def test_a_stranger_cannot_say_who_it_is(root: Path) -> None:
    async with (
        served(root, limited(max_address_plays=1)) as (server, client),
        client.get(PLAY, headers=forwarded("198.51.100.7")),
    ):
        assert await status_of(server, PLAY, **forwarded("198.51.100.8")) == 429


async def test_connections_above_the_limit_are_refused_at_once(root: Path) -> None:
    async with running(root, limited(max_connections=4)) as server:
        with ExitStack() as stack:
            held = [connect(stack, server.port) for _ in range(4)]
            await eventually(lambda: server.state.connections.num_held == 4)
            for _ in range(8):
                assert await status_of(server, "/healthz") == 429
            assert server.state.metrics.refused.value("connection_full") == 8
            held[0].sendall(b"GET /healthz HTTP/1.1\r\nHost: h\r\n\r\n")
            assert await asyncio.to_thread(held[0].recv, 12) == b"HTTP/1.1 200"
            held.pop().close()
            await eventually(lambda: server.state.connections.num_held == 3)
            assert await status_of(server, "/healthz") == 200


@pytest.mark.skipif(sys.platform != "linux", reason="limits of open files as on Linux")
def test_clients_beyond_all_descriptors_are_refused_quietly(root: Path, tmp_path: Path) -> None:
    """Without room for 150 connections the log stays short, and later clients are served."""

    def few_files() -> None:
        resource.setrlimit(resource.RLIMIT_NOFILE, (128, 128))

    with server_process(root, tmp_path, before=few_files) as server, ExitStack() as stack:
        first = stack.enter_context(closing(HTTPConnection("127.0.0.1", server.port)))

        def num(name: str, *labels: str) -> float:
            first.request("GET", "/metrics")
            return samples(first.getresponse().read().decode()).get((name, *labels), 0)

        assert num("swings_open_connections") <= 1
        held = [connect(stack, server.port) for _ in range(150)]
        last = begin(stack, server.port, "/healthz")
        assert last.recv(12) == b"HTTP/1.1 429"
        wait_until(lambda: num("swings_refused_total", "connection_full") > 90)
        for sock in held:
            sock.close()
        wait_until(lambda: num("swings_open_connections") == 1)
        assert ask(server.port, "/healthz").status == 200
    assert len(server.log_lines()) <= 11


async def test_too_much_egress_sheds_layers_then_refuses_and_recovers(root: Path) -> None:
    """Objects of megabytes are far more than that; the refusals themselves are not."""
    overload = OverloadConfig(max_egress_bps=1e6, smooth_s=1.0, max_late_s=1e6, recover_per_s=5.0)

    async with served(root, replace(quick_config(), overload=overload)) as (server, client):
        shed = server.state.metrics.shed_layers._value

        async def is_refused() -> bool:
            await (await client.get("/v1/streams/wide/segments/0/2")).read()
            async with client.get(f"{PLAY}&until=2") as response:
                return response.status == 503 and int(response.headers["Retry-After"]) > 0

        async with asyncio.timeout(BOUND_S):
            while not (await is_refused() and shed.get()):
                pass
        await eventually(lambda: not shed.get())
        assert await status_of(server, f"{PLAY}&until=2") == 200


def test_settings_come_from_the_environment(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SWINGS_SERVE_MAX_PLAYS", "1")
    assert "SWINGS_SERVE_MAX_PLAYS=1\n" in run_ok("swings-serve", root, "--check-config")
    with serving(root) as url, urlopen(url + PLAY) as response:
        assert response.status == 200
        with pytest.raises(HTTPError, match="503"):
            urlopen(url + PLAY)
    monkeypatch.setenv("SWINGS_SERVE_MAX_PLAY", "1")
    done = run("swings-serve", root, "--check-config")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "SWINGS_SERVE_MAX_PLAYS?" in done.stderr


@pytest.mark.parametrize("requests", ["plays", "all"])
def test_every_line_of_a_json_log_is_json(root: Path, tmp_path: Path, requests: str) -> None:
    escapes = '/\x1b[2J%1b]0;x%07"quoted"'
    options = "--log", "json", "--log-requests", requests
    with server_process(root, tmp_path, *options) as server:
        ask(server.port, OBJECT)
        ask(server.port, f"{PLAY}&until=2")
        exchange(server.port, f"GET {escapes} HTTP/1.1\r\nHost: h\r\n\r\n".encode())
        ask(server.port, "/%1b%5b2J", {"User-Agent": "\t\xff"})
    lines, told = server.log_lines(), server.events()
    assert len(told) == len(lines) - 1  # the first one is its URL
    assert all(line.isascii() and line.isprintable() for line in lines)
    paths = [one.get("path") for one in told]
    assert (OBJECT in paths) == (requests == "all")
    assert "/%1b%5b2J" in paths  # an error
    play = next(one for one in told if str(one.get("path", "")).endswith("/play"))
    assert (play["outcome"], play["layers"]) == ("complete", 1)


def test_any_worker_tells_what_all_have_counted_the_dead_ones_too(
    root: Path, tmp_path: Path
) -> None:
    with (
        server_process(root, tmp_path, "--workers", 2, "--log", "json") as server,
        ExitStack() as stack,
    ):
        for _ in range(40):
            assert ask(server.port, "/healthz").status == 200

        counted = "swings_requests_total", "/healthz", "200"
        wait_until(lambda: figures(server.port).get(counted) == 40)
        assert [figures(server.port)[counted] for _ in range(6)] == [40] * 6  # whoever is asked
        # Both see the same streams, and no load.
        wait_until(lambda: figures(server.port).get(("swings_streams", "served")) == 2)
        assert figures(server.port)["swings_shed_layers",] == 0
        begin(stack, server.port, PLAY)
        wait_until(lambda: figures(server.port)["swings_active_plays",] == 1)
        wait_until(lambda: len(server.events("worker_ready")) == 2)
        for line in server.events("worker_ready"):
            os.kill(line["pid"], signal.SIGKILL)
        wait_until(lambda: len(server.events("worker_ready")) == 4)
        found = figures(server.port)
        assert (found[counted], found["swings_active_plays",]) == (40, 0)
