"""Notifications to systemd: from the class alone, and from servers with one and two workers."""

from __future__ import annotations

import contextlib
import os
import socket
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from server.operate.watchdog import Watchdog
from tests.server.hostile.serverprocess import server_process
from tests.support.server.running_server import make_stream
from tests.support.server.virtualtime import hold_up, in_virtual_time, passes
from tests.support.waiting import BOUND_S

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="systemd is Linux's")


@pytest.fixture
def systemd(tmp_path: Path) -> Iterator[socket.socket]:
    """The socket on which systemd is notified."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.bind(str(tmp_path / "notify"))
        receiver.settimeout(BOUND_S)
        yield receiver


def test_without_systemd_nothing_is_sent() -> None:
    Watchdog({}).ready()


def test_the_variables_of_another_process_want_no_heartbeat(systemd: socket.socket) -> None:
    notify = {"NOTIFY_SOCKET": systemd.getsockname()}
    environment = {**notify, "WATCHDOG_USEC": "90000000", "WATCHDOG_PID": "1"}
    watchdog = Watchdog(environment)
    assert not environment  # no other code may notify
    watchdog.ready()
    assert received(systemd) == [b"READY=1"]


def test_a_socket_in_the_abstract_namespace() -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.bind(f"\0swings-{os.getpid()}")
        receiver.settimeout(BOUND_S)
        Watchdog({"NOTIFY_SOCKET": f"@swings-{os.getpid()}"}).ready()
        assert receiver.recv(100) == b"READY=1"


def test_a_systemd_that_is_gone_is_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    Watchdog({"NOTIFY_SOCKET": str(tmp_path / "nowhere")}).ready()
    assert "systemd was not notified" in caplog.text


def received(systemd: socket.socket) -> list[bytes]:
    """What has arrived."""
    found = []
    systemd.setblocking(False)
    with contextlib.suppress(BlockingIOError):
        while True:
            found.append(systemd.recv(100))
    return found


@in_virtual_time
async def test_the_event_loop_sends_heartbeats_until_it_hangs(systemd: socket.socket) -> None:
    own = {"WATCHDOG_USEC": "3000000", "WATCHDOG_PID": str(os.getpid())}
    Watchdog({"NOTIFY_SOCKET": systemd.getsockname(), **own}).ready()
    assert received(systemd) == [b"READY=1", b"WATCHDOG=1"]
    counts = []
    for _ in range(10):
        await passes(1.0)
        counts.append(len(received(systemd)))
    assert counts == 10 * [1]
    hold_up(100)
    assert received(systemd) == []
    await passes(0.5)
    assert received(systemd) == [b"WATCHDOG=1"]


@pytest.mark.parametrize("workers", [1, 2])
def test_a_server_is_ready_and_sends_heartbeats(
    systemd: socket.socket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, workers: int
) -> None:
    make_stream(tmp_path / "root" / "walk", 5)
    monkeypatch.setenv("NOTIFY_SOCKET", systemd.getsockname())
    monkeypatch.setenv("WATCHDOG_USEC", "300000")
    with server_process(tmp_path / "root", tmp_path, "--workers", workers):
        found = list[bytes]()
        while b"READY=1" not in found or found.count(b"WATCHDOG=1") < 3:
            found.append(systemd.recv(100))
        assert set(found) == {b"READY=1", b"WATCHDOG=1"}
