"""The emulated link in real time: it carries what it says, and a server sees it like a real one."""

from __future__ import annotations

import contextlib
import select
import socket
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from player.link.linkprocess import LinkProcess
from player.link.relay import read_link
from server.http.connection import unacked_bytes
from tests.player.link.pouring import drain, pouring

pytestmark = pytest.mark.realtime


def test_connections_share_the_link() -> None:
    took_s = []
    for _ in range(3):
        with (
            pouring(150_000) as server,
            LinkProcess(read_link("8M"), "127.0.0.1", server.port) as relay,
            ThreadPoolExecutor(4) as pool,
        ):
            began_s = time.monotonic()
            list(pool.map(drain, [relay.address] * 4))
            took_s.append(time.monotonic() - began_s)
    assert 0.57 < min(took_s) < 0.75


@pytest.mark.parametrize("megabits", [3, 12, 40, 100])
def test_nothing_is_acknowledged_before_it_has_passed(megabits: int) -> None:
    link = read_link(f"{megabits}M,50ms")
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        with (
            LinkProcess(link, "127.0.0.1", port) as relay,
            socket.create_connection(relay.address, timeout=30) as player,
        ):
            connection, _ = listener.accept()
            with connection:
                player.setblocking(False)
                connection.setblocking(False)
                written = acked = 0
                began_s = relay.began_s
                assert began_s is not None
                while time.monotonic() < began_s + 0.5:
                    try:
                        written += connection.send(bytes(1 << 16))
                        player.recv(1 << 20)
                    except BlockingIOError:
                        select.select([player], [], [], 0.001)
                    acked = written - unacked_bytes(connection)
                    passed_bytes = link.capacity_bytes(0, time.monotonic() - began_s - 0.05)
                    # Bytes in the relay's kernel are acknowledged, too; they must be few.
                    assert acked <= passed_bytes + 0.02 * megabits * 1e6 / 8
                assert acked > 0


def test_small_answers_on_another_connection_take_no_time_of_the_link() -> None:
    num_bytes, latency_s, rate_bps = 120_000, 0.1, 1.6e6
    link = read_link("1600k,100ms")
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        with (
            LinkProcess(link, "127.0.0.1", port) as relay,
            socket.create_connection(relay.address, timeout=30) as player,
            listener.accept()[0] as sender,
            socket.create_connection(relay.address, timeout=30) as asking,
            listener.accept()[0] as answering,
        ):
            sending = threading.Thread(target=sender.sendall, args=(bytes(num_bytes),))
            began_s = time.monotonic()
            sending.start()
            came = answers = 0
            player.settimeout(0.01)
            while came < num_bytes:
                if time.monotonic() > began_s + 0.05 * answers:
                    answering.sendall(b"ok")
                    answers += 1
                with contextlib.suppress(TimeoutError):
                    came += len(player.recv(1 << 16))
            took_s = time.monotonic() - began_s
            assert asking.recv(100).startswith(b"ok")
            sending.join()
    assert answers >= 10
    # Each extra round trip would have cost a latency.
    assert took_s == pytest.approx(latency_s + 8 * num_bytes / rate_bps, abs=0.15)
