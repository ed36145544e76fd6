"""The kernel's data on a connection: from the bytes of its struct, and on real sockets."""

from __future__ import annotations

import socket
import struct
import sys
from collections.abc import Iterator

import pytest

from server.http.connection import (
    SO_NWRITE,
    TCP_INFO_BYTES,
    TcpInfo,
    parse_tcp_info,
    read_tcp_info,
    unacked_bytes,
)
from tests.support.waiting import wait_until

linux_only = pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells this")


def packed(min_rtt_us: int, bytes_per_s: int) -> bytes:
    data = bytearray(range(1, TCP_INFO_BYTES + 1))
    struct.pack_into("=I", data, 148, min_rtt_us)
    struct.pack_into("=Q", data, 160, bytes_per_s)
    return bytes(data)


def test_the_figures_stand_where_linux_puts_them() -> None:
    assert parse_tcp_info(packed(12_500, 250_000)) == TcpInfo(0.0125, 2e6)
    assert parse_tcp_info(packed(0xFFFFFFFF, 0)) == TcpInfo(None, None)


@pytest.mark.parametrize("length", [0, 147, 151, 152, 167, 168, 300])
def test_an_older_kernel_tells_less(length: int) -> None:
    whole = packed(8, 9) + bytes(132)
    info = parse_tcp_info(whole[:length])
    assert (info.min_rtt_s is not None) == (length >= 152)
    assert (info.delivery_rate_bps is not None) == (length >= 168)


@pytest.fixture
def pair() -> Iterator[tuple[socket.socket, socket.socket]]:
    """(writing, reading) ends of a connection whose reader has a small buffer."""
    listener = socket.create_server(("127.0.0.1", 0))
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 16 * 1024)
    writer = socket.create_connection(listener.getsockname())
    reader, _ = listener.accept()
    listener.close()
    writer.setblocking(False)
    with writer, reader:
        yield writer, reader


@linux_only
def test_what_is_held_and_what_is_acknowledged_is_all_that_was_written(
    pair: tuple[socket.socket, socket.socket],
) -> None:
    """So a play needs only the ioctl, a single number, and the two never drift apart."""
    writer, reader = pair

    def acked_bytes() -> int:
        """tcpi_bytes_acked."""
        data = writer.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, TCP_INFO_BYTES)
        if len(data) < 128:
            pytest.skip("this kernel does not count acknowledged bytes")
        count: int = struct.unpack_from("=Q", data, 120)[0]
        return count

    before, written, read = acked_bytes(), 0, 0
    for _ in range(4):
        while True:
            try:
                written += writer.send(bytes(100_000))
            except BlockingIOError:
                break
        total = before + written
        wait_until(lambda n=total: acked_bytes() == n - unacked_bytes(writer))
        assert unacked_bytes(writer) > 0
        while read < written:
            read += len(reader.recv(1 << 20))
        wait_until(lambda: unacked_bytes(writer) == 0)
    info = read_tcp_info(writer)
    assert info is not None
    assert info.min_rtt_s is None or 0 <= info.min_rtt_s < 10


class MacSocket:
    """Answers the only query like macOS."""

    def getsockopt(self, level: int, option: int) -> int:
        assert (level, option) == (socket.SOL_SOCKET, SO_NWRITE)
        return 4321


@linux_only
def test_each_platform_has_its_own_way_and_what_it_lacks_is_nothing_held(
    pair: tuple[socket.socket, socket.socket],
) -> None:
    assert unacked_bytes(MacSocket(), "darwin") == 4321
    assert unacked_bytes(MacSocket(), "win32") == 0
    assert unacked_bytes(pair[0], "darwin") == 0
    closed = socket.socket()
    closed.close()
    assert read_tcp_info(closed) is None
    assert unacked_bytes(closed) == unacked_bytes(closed, "darwin") == 0
