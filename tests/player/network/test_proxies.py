"""HTTP_PROXY, HTTPS_PROXY and NO_PROXY, with a real proxy between a player and its host."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from player.network.fetch import Fetcher
from player.network.http import _tls, proxy_for
from player.network.target import BrokenError, FetchError, Target
from tests.player.network.webhosts import (
    LOGIN,
    LOGIN_HEADER,
    PROXY_LOGIN,
    PROXY_LOGIN_HEADER,
    SECRETS,
    WebHost,
    web_host,
)
from tests.support.ports import kept_port


@pytest.fixture(autouse=True)
def environment(monkeypatch: pytest.MonkeyPatch) -> Iterator[pytest.MonkeyPatch]:
    """The environment without any proxy."""
    for name in ("http", "https", "all", "no"):
        monkeypatch.delenv(f"{name}_proxy", raising=False)
        monkeypatch.delenv(f"{name}_proxy".upper(), raising=False)
    yield monkeypatch
    _tls.cache_clear()


@contextmanager
def proxy(environment: pytest.MonkeyPatch, variable: str, refusal: int = 0) -> Iterator[WebHost]:
    """A proxy, named in the environment variable `variable`."""
    with web_host(Path("/nowhere")) as host:
        host.refusal = refusal
        environment.setenv(variable, f"http://{PROXY_LOGIN}@127.0.0.1:{host.server_port}")
        yield host


@pytest.mark.parametrize("variable", ["http_proxy", "HTTP_PROXY", "ALL_PROXY"])
def test_plain_requests_name_the_whole_url(
    folder: Path, environment: pytest.MonkeyPatch, variable: str
) -> None:
    with (
        web_host(folder, login=LOGIN_HEADER) as host,
        proxy(environment, variable) as between,
        closing(Fetcher()) as fetcher,
    ):
        url = f"http://127.0.0.1:{host.server_port}/s/manifest.json"
        direct = (folder / "s/manifest.json").read_bytes()
        for _ in range(2):
            assert fetcher.get(url.replace("://", f"://{LOGIN}@"), 1 << 20).body == direct
    assert between.requests == [("GET", url)] * 2
    assert between.num_connections == 1
    assert between.proxy_logins == {PROXY_LOGIN_HEADER}
    assert host.logins == [LOGIN_HEADER] * 2


def test_encrypted_requests_go_through_a_tunnel(
    folder: Path, certificate: tuple[Path, Path], environment: pytest.MonkeyPatch
) -> None:
    environment.setenv("SSL_CERT_FILE", str(certificate[0]))
    with (
        proxy(environment, "HTTPS_PROXY") as between,
        web_host(folder, certificate) as host,
        closing(Fetcher()) as fetcher,
    ):
        environment.setenv("HTTPS_PROXY", f"{PROXY_LOGIN}@127.0.0.1:{between.server_port}")
        url = f"https://{LOGIN}@localhost:{host.server_port}/s/manifest.json"
        assert fetcher.get(url, 1 << 20).body == (folder / "s/manifest.json").read_bytes()
        assert between.requests == [("CONNECT", f"localhost:{host.server_port}")]
        assert between.proxy_logins == {PROXY_LOGIN_HEADER}
        assert between.tunnelled
        assert not any(text.encode() in between.tunnelled for text in (*SECRETS, "manifest"))
        with pytest.raises(FetchError, match="certificate is for another host") as refused:
            fetcher.get(url.replace("localhost", "127.0.0.1"), 1 << 20)
        assert not isinstance(refused.value, BrokenError)


@pytest.mark.parametrize(
    ("scheme", "status", "may_pass"),
    [
        ("http", 407, False),
        ("https", 407, False),
        ("https", 403, False),
        ("https", 502, True),
        ("https", 429, True),
    ],
)
def test_a_proxy_that_refuses_is_named(
    environment: pytest.MonkeyPatch, scheme: str, status: int, may_pass: bool
) -> None:
    variable, url = f"{scheme}_proxy".upper(), f"{scheme}://[::1]:9/s"
    with (
        proxy(environment, variable, status) as between,
        closing(Fetcher()) as fetcher,
        pytest.raises(FetchError) as refused,
    ):
        fetcher.get(url, 10)
    hint = f"; put name and password into {variable}: http://name:password@host:port"
    assert str(refused.value) == (
        f"{url}: the proxy http://127.0.0.1:{between.server_port} "
        f"answered HTTP {status}{hint if status == 407 else ''}"
    )
    assert isinstance(refused.value, BrokenError) == may_pass
    assert between.requests == [("GET", url) if scheme == "http" else ("CONNECT", "[::1]:9")]


def test_a_proxy_that_is_none_or_does_not_listen_is_named(environment: pytest.MonkeyPatch) -> None:
    port = kept_port()
    away = f"cannot connect to the proxy http://127.0.0.1:{port}: Connection refused"
    for value, message in (
        (f"http://paula:geheim@127.0.0.1:{port}", away),
        *((no, "HTTP_PROXY is") for no in ("socks5://paula:geheim@a:1", "https://a", "geheim@:a")),
    ):
        environment.setenv("HTTP_PROXY", value)
        with closing(Fetcher()) as fetcher, pytest.raises(FetchError, match=message) as error:
            fetcher.get("http://localhost:9/s", 10)
        assert isinstance(error.value, BrokenError) == (message == away)
        assert "geheim" not in str(error.value)


@pytest.mark.parametrize(
    ("no_proxy", "url", "is_proxied"),
    [
        ("", "http://localhost/", True),
        ("*", "http://a.example/", False),
        (".example", "http://a.example/", False),
        ("ample", "http://a.example/", True),
        ("A.EXAMPLE:80", "http://a.example/", False),
        ("a.example:81", "http://a.example/", True),
        ("::1", "http://[::1]:8000/", False),
        ("[::1]:8000", "http://[::1]:8000/", False),
        ("", "https://a.example/", False),
    ],
)
def test_what_no_proxy_excludes(
    environment: pytest.MonkeyPatch, no_proxy: str, url: str, is_proxied: bool
) -> None:
    environment.setenv("HTTP_PROXY", "http://proxy:3128")
    for variable in ("NO_PROXY", "no_proxy"):
        environment.setenv(variable, no_proxy)
        assert (proxy_for(Target.of(url).origin) is not None) == is_proxied
        environment.delenv(variable)


def test_a_link_is_connected_to_directly(folder: Path, environment: pytest.MonkeyPatch) -> None:
    with proxy(environment, "HTTP_PROXY") as between, web_host(folder) as host:
        with closing(Fetcher(via=("127.0.0.1", host.server_port))) as fetcher:
            assert fetcher.get("http://host.invalid/s/manifest.json", 1 << 20).status == 200
        assert not between.requests
