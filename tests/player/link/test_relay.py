"""The relay in its process, on real sockets; test_honest_link.py measures its times."""

from __future__ import annotations

import contextlib
import socket
from concurrent.futures import ThreadPoolExecutor

from player.link.linkprocess import LinkProcess
from player.link.linktext import read_link
from tests.player.link.pouring import drain, pouring
from tests.support.waiting import BOUND_S


def test_all_bytes_of_all_connections_pass_and_are_counted() -> None:
    with (
        pouring(150_000) as server,
        LinkProcess(read_link("1G"), "127.0.0.1", server.port) as relay,
        ThreadPoolExecutor(4) as pool,
    ):
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
    with socket.create_server(("127.0.0.1", 0)) as unused:
        port = unused.getsockname()[1]
    with LinkProcess(read_link("8M"), "127.0.0.1", port) as relay:
        with socket.create_connection(relay.address, timeout=BOUND_S) as connection:
            connection.sendall(b"GET / HTTP/1.1\r\nHost: x\r\n\r\n")
            answer = b""
            while piece := connection.recv(65536):
                answer += piece
        assert answer.startswith(b"HTTP/1.1 502")
        assert b"cannot connect" in answer


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
