"""Notifications to systemd: from the class alone, and from servers with one and two workers."""

from __future__ import annotations

import os
import signal
import socket
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from server.operate.watchdog import Watchdog
from tests.server.hostile.serverprocess import server_process
from tests.support.server.running_server import make_stream

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="systemd is Linux's")


@pytest.fixture
def systemd(tmp_path: Path) -> Iterator[socket.socket]:
    """The socket on which systemd is notified."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.bind(str(tmp_path / "notify"))
        receiver.settimeout(10)
        yield receiver


def test_without_systemd_nothing_is_sent() -> None:
    watchdog = Watchdog({})
    watchdog.ready()
    watchdog.ping()


@pytest.mark.parametrize("pid", ["", "own", "1"])
def test_heartbeats_go_out_when_due(systemd: socket.socket, pid: str) -> None:
    environment = {
        "NOTIFY_SOCKET": systemd.getsockname(),
        "WATCHDOG_USEC": "90000000",
        "WATCHDOG_PID": str(os.getpid()) if pid == "own" else pid,
    }
    watchdog = Watchdog(environment)
    assert not environment  # no other code may notify
    watchdog.ready()
    for _ in range(3):
        watchdog.ping()
    assert systemd.recv(100) == b"READY=1"
    systemd.setblocking(False)
    if pid != "1":  # the variable of another process
        assert systemd.recv(100) == b"WATCHDOG=1"
    with pytest.raises(BlockingIOError):
        systemd.recv(100)


def test_a_socket_in_the_abstract_namespace() -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.bind(f"\0swings-{os.getpid()}")
        receiver.settimeout(10)
        Watchdog({"NOTIFY_SOCKET": f"@swings-{os.getpid()}"}).ready()
        assert receiver.recv(100) == b"READY=1"


def test_a_systemd_that_is_gone_is_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    Watchdog({"NOTIFY_SOCKET": str(tmp_path / "nowhere")}).ready()
    assert "systemd was not notified" in caplog.text


@pytest.mark.realtime
@pytest.mark.parametrize("workers", [1, 2])
def test_a_server_is_ready_and_sends_heartbeats_until_it_hangs(
    systemd: socket.socket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, workers: int
) -> None:
    make_stream(tmp_path / "root" / "walk", 30)
    monkeypatch.setenv("NOTIFY_SOCKET", systemd.getsockname())
    monkeypatch.setenv("WATCHDOG_USEC", "3000000")
    with server_process(tmp_path / "root", tmp_path, "--workers", workers) as server:
        received = [systemd.recv(100) for _ in range(4)]
        assert sorted(received[:2]) == [b"READY=1", b"WATCHDOG=1"]
        assert received[2:] == [b"WATCHDOG=1"] * 2
        os.kill(server.pid, signal.SIGSTOP)
        try:
            time.sleep(0.2)
            systemd.settimeout(0)
            while True:
                systemd.recv(100)
        except BlockingIOError:
            systemd.settimeout(3)
            with pytest.raises(TimeoutError):
                systemd.recv(100)
        finally:
            os.kill(server.pid, signal.SIGCONT)
        systemd.settimeout(10)
        assert systemd.recv(100) == b"WATCHDOG=1"
