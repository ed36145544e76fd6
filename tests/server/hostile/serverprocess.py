"""A swings-serve whose whole output is kept, and what HTTP says of its answers."""

from __future__ import annotations

import contextlib
import re
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.support.commands import command, environment
from tests.support.waiting import wait_until

SECRET = b"not for you: 4f1d8a"
"""What files hold that lie around the streams; no answer may have it."""


@dataclass(frozen=True)
class ServerProcess:
    """One that runs."""

    pid: int
    port: int
    log: Path
    """All that it writes, on stdout and stderr."""

    def log_lines(self) -> list[str]:
        return self.log.read_text(errors="replace").splitlines()

    def settled_log(self, least: int) -> list[str]:
        """The log once it has not grown for a moment; waits a little for `least` lines."""
        before = self.log_lines()
        for _ in range(40):
            time.sleep(0.01)
            now = self.log_lines()
            if len(now) >= least and now == before:
                break
            before = now
        return self.log_lines()


@contextlib.contextmanager
def server_process(
    root: Path, folder: Path, *options: object, before: Callable[[], None] | None = None
) -> Iterator[ServerProcess]:
    """A server of `root` that writes into `folder`; it is ended by its pid. before: runs in its
    process first."""
    log = folder / "serve.log"
    with open(log, "w") as out:
        process = subprocess.Popen(
            command("swings-serve", root, "--port", 0, *options),
            env={**environment(), "PYTHONUNBUFFERED": "1"},
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=subprocess.STDOUT,
            preexec_fn=before,
        )
    try:
        wait_until(lambda: "serving http" in log.read_text() or process.poll() is not None, 30)
        found = re.search(r"^serving https?://\S+:(\d+)$", log.read_text(), re.MULTILINE)
        assert found, log.read_text()
        time.sleep(0.1)  # the names of the streams
        yield ServerProcess(process.pid, int(found[1]), log)
    finally:
        process.terminate()
        try:
            process.wait(timeout=20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


@dataclass(frozen=True)
class Answer:
    """One response."""

    status: int
    headers: dict[str, str]
    """By lower-case name; of several lines the last."""
    body: bytes


def answers_of(data: bytes, heads: tuple[int, ...] = ()) -> tuple[list[Answer], bytes]:
    """The responses in `data`, and what is left that is not a whole one.

    heads: which of them answer HEAD, and so have no body.
    """
    answers: list[Answer] = []
    while data:
        head, found, rest = data.partition(b"\r\n\r\n")
        match = re.match(rb"HTTP/1\.[01] (\d{3})", head)
        if not found or match is None:
            break
        lines = head.decode("latin-1").split("\r\n")[1:]
        headers = {k.lower(): v.strip() for k, _, v in (line.partition(":") for line in lines)}
        status = int(match[1])
        if status in (204, 304) or status < 200 or len(answers) in heads:
            length = 0
        elif headers.get("transfer-encoding") == "chunked":
            end = rest.find(b"0\r\n\r\n")
            length = len(rest) if end < 0 else end + 5
        else:
            length = int(headers.get("content-length", len(rest)))
        if len(rest) < length:
            break
        answers.append(Answer(status, headers, rest[:length]))
        data = rest[length:]
    return answers, data


def exchange(
    port: int, sent: bytes, shut: bool = False, quiet_s: float = 0.5, limit_s: float = 10.0
) -> tuple[bytes, bool]:
    """What the server sends for `sent`, and whether it closed the connection by itself.

    Ends when the server closes, or has said something and then nothing for `quiet_s`, or nothing
    within four times that. shut: close our half after sending.
    """
    received = bytearray()
    began_s = time.monotonic()
    with socket.create_connection(("127.0.0.1", port), timeout=5) as sock:
        try:
            sock.sendall(sent)
            if shut:
                sock.shutdown(socket.SHUT_WR)
        except OSError:
            pass  # it has closed already; what it said may still be there
        while time.monotonic() - began_s < limit_s:
            sock.settimeout(quiet_s if received else 4 * quiet_s)
            try:
                piece = sock.recv(1 << 16)
            except TimeoutError:
                return bytes(received), False
            except ConnectionError:
                return bytes(received), True
            if not piece:
                return bytes(received), True
            received += piece
    return bytes(received), False


def get(port: int, path: str, timeout_s: float = 10.0) -> Answer:
    """A plain GET over a connection of its own."""
    request = f"GET {path} HTTP/1.1\r\nHost: h\r\nConnection: close\r\n\r\n".encode()
    data, _ = exchange(port, request, quiet_s=timeout_s / 4, limit_s=timeout_s)
    answers, rest = answers_of(data)
    assert len(answers) == 1, data[:300]
    assert not rest
    return answers[0]
