"""Clients of /play as a process of its own: `python playload.py CONFIG_JSON` (a LoadConfig).

It reads all data as soon as it arrives, parses only the frames of the chunked body and the head of
each record, and records the arrival times of packets; `playfigures` evaluates them. All data of one
read have the same time, from the clock that all processes of the machine share.
"""

from __future__ import annotations

import json
import os
import resource
import select
import socket
import struct
import sys
import time
from array import array
from dataclasses import asdict, dataclass
from pathlib import Path

import msgpack
import numpy as np

from bench.serve.processes import cpu_s, machine_cpu_s, rss_bytes
from codec.stream.playrecord import PACKETS_KEY

READ_BYTES = 1 << 20
LENGTH = struct.Struct("<I")


@dataclass(frozen=True, slots=True)
class LoadConfig:
    """The request, and the number and times of its clients."""

    port: int
    path: str
    clients: int
    arrive_s: float
    """Seconds over which the clients arrive, evenly."""
    settle_s: float
    """Seconds from the last arrival until the server's CPU time and pacing are measured."""
    seconds: float
    """Seconds from the first arrival to the end."""
    server_pid: int
    out: str
    """File for the records, as numpy's npz."""


class Body:
    """Removes the chunked coding from a body, piece by piece."""

    def __init__(self, chunked: bool) -> None:
        self._chunked = chunked
        self._left = 0  # bytes of the chunk that are still to come, with its line end
        self._line = b""

    def feed(self, data: memoryview, into: bytearray) -> None:
        """Appends the body bytes of `data` to `into`."""
        if not self._chunked:
            into += data
            return
        at = 0
        while at < len(data):
            if self._left:
                taken = min(self._left, len(data) - at)
                into += data[at : at + max(0, min(taken, self._left - 2))]
                self._left -= taken
                at += taken
                continue
            self._line += bytes(data[at : at + 20])
            size, found, _ = self._line.partition(b"\r\n")
            if not found:
                at += 20
                continue
            at += len(size) + 2 - (len(self._line) - len(bytes(data[at : at + 20])))
            self._line = b""
            self._left = int(size.partition(b";")[0], 16) + 2


@dataclass(slots=True)
class Client:
    """State of one client."""

    number: int
    sock: socket.socket
    asked_s: float = np.nan
    head_s: float = np.nan
    record_s: float = np.nan
    status: int = 0
    body: Body | None = None
    head: bytes = b""
    pending: bytearray | None = None
    over: bool = False


class Load:
    """All clients, and the packets that they received."""

    def __init__(self, config: LoadConfig) -> None:
        self._config = config
        self._epoll = select.epoll()
        self._buffer = bytearray(READ_BYTES)
        self._clients: dict[int, Client] = {}
        self.all: list[Client] = []
        self.who, self.birth = array("i"), array("i")
        self.first, self.layers = array("b"), array("b")
        self.at_s = array("d")
        self.longest_s = 0.0
        """Longest pass over all ready sockets; recorded times may be late by as much."""
        self._request = (
            f"GET {config.path} HTTP/1.1\r\nHost: 127.0.0.1:{config.port}\r\n\r\n".encode()
        )

    def _arrive(self) -> None:
        sock = socket.socket()
        sock.setblocking(False)
        sock.connect_ex(("127.0.0.1", self._config.port))
        client = Client(len(self.all), sock)
        self.all.append(client)
        self._clients[sock.fileno()] = client
        self._epoll.register(sock, select.EPOLLOUT)

    def _leave(self, client: Client) -> None:
        client.over = True
        del self._clients[client.sock.fileno()]
        client.sock.close()

    def _ready(self, client: Client, event: int) -> None:
        if np.isnan(client.asked_s):
            try:
                client.sock.send(self._request)
            except OSError:
                self._leave(client)
                return
            client.asked_s = time.monotonic()
            self._epoll.modify(client.sock, select.EPOLLIN)
            return
        try:
            count = client.sock.recv_into(self._buffer)
        except BlockingIOError:
            return
        except OSError:
            count = 0
        now_s = time.monotonic()
        if not count:
            self._leave(client)
            return
        with memoryview(self._buffer) as view:
            data = view[:count]
            if client.body is None:
                data = self._head(client, bytes(data), now_s)
            if client.body is not None and client.pending is not None:
                client.body.feed(data, client.pending)
                self._records(client, client.pending, now_s)

    def _head(self, client: Client, data: bytes, now_s: float) -> memoryview:
        """Reads the head of the response; returns the data after it."""
        client.head_s = now_s if np.isnan(client.head_s) else client.head_s
        client.head += data
        head, found, rest = client.head.partition(b"\r\n\r\n")
        if found:
            client.status = int(head.split()[1])
            client.body = Body(b"transfer-encoding: chunked" in head.lower())
            client.pending = bytearray()
        return memoryview(rest)

    def _records(self, client: Client, pending: bytearray, now_s: float) -> None:
        if client.status != 200:
            return
        at = 0
        while len(pending) - at >= 4:
            end = at + 4 + LENGTH.unpack_from(pending, at)[0]
            if end > len(pending):
                break
            client.record_s = now_s if np.isnan(client.record_s) else client.record_s
            with memoryview(pending) as view, view[at + 4 : end] as record:
                value = msgpack.unpackb(record)
            if value["kind"] in ("slice", "keyframe"):
                self.who.append(client.number)
                self.birth.append(value["birth"] if value["kind"] == "slice" else value["frame"])
                self.first.append(value.get("first", 0))
                self.layers.append(len(value[PACKETS_KEY]))
                self.at_s.append(now_s)
            at = end
        del pending[:at]

    def run(self) -> dict[str, object]:
        """Runs the clients until the time is over; returns the figures of the processes."""
        config = self._config
        began_s = time.monotonic()
        steady_s = began_s + config.arrive_s + config.settle_s
        before: tuple[float, float, float, float] | None = None
        rss = 0
        looked_s = began_s
        while (now_s := time.monotonic()) < began_s + config.seconds:
            due = config.clients
            if config.arrive_s:
                due = min(due, 1 + int((now_s - began_s) / config.arrive_s * config.clients))
            for _ in range(due - len(self.all)):
                self._arrive()
            if before is None and now_s >= steady_s:
                server_s = cpu_s(config.server_pid)
                before = (now_s, server_s, own_cpu_s(), machine_cpu_s())
            if now_s >= looked_s + 1:
                rss, looked_s = max(rss, rss_bytes(config.server_pid)), now_s
            events = self._epoll.poll(0.005 if len(self.all) < config.clients else 0.05)
            woke_s = time.monotonic()
            for number, event in events:
                if number in self._clients:
                    self._ready(self._clients[number], event)
            self.longest_s = max(self.longest_s, time.monotonic() - woke_s)
        ended_s = time.monotonic()
        assert before is not None, "the plays end before they are steady"
        steady = ended_s - before[0]
        server_s, load_s = cpu_s(config.server_pid) - before[1], own_cpu_s() - before[2]
        others_s = machine_cpu_s() - before[3] - server_s - load_s
        return {
            "began_s": began_s,
            "steady_s": before[0],
            "ended_s": ended_s,
            "realtime_offset_s": time.time() - time.monotonic(),
            "server_share": server_s / steady,
            "load_share": load_s / steady,
            "others_share": max(0.0, others_s) / steady,
            "load_longest_s": self.longest_s,
            "server_rss_bytes": rss,
        }

    def save(self, known: dict[str, object]) -> None:
        """Writes everything to the file of the config."""
        np.savez(
            self._config.out,
            who=np.frombuffer(self.who, np.int32),
            birth=np.frombuffer(self.birth, np.int32),
            first=np.frombuffer(self.first, np.int8),
            layers=np.frombuffer(self.layers, np.int8),
            at_s=np.frombuffer(self.at_s, np.float64),
            asked_s=np.array([client.asked_s for client in self.all]),
            head_s=np.array([client.head_s for client in self.all]),
            record_s=np.array([client.record_s for client in self.all]),
            status=np.array([client.status for client in self.all]),
            over=np.array([client.over for client in self.all]),
            known=np.array(json.dumps(known)),
        )


def own_cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def load_command(config: LoadConfig, core: int) -> list[str]:
    """The command that runs this file with `config`."""
    words = ["taskset", "-c", str(core), sys.executable, str(Path(__file__))]
    return [*words, json.dumps(asdict(config))]


def main() -> None:
    config = LoadConfig(**json.loads(sys.argv[1]))
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft < config.clients + 64:
        resource.setrlimit(resource.RLIMIT_NOFILE, (min(hard, config.clients + 64), hard))
    load = Load(config)
    load.save(load.run())
    os._exit(0)  # no need to close hundreds of sockets


if __name__ == "__main__":
    main()
