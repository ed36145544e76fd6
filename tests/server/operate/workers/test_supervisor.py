"""Real processes: killed, told to end, renewed, orphaned; and the clients that they serve."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from codec.errors import InvalidError
from server.operate.workers.supervisor import SupervisorConfig
from tests.support.commands import ROOT


class Served:
    """A supervisor with its workers."""

    def __init__(self, what: str, folder: Path, settings: dict[str, Any]) -> None:
        self.process = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "tests.server.operate.workers.echo_workers",
                what,
                json.dumps(settings),
            ],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        self.told: list[dict[str, Any]] = []
        self.rest: list[str] = []
        self._reader = threading.Thread(target=self._read)
        self._reader.start()
        assert self.process.stdout is not None
        self.port = int(self.process.stdout.readline() or 0)

    def _read(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            if line.startswith(b"{"):
                self.told.append(json.loads(line))
            else:
                self.rest.append(line.decode())

    def connect(self) -> Talk:
        return Talk(self.port)

    def events(self, event: str) -> list[dict[str, Any]]:
        return [line for line in list(self.told) if line["event"] == event]

    def end(self) -> int:
        """Its exit status, when it has ended and all is read of what it told."""
        code = self.process.wait(timeout=30)
        self._reader.join(10)
        return code


class Talk:
    """A connection, and which worker has it."""

    def __init__(self, port: int) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port), timeout=20)
        self._file = self._socket.makefile("rb")
        words = self._file.readline().split()
        assert len(words) == 2, "cut before it began"
        self.number, self.pid = map(int, words)

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


@contextmanager
def serving(folder: Path, what: str = "echo", **settings: Any) -> Iterator[Served]:
    served = Served(what, folder, settings)
    try:
        yield served
    finally:
        served.process.kill()
        served.end()
        assert served.process.stdout is not None
        served.process.stdout.close()
        assert served.process.stderr is not None
        served.process.stderr.close()


def wait_until(holds: Callable[[], object], seconds: float = 15.0) -> None:
    end_s = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end_s, "it did not happen"
        time.sleep(0.005)


def is_refused(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port)).close()
    except ConnectionRefusedError:
        return True
    return False


def is_alive(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except OSError:
        return False
    return state != "Z"


@pytest.mark.realtime
def test_fifty_killed_workers_cut_nobody_elses_connection_and_refuse_none(tmp_path: Path) -> None:
    backoff = {"first_s": 0.01, "max_s": 0.05}
    with serving(tmp_path, workers=3, backoff=backoff) as served:
        wait_until(lambda: len(served.events("worker_ready")) == 3)
        refused: list[Exception] = []
        num_taken = 0
        stop = threading.Event()
        pauses_s: list[float] = []

        def keep_coming() -> None:
            """New clients, one after the other."""
            nonlocal num_taken
            while not stop.is_set():
                began_s = time.monotonic()
                try:
                    with socket.create_connection(("127.0.0.1", served.port), timeout=10) as one:
                        if one.recv(100):
                            num_taken += 1
                except ConnectionResetError:
                    pass  # the one that was killed had it
                except OSError as error:
                    refused.append(error)
                pauses_s.append(time.monotonic() - began_s)

        safe = served.connect()
        client = threading.Thread(target=keep_coming)
        client.start()
        try:
            for n in range(50):
                victims = {line["pid"] for line in served.events("worker_ready")}
                victims -= {safe.pid, *(line["pid"] for line in served.events("worker_died"))}
                wait_until(lambda v=victims: any(map(is_alive, v)))  # type: ignore[misc]
                os.kill(next(filter(is_alive, victims)), signal.SIGKILL)
                wait_until(lambda n=n: len(served.events("worker_died")) == n + 1)  # type: ignore[misc]
                assert safe.echoes(b"%d" % n)
                wait_until(lambda n=n: len(served.events("worker_ready")) == n + 4)  # type: ignore[misc]
        finally:
            stop.set()
            client.join()
        assert not refused
        assert num_taken > 100
        assert max(pauses_s) < 5
        assert {line["status"] for line in served.events("worker_died")} == {"SIGKILL"}
        # A number belongs to one at a time, and is given up before it is given on.
        holders: dict[int, int] = {}
        for line in served.told:
            if line["event"] == "worker_ready":
                assert line["worker"] not in holders
                holders[line["worker"]] = line["pid"]
            elif line["event"] == "forgotten":
                del holders[line["worker"]]
        assert set(holders) == {0, 1, 2}
        safe.close()


def test_connections_wait_for_the_next_worker_where_there_is_one_only(tmp_path: Path) -> None:
    with serving(tmp_path, workers=1) as served:
        first = served.connect()
        os.kill(first.pid, signal.SIGSTOP)
        # These are in the backlog when the worker dies.
        waiting = [socket.create_connection(("127.0.0.1", served.port)) for _ in range(20)]
        os.kill(first.pid, signal.SIGKILL)
        for one in waiting:
            one.settimeout(20)
            number, pid = map(int, one.recv(100).split())
            assert number == first.number
            assert pid != first.pid
            one.close()
        first.close()


@pytest.mark.realtime
def test_a_crash_loop_waits_longer_each_time(tmp_path: Path) -> None:
    with serving(tmp_path, "crash", workers=1) as served:
        wait_until(lambda: len(served.events("worker_died")) == 5)
        died = served.events("worker_died")
        assert [line["status"] for line in died] == [3] * 5
        assert died[0]["restart_s"] == 0
        for line, wait_s in zip(died[1:], (0.1, 0.2, 0.4, 0.8), strict=True):
            assert 0.74 * wait_s <= line["restart_s"] <= 1.26 * wait_s
        began_s = time.monotonic()
        served.process.send_signal(signal.SIGTERM)  # between two restarts
        assert served.end() == 0
        assert time.monotonic() - began_s < 2


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_it_ends_its_workers_and_then_itself(tmp_path: Path, number: signal.Signals) -> None:
    with serving(tmp_path, "slow", workers=2) as served:
        wait_until(lambda: len(served.events("worker_ready")) == 2)
        talk = served.connect()
        served.process.send_signal(number)
        wait_until(lambda: served.events("stopping"))
        assert talk.echoes(b"still here")
        # Who comes while they end is told at once, and does not wait for nobody.
        wait_until(lambda: is_refused(served.port) and not served.events("worker_ended"), 0.8)
        assert served.end() == 0
        assert [line["status"] for line in served.events("worker_ended")] == [0, 0]
        assert not served.events("worker_killed")
        assert not served.rest
        talk.close()


@pytest.mark.realtime
def test_workers_that_do_not_end_are_killed_in_time(tmp_path: Path) -> None:
    with serving(tmp_path, "stubborn", workers=2, shutdown_timeout_s=0.6) as served:
        wait_until(lambda: len(served.events("worker_ready")) == 2)
        began_s = time.monotonic()
        served.process.send_signal(signal.SIGTERM)
        assert served.end() == 0
        assert 0.5 < time.monotonic() - began_s < 3
        assert len(served.events("worker_killed")) == 2


def test_a_second_signal_ends_it_at_once(tmp_path: Path) -> None:
    with serving(tmp_path, "stubborn", workers=2, shutdown_timeout_s=60) as served:
        wait_until(lambda: len(served.events("worker_ready")) == 2)
        served.process.send_signal(signal.SIGTERM)
        wait_until(lambda: served.events("stopping"))
        served.process.send_signal(signal.SIGINT)
        assert served.end() == 0


def test_ctrl_c_in_a_terminal_reaches_the_workers_once(tmp_path: Path) -> None:
    """A terminal sends SIGINT to all of them; the workers leave it to the supervisor."""
    with serving(tmp_path, "slow", workers=2) as served:
        wait_until(lambda: len(served.events("worker_ready")) == 2)
        for line in served.events("worker_ready"):
            os.kill(line["pid"], signal.SIGINT)
        served.process.send_signal(signal.SIGINT)
        assert served.end() == 0
        assert [line["status"] for line in served.events("worker_ended")] == [0, 0]


def test_workers_do_not_outlive_their_supervisor(tmp_path: Path) -> None:
    with serving(tmp_path, workers=3) as served:
        wait_until(lambda: len(served.events("worker_ready")) == 3)
        pids = [line["pid"] for line in served.events("worker_ready")]
        served.process.kill()
        wait_until(lambda: not any(map(is_alive, pids)))


def test_workers_are_renewed_and_nobody_is_refused(tmp_path: Path) -> None:
    with serving(tmp_path, "slow", workers=2) as served:
        wait_until(lambda: len(served.events("worker_ready")) == 2)
        old = {line["pid"] for line in served.events("worker_ready")}
        talk = served.connect()
        served.process.send_signal(signal.SIGHUP)
        while len(served.events("worker_ended")) < 2:
            one = served.connect()
            assert one.echoes(b"hello")
            one.close()
        assert {line["pid"] for line in served.events("worker_ended")} == old
        new = {line["pid"] for line in served.events("worker_ready")} - old
        assert len(new) == 2
        one = served.connect()
        assert one.pid in new
        one.close()
        talk.close()
        # And once more: there is room for it.
        served.process.send_signal(signal.SIGHUP)
        wait_until(lambda: len(served.events("worker_ended")) == 4)
        assert max(line["worker"] for line in served.events("worker_ready")) <= 3
        assert not served.events("worker_died")


def test_new_workers_that_cannot_start_leave_the_old_ones_alone(tmp_path: Path) -> None:
    with serving(tmp_path, workers=2) as served:
        wait_until(lambda: len(served.events("worker_ready")) == 2)
        talk = served.connect()
        (tmp_path / "refuse").touch()
        served.process.send_signal(signal.SIGHUP)
        wait_until(lambda: served.events("renewal_failed"))
        assert served.events("renewal_failed")[0]["error"] == "there is nothing to serve"
        assert talk.echoes(b"still here")
        (tmp_path / "refuse").unlink()
        served.process.send_signal(signal.SIGHUP)
        wait_until(lambda: len(served.events("worker_ended")) == 2)
        assert not served.events("worker_died")
        talk.close()


def test_a_server_that_cannot_start_says_why_in_one_line(tmp_path: Path) -> None:
    with serving(tmp_path, "refuse", workers=2) as served:
        assert served.end() == 1
        assert served.rest == ["failed: there is nothing to serve\n"]
        assert not served.port


def test_what_was_counted_outlives_the_workers_that_counted(tmp_path: Path) -> None:
    (tmp_path / "metrics").mkdir()
    with serving(tmp_path, "count", workers=2, backoff={"first_s": 0.01}) as served:
        for n in range(1, 11):
            talk = served.connect()
            talk.send(b"figures")
            text = json.loads(talk.line())
            assert f'swings_requests_total{{code="200",route="/"}} {n}.0\n' in text
            plays = re.search(r"^swings_active_plays (\d)", text, re.MULTILINE)
            assert plays
            assert 1 <= int(plays[1]) <= 2
            os.kill(talk.pid, signal.SIGKILL)
            wait_until(lambda n=n: len(served.events("worker_died")) == n)  # type: ignore[misc]
            talk.close()
        assert len(list((tmp_path / "metrics").glob("counter_*.db"))) <= 4


def test_configs_that_make_no_sense_are_refused() -> None:
    for wrong in ({"workers": 0}, {"workers": 257}, {"shutdown_timeout_s": 0.0}):
        with pytest.raises(InvalidError, match=next(iter(wrong))):
            SupervisorConfig(**wrong)
