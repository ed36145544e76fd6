"""A swings-serve whose whole output is kept, and a parser of its responses."""

from __future__ import annotations

import contextlib
import http.client
import itertools
import json
import re
import socket
import subprocess
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from prometheus_client.parser import text_string_to_metric_families

from tests.support.commands import command, environment
from tests.support.server.running_server import Answer
from tests.support.waiting import BOUND_S, wait_until

LAST = "the-last-request"
"""A stream that does not exist, requested at the end of an exchange: the answer shows that the
connection was kept."""
PATIENT = {"--shed-from": 2, "--refuse-from": 3, "--keepalive-timeout-s": 600}
"""Options with which a slow machine is no load, and no client is too slow."""
_MARKS = itertools.count()
SECRET = b"not for you: 4f1d8a"
"""Content of the files around the streams; no response may contain it."""


@dataclass(frozen=True)
class ServerProcess:
    """A running server."""

    process: subprocess.Popen[bytes]
    port: int
    log: Path
    """File of its stdout and stderr."""

    @property
    def pid(self) -> int:
        return self.process.pid

    def log_lines(self) -> list[str]:
        return self.log.read_text(errors="replace").splitlines()

    def events(self, *kinds: str) -> list[dict[str, Any]]:
        """The events of a JSON log. kinds: names of the wanted events; none for all."""
        lines = [json.loads(line) for line in self.log_lines() if line.startswith("{")]
        return [line for line in lines if not kinds or line["event"] in kinds]

    def settled_log(self) -> list[str]:
        """The log with all requests that have ended by now; the server logs its requests."""
        mark = f"/marked-{next(_MARKS)}"
        ask(self.port, mark)
        wait_until(lambda: any(mark in line for line in self.log_lines()))
        return [line for line in self.log_lines() if "/marked-" not in line]


def server_process(
    root: Path, folder: Path, *options: object, before: Callable[[], None] | None = None
) -> contextlib.AbstractContextManager[ServerProcess]:
    """A swings-serve of `root` that writes into `folder`. before: runs in its process first."""
    patient = [(name, value) for name, value in PATIENT.items() if name not in options]
    options = *options, *itertools.chain(*patient)
    words = command("swings-serve", root, "--port", 0, *options)
    return logged_process(words, folder, preexec_fn=before)


@contextlib.contextmanager
def logged_process(words: Sequence[str], folder: Path, **options: Any) -> Iterator[ServerProcess]:
    """A server that prints its URL as swings-serve does; its output goes to a file in `folder`."""
    log = folder / "serve.log"
    with open(log, "w") as out:
        process = subprocess.Popen(
            words,
            env={**environment(), "PYTHONUNBUFFERED": "1"},
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=subprocess.STDOUT,
            **options,
        )
    try:
        wait_until(lambda: "serving http" in log.read_text() or process.poll() is not None)
        found = re.search(r"^serving https?://\S+:(\d+)$", log.read_text(), re.MULTILINE)
        assert found, log.read_text()
        yield ServerProcess(process, int(found[1]), log)
    finally:
        process.terminate()
        try:
            process.wait(timeout=BOUND_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def answers_of(data: bytes) -> tuple[list[Answer], bytes]:
    """The responses in `data`, none of them to a HEAD, with the last line of each header by its
    lower-case name; and what is left that is not a whole response."""
    answers: list[Answer] = []
    while data:
        head, found, rest = data.partition(b"\r\n\r\n")
        match = re.match(rb"HTTP/1\.[01] (\d{3})", head)
        if not found or match is None:
            break
        lines = head.decode("latin-1").split("\r\n")[1:]
        headers = {k.lower(): v.strip() for k, _, v in (line.partition(":") for line in lines)}
        status = int(match[1])
        if status in (204, 304) or status < 200:
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


def exchange(port: int, sent: bytes, shut: bool = False) -> tuple[bytes, bool]:
    """What the server sends for `sent`, and whether it closed the connection by itself, or answers
    another request after that. shut: close our half after sending."""
    last = f"GET /v1/streams/{LAST}/index.bin HTTP/1.1\r\nHost: h\r\n\r\n".encode()
    if shut or b"connection: close" in sent.lower():
        last = b""
    received = bytearray()
    with socket.create_connection(("127.0.0.1", port), timeout=BOUND_S) as sock:
        with contextlib.suppress(OSError):  # it has closed already; what it said may still be there
            sock.sendall(sent + last)
            if shut:
                sock.shutdown(socket.SHUT_WR)
        with contextlib.suppress(ConnectionError):
            while piece := sock.recv(1 << 16):
                received += piece
                answer = received.rfind(b"HTTP/1.1 404 ")
                if answer >= 0 and LAST.encode() in received[answer:]:
                    return bytes(received[:answer]), False
    return bytes(received), True


def ask(
    port: int,
    path: str,
    headers: Mapping[str, str] | None = None,
    method: str = "GET",
    body: bytes | None = None,
) -> Answer:
    """The answer to a request over a connection of its own."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=BOUND_S)
    with contextlib.closing(connection):
        connection.request(method, path, body, {"Connection": "close", **(headers or {})})
        response = connection.getresponse()
        fields = {name.lower(): value for name, value in response.getheaders()}
        return Answer(response.status, fields, response.read())


def samples(text: str) -> dict[tuple[str, ...], float]:
    """The samples in the text of /metrics, by their name and the sorted values of their labels."""
    found = [one for family in text_string_to_metric_families(text) for one in family.samples]
    return {(one.name, *sorted(one.labels.values())): one.value for one in found}


def figures(port: int) -> dict[tuple[str, ...], float]:
    return samples(ask(port, "/metrics").body.decode())


class Comers:
    """Clients that connect one after the other, in a thread, until the block ends; at least one."""

    def __init__(self, come: Callable[[], None]) -> None:
        """come: what each client does."""
        self._come = come
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self.troubles: list[str] = []

    def __enter__(self) -> Comers:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        while True:
            try:
                self._come()
            except Exception as error:
                self.troubles.append(repr(error))
            if self._stop.is_set():
                return
