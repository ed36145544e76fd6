"""The link's process: what passes it on real sockets, and its life: it ends with the player, for
every kind of end, and reports why it cannot continue. test_honest_link.py measures its times."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from urllib.error import HTTPError
from urllib.request import urlopen

import pytest

from codec.errors import SwingsError
from player.link.linkprocess import LinkProcess, RelayError
from player.link.relay import read_link
from tests.player.link.pouring import drain, pouring
from tests.support.commands import ROOT
from tests.support.ports import kept_port
from tests.support.waiting import BOUND_S, is_running, wait_until

LINK = read_link("8M")

PLAYER = """
import threading
from player.link.linkprocess import LinkProcess
from player.link.relay import read_link
relay = LinkProcess(read_link("8M"), "127.0.0.1", 9)
print(relay.pid, relay.address[1], flush=True)
threading.Event().wait()
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM])
def test_it_ends_with_whoever_started_it(number: signal.Signals) -> None:
    player = subprocess.Popen(
        [sys.executable, "-c", PLAYER],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert player.stdout is not None
    with player.stdout:
        pid, port = map(int, player.stdout.readline().split())
        assert is_running(pid)
        player.send_signal(number)
        player.wait(timeout=BOUND_S)
        wait_until(lambda: not is_running(pid))
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", port), timeout=5)


def test_one_that_dies_is_named_instead_of_what_follows() -> None:
    message = r"the process of the emulated link ended \(signal 9\); play again"

    def play(relay: LinkProcess, kill: bool) -> None:
        with relay:
            if kill:
                os.kill(relay.pid, signal.SIGKILL)
                wait_until(lambda: not is_running(relay.pid))
            raise SwingsError("the connection broke")

    with pytest.raises(RelayError, match=message):
        play(LinkProcess(LINK, "127.0.0.1", 9), kill=True)
    with pytest.raises(SwingsError, match="the connection broke"):
        play(LinkProcess(LINK, "127.0.0.1", 9), kill=False)
    with LinkProcess(LINK, "127.0.0.1", 9) as relay:
        os.kill(relay.pid, signal.SIGKILL)
        with pytest.raises(RelayError, match=message):
            assert relay.down_bytes


def test_one_that_cannot_start_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    for program, message in (
        ("/absent/python", r"the emulated link cannot start: .*No such file"),
        ("/bin/false", r"the process of the emulated link ended \(exit code 1\)"),
    ):
        monkeypatch.setattr(sys, "executable", program)
        with pytest.raises(RelayError, match=message):
            LinkProcess(LINK, "127.0.0.1", 9)


def test_all_bytes_of_all_connections_pass_and_are_counted() -> None:
    with (
        pouring(150_000) as server,
        LinkProcess(read_link("1G"), "127.0.0.1", server.port) as relay,
        ThreadPoolExecutor(4) as pool,
    ):
        assert (relay.down_bytes, relay.began_s) == (0, None)
        # Ctrl-C is for the player alone: a terminal sends the signal to a whole group.
        assert os.getpgid(relay.pid) != os.getpgrp()
        assert [*pool.map(drain, [relay.address] * 4)] == [150_000] * 4
        assert relay.down_bytes == 600_000


def test_a_player_that_does_not_read_holds_the_server_back() -> None:
    with (
        pouring(None) as server,
        LinkProcess(read_link("1G"), "127.0.0.1", server.port) as relay,
        socket.socket() as connection,
    ):
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 64 << 10)
        connection.connect(relay.address)
        assert server.held.wait(BOUND_S)
        assert 0 < server.sent_bytes < 2 << 20


def test_a_server_that_is_away_is_said_in_http() -> None:
    with LinkProcess(LINK, "127.0.0.1", kept_port()) as relay, pytest.raises(HTTPError) as answer:
        urlopen("http://{}:{}/".format(*relay.address), timeout=BOUND_S)
    assert answer.value.code == 502
    assert b"cannot connect" in answer.value.read()


def test_closing_the_relay_cuts_its_connections() -> None:
    with pouring(None) as server:
        relay = LinkProcess(read_link("100k"), "127.0.0.1", server.port)
        with socket.create_connection(relay.address, timeout=BOUND_S) as connection:
            assert connection.recv(1)
            relay.close()
            relay.close()
            with contextlib.suppress(ConnectionError):
                while connection.recv(65536):
                    pass
