"""TLS that fails says what is wrong, and a host that it refuses is not asked again."""

from __future__ import annotations

import socket
import ssl
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from player.network.fetch import BrokenError, Fetcher, FetchError
from tests.support.commands import command, environment, serving
from tests.support.hosted_streams import static_host, write_stream
from tests.support.server.certificates import make_certificate


class Silent(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        pass


class Tls(ThreadingHTTPServer):
    """Counts its connections."""

    def __init__(self, folder: Path, cert: Path, key: Path) -> None:
        super().__init__(("127.0.0.1", 0), partial(Silent, directory=str(folder)))
        self.num_connections = 0
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(cert, key)
        self.socket = context.wrap_socket(
            self.socket, server_side=True, do_handshake_on_connect=False
        )

    def get_request(self) -> tuple[socket.socket, object]:
        self.num_connections += 1
        return super().get_request()

    def handle_error(self, request: object, client_address: object) -> None:
        pass


@contextmanager
def tls_host(folder: Path, cert: Path, key: Path) -> Iterator[Tls]:
    server = Tls(folder, cert, key)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return make_certificate(tmp_path_factory.mktemp("tls"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("host")
    write_stream(path / "s", 3)
    return path


def play(url: str, out: Path, trusted: Path | None) -> subprocess.CompletedProcess[str]:
    more = {} if trusted is None else {"SSL_CERT_FILE": str(trusted)}
    return subprocess.run(
        command("swings-play", url, "--capture", out, "--renderer", "cpu"),
        env=environment() | more,
        capture_output=True,
        text=True,
        timeout=120,
    )


def test_a_certificate_of_nobody_known(
    folder: Path, certificate: tuple[Path, Path], tmp_path: Path
) -> None:
    with tls_host(folder, *certificate) as host:
        url = f"https://localhost:{host.server_port}/s"
        began_s = time.monotonic()
        done = play(url, tmp_path / "out.mp4", None)
        assert done.returncode == 1
        assert done.stderr == (
            f"swings-play: {url}/manifest.json: its certificate is not trusted: self-signed "
            "certificate; if you trust it, name a file with its certificate in SSL_CERT_FILE\n"
        )
        assert host.num_connections == 1
        assert time.monotonic() - began_s < 30
        trusted = play(url, tmp_path / "out.mp4", certificate[0])
        assert (trusted.returncode, trusted.stderr) == (0, "")


def test_a_certificate_of_another_host(
    folder: Path, certificate: tuple[Path, Path], tmp_path: Path
) -> None:
    with tls_host(folder, *certificate) as host:
        url = f"https://127.0.0.1:{host.server_port}/s"
        done = play(url, tmp_path / "out.mp4", certificate[0])
        assert done.returncode == 1
        assert done.stderr == (
            f"swings-play: {url}/manifest.json: its certificate is for another host, not for "
            "127.0.0.1\n"
        )


def test_it_is_final_while_a_connection_that_breaks_is_not(
    folder: Path, certificate: tuple[Path, Path]
) -> None:
    with tls_host(folder, *certificate) as host, closing(Fetcher()) as fetcher:
        with pytest.raises(FetchError, match="self-signed") as refused:
            fetcher.get(f"https://localhost:{host.server_port}/s", 1000)
        assert not isinstance(refused.value, BrokenError)
    with closing(socket.create_server(("127.0.0.1", 0))) as listener:
        port = listener.getsockname()[1]
    with closing(Fetcher()) as fetcher, pytest.raises(BrokenError, match="Connection refused"):
        fetcher.get(f"https://localhost:{port}/s", 1000)


def test_tls_where_plain_http_is_spoken(folder: Path) -> None:
    with static_host(folder) as url, closing(Fetcher()) as fetcher:
        with pytest.raises(FetchError, match="does not speak TLS at this port; try http://") as it:
            fetcher.get(url.replace("http://", "https://"), 1000)
        assert not isinstance(it.value, BrokenError)


def test_plain_http_where_tls_is_spoken(folder: Path, certificate: tuple[Path, Path]) -> None:
    cert, key = certificate
    with closing(Fetcher()) as fetcher:
        with (
            serving(folder, "--tls-cert", cert, "--tls-key", key) as url,
            pytest.raises(FetchError, match="without an answer; if it speaks TLS, use https://"),
        ):
            fetcher.get(url.replace("https://", "http://"), 1000)
        with (
            tls_host(folder, *certificate) as host,
            pytest.raises(FetchError, match=r"TLS.* (try|use) https://"),
        ):
            fetcher.get(f"http://127.0.0.1:{host.server_port}/s", 1000)


def test_an_alert_of_tls_in_place_of_an_answer(folder: Path) -> None:
    """As OpenSSL's own servers send it."""
    with (
        closing(socket.create_server(("127.0.0.1", 0))) as listener,
        closing(Fetcher()) as fetcher,
    ):

        def alert() -> None:
            connection, _ = listener.accept()
            with connection:
                connection.recv(1000)
                connection.sendall(b"\x15\x03\x01\x00\x02\x02\x46")

        thread = threading.Thread(target=alert)
        thread.start()
        with pytest.raises(FetchError, match="the server speaks TLS at this port; try https://"):
            fetcher.get(f"http://127.0.0.1:{listener.getsockname()[1]}/s", 1000)
        thread.join()


def test_a_handshake_that_is_cut_off_may_be_tried_again() -> None:
    listener = socket.create_server(("127.0.0.1", 0))

    def hang_up() -> None:
        connection, _ = listener.accept()
        connection.recv(100)
        connection.close()

    thread = threading.Thread(target=hang_up)
    thread.start()
    with closing(listener), closing(Fetcher()) as fetcher, pytest.raises(BrokenError) as broken:
        fetcher.get(f"https://localhost:{listener.getsockname()[1]}/s", 1000)
    thread.join()
    assert "not permitted" not in str(broken.value)
