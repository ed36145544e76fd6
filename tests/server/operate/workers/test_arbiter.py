"""Real processes: killed, hung, ended, renewed, orphaned; and their clients."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

import pytest

from server.operate.workers.arbiter import restart_delay_s
from tests.server.hostile.serverprocess import Comers, ServerProcess, logged_process
from tests.support.commands import environment
from tests.support.waiting import BOUND_S, is_running, wait_until


class Talk:
    """A connection, and the number of its worker."""

    def __init__(self, port: int) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port), timeout=BOUND_S)
        self._file = self._socket.makefile("rb")
        try:
            self.number, self.pid = map(int, self._file.readline().split())
        except (OSError, ValueError):  # cut before the response
            self.close()
            raise

    def send(self, line: bytes) -> None:
        self._socket.sendall(line + b"\n")

    def line(self) -> bytes:
        return self._file.readline()

    def echoes(self, word: bytes) -> bool:
        self.send(word)
        return self.line() == word + b"\n"

    def close(self) -> None:
        self._file.close()
        self._socket.close()


def echo_workers(what: str, **settings: object) -> list[str]:
    """The command of echo_workers.py."""
    module = "tests.server.operate.workers.echo_workers"
    return [sys.executable, "-m", module, what, json.dumps(settings)]


@contextmanager
def serving(
    folder: Path, what: str = "echo", workers: int = 2, **settings: object
) -> Iterator[ServerProcess]:
    """An arbiter whose workers are ready."""
    words = echo_workers(what, workers=workers, **settings)
    with logged_process(words, folder, cwd=folder) as served:
        wait_until(lambda: len(served.events("worker_ready")) >= workers)
        yield served


def is_refused(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port)).close()
    except ConnectionRefusedError:
        return True
    return False


@pytest.mark.parametrize("kills", [1, pytest.param(20, marks=pytest.mark.deep)])
def test_killed_workers_cut_no_other_connection_and_none_is_refused(
    tmp_path: Path, kills: int
) -> None:
    def come() -> None:
        # A client of a killed worker may lose its connection.
        with (
            suppress(ConnectionResetError),
            socket.create_connection(("127.0.0.1", served.port), timeout=BOUND_S) as one,
        ):
            one.recv(100)

    def oldest(safe: Talk) -> int:
        """A worker besides that of `safe`; one that dies young delays the next start."""
        gone = {safe.pid, *(line["pid"] for line in served.events("worker_died"))}
        return next(
            int(line["pid"]) for line in served.events("worker_ready") if line["pid"] not in gone
        )

    with serving(tmp_path, workers=3) as served, closing(Talk(served.port)) as safe:
        with Comers(come) as comers:
            for n in range(kills):
                os.kill(oldest(safe), signal.SIGKILL)
                wait_until(lambda n=n: len(served.events("worker_died")) == n + 1)
                assert safe.echoes(b"%d" % n)
                wait_until(lambda n=n: len(served.events("worker_ready")) == n + 4)
        assert comers.troubles == []
        assert served.events("worker_died")[0]["restart_s"] == 0.0
        assert any("SIGKILL" in line["message"] for line in served.events("record"))
        # Each number belongs to one worker at a time, and is released before it is reused.
        holders: dict[int, int] = {}
        for line in served.events():
            if line["event"] == "worker_ready":
                assert line["worker"] not in holders
                holders[line["worker"]] = line["pid"]
            elif line["event"] == "forgotten":
                del holders[line["worker"]]
        assert set(holders) == {0, 1, 2}


def test_a_worker_that_hangs_is_replaced(tmp_path: Path) -> None:
    settings = {"workers": 1, "worker_timeout_s": 60}
    with serving(tmp_path, "echo", **settings) as served, closing(Talk(served.port)) as talk:
        assert talk.echoes(b"hang")
        # As after 60 s without a heartbeat, which is the stamp of a file.
        for descriptor in Path(f"/proc/{talk.pid}/fd").iterdir():
            if "wgunicorn" in os.readlink(descriptor):
                os.utime(descriptor, (-1e6, -1e6))
        wait_until(lambda: len(served.events("worker_ready")) == 2)
        assert [line["pid"] for line in served.events("worker_died")] == [talk.pid]
        messages = [line["message"] for line in served.events("record")]
        assert f"WORKER TIMEOUT (pid:{talk.pid})" in messages
        hangs = [message for message in messages if message.startswith("the event loop hangs in")]
        assert [" talk" in message for message in hangs] == [True]


def test_delays_of_restarts_double_up_to_a_bound() -> None:
    assert [restart_delay_s(n) for n in range(7)] == [0, 0, 0.1, 0.2, 0.4, 0.8, 1.6]
    assert restart_delay_s(20) == restart_delay_s(10_000) == 10


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_it_ends_its_workers_and_then_itself(tmp_path: Path, number: signal.Signals) -> None:
    with serving(tmp_path, "slow") as served, closing(Talk(served.port)) as talk:
        if number is signal.SIGINT:  # a terminal sends it to all; workers leave it to the arbiter
            for line in served.events("worker_ready"):
                os.kill(line["pid"], number)
        served.process.send_signal(number)
        wait_until(lambda: served.events("stopping"))
        assert talk.echoes(b"still here")
        # Connections while they end are refused at once, and do not wait in vain.
        wait_until(lambda: is_refused(served.port))
        assert talk.pid not in [line["pid"] for line in served.events("worker_ended")]
        talk.close()
        assert served.process.wait(timeout=BOUND_S) == 0
        assert len(served.events("worker_ended")) == 2
        assert not served.events("worker_killed")
        assert len(served.log_lines()) == 1 + len(served.events())  # the first is its URL


def test_workers_that_do_not_end_are_killed(tmp_path: Path) -> None:
    with serving(tmp_path, "stubborn", shutdown_timeout_s=0.6) as served:
        served.process.send_signal(signal.SIGTERM)
        assert served.process.wait(timeout=BOUND_S) == 0
        assert len(served.events("worker_killed")) == 2


def test_workers_do_not_outlive_their_arbiter(tmp_path: Path) -> None:
    with serving(tmp_path, workers=3) as served:
        pids = [line["pid"] for line in served.events("worker_ready")]
        served.process.kill()
        wait_until(lambda: not any(map(is_running, pids)))


def test_new_workers_that_die_at_a_renewal_are_started_until_they_serve(tmp_path: Path) -> None:
    with serving(tmp_path) as served, closing(Talk(served.port)) as talk:
        (tmp_path / "refuse").touch()
        served.process.send_signal(signal.SIGHUP)
        wait_until(lambda: len(served.events("worker_died")) >= 3)
        assert {line["error"] for line in served.events("worker_died")} == {
            "there is nothing to serve"
        }
        assert talk.echoes(b"still here")
        (tmp_path / "refuse").unlink()
        wait_until(lambda: len(served.events("worker_ended")) == 2)


def test_a_server_that_cannot_start_says_why_in_one_line(tmp_path: Path) -> None:
    done = subprocess.run(
        echo_workers("refuse", workers=2),
        cwd=tmp_path,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=BOUND_S,
    )
    assert (done.returncode, done.stdout) == (1, "")
    *lines, last = done.stderr.splitlines()
    assert last == "failed: there is nothing to serve"
    assert {json.loads(line)["event"] for line in lines} == {"forgotten"}
