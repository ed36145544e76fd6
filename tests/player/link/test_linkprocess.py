"""The life of the link's process: it ends with the player, for every kind of end, and reports why
it cannot continue."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys

import pytest

from codec.errors import SwingsError
from player.link.linkprocess import LinkProcess, RelayError
from player.link.linktext import read_link
from tests.support.commands import ROOT
from tests.support.waiting import BOUND_S, is_running, wait_until

LINK = read_link("8M")

PLAYER = """
import threading
from player.link.linkprocess import LinkProcess
from player.link.linktext import read_link
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


def test_ctrl_c_is_for_the_player_alone() -> None:
    with LinkProcess(LINK, "127.0.0.1", 9) as relay:
        # A terminal sends the signal to a whole group.
        assert os.getpgid(relay.pid) != os.getpgrp()
        assert relay.down_bytes == 0
        assert relay.began_s is None


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
    monkeypatch.setattr(sys, "executable", "/absent/python")
    with pytest.raises(RelayError, match=r"the emulated link cannot start: .*No such file"):
        LinkProcess(LINK, "127.0.0.1", 9)
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with pytest.raises(RelayError, match=r"the process of the emulated link ended \(exit code 1\)"):
        LinkProcess(LINK, "127.0.0.1", 9)
