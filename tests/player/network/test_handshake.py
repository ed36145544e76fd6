"""A TLS failure reports its cause, and the player does not retry a refused host."""

from __future__ import annotations

import subprocess
from contextlib import closing
from pathlib import Path

import pytest

from player.network.fetch import BrokenError, Fetcher, FetchError
from tests.player.network.webhosts import script, web_host
from tests.support.commands import run, serving


def play(url: str, out: Path) -> subprocess.CompletedProcess[str]:
    return run("swings-play", url, "--capture", out, "--renderer", "cpu")


def test_a_certificate_that_is_not_trusted_or_of_another_host(
    folder: Path,
    certificate: tuple[Path, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with web_host(folder, certificate) as host:
        url = f"https://localhost:{host.server_port}/s"
        done = play(url, tmp_path / "out.mp4")
        assert done.returncode == 1
        assert done.stderr == (
            f"swings-play: {url}/manifest.json: its certificate is not trusted: self-signed "
            "certificate; if you trust it, name a file with its certificate in SSL_CERT_FILE\n"
        )
        assert host.num_connections == 1
        monkeypatch.setenv("SSL_CERT_FILE", str(certificate[0]))
        trusted = play(url, tmp_path / "out.mp4")
        assert (trusted.returncode, trusted.stderr) == (0, "")
        url = url.replace("localhost", "127.0.0.1")
        done = play(url, tmp_path / "out.mp4")
        assert done.returncode == 1
        assert done.stderr == (
            f"swings-play: {url}/manifest.json: its certificate is for another host, not for "
            "127.0.0.1\n"
        )


def test_tls_where_plain_http_is_spoken(folder: Path) -> None:
    with web_host(folder) as host, closing(Fetcher()) as fetcher:
        with pytest.raises(FetchError, match="does not speak TLS at this port; try http://") as it:
            fetcher.get(f"https://127.0.0.1:{host.server_port}/s", 1000)
        assert not isinstance(it.value, BrokenError)


def test_plain_http_where_tls_is_spoken(folder: Path, certificate: tuple[Path, Path]) -> None:
    """Servers of three kinds speak TLS; the last one answers with an alert, like OpenSSL."""
    cert, key = certificate
    with (
        closing(Fetcher()) as fetcher,
        serving(folder, "--tls-cert", cert, "--tls-key", key) as served,
        web_host(folder, certificate) as host,
        script(b"\x15\x03\x01\x00\x02\x02\x46") as alert,
    ):
        own = served.replace("https://", "http://")
        for url in (own, f"http://127.0.0.1:{host.server_port}/s", alert.url):
            with pytest.raises(BrokenError, match="if the server speaks TLS, use https://"):
                fetcher.get(url, 1000)


def test_a_handshake_that_is_cut_off_may_be_tried_again() -> None:
    with (
        script(b"") as host,
        closing(Fetcher()) as fetcher,
        pytest.raises(BrokenError, match="cannot connect: ") as broken,
    ):
        fetcher.get(host.url.replace("http://", "https://"), 1000)
    assert "not permitted" not in str(broken.value)
