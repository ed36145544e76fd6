"""HTTP/1.1 over httpcore, directly or through a proxy, on a loop that runs only while a caller
waits.

Rule: an answer that brings nothing of use for too long ends. Bytes whose use is not known yet, as
of half a packet, extend its time by what a very slow link would take for them. The standard library
reads HTTP_PROXY, HTTPS_PROXY, ALL_PROXY and NO_PROXY, so that they mean what they mean to other
programs; httpcore is imported at the first request, because playing from a folder needs no network.
"""

from __future__ import annotations

import asyncio
import os
import ssl
from collections.abc import AsyncIterator, Iterator, Mapping
from contextlib import aclosing, contextmanager
from dataclasses import dataclass
from functools import cache, partial
from typing import TYPE_CHECKING, Any
from wsgiref.headers import Headers

from codec.storage.objectstore import without_credentials

from .target import HostError, Origin, Target, bracketed

if TYPE_CHECKING:
    import httpcore


@dataclass(frozen=True, slots=True)
class Proxy:
    """An HTTP proxy."""

    target: Target
    """Its address, with the user's name and password for it."""
    variable: str
    """The environment variable that names it."""

    def __str__(self) -> str:
        return f"the proxy http://{self.target.host_field}"

    def refusal(self, status: int) -> HostError:
        """The error for an answer of the proxy itself."""
        hint = f"; put name and password into {self.variable}: http://name:password@host:port"
        message = f"{self} answered HTTP {status}{hint if status == 407 else ''}"
        return HostError(message, is_final=status < 500 and status != 429)


def proxy_for(origin: Origin) -> Proxy | None:
    """The proxy for requests to `origin`; None where there is none. Raises HostError for a proxy
    that is not an http:// URL."""
    if not any(name.lower().endswith("_proxy") for name in os.environ):
        return None  # urllib.request loads in 15 ms
    from urllib.request import getproxies_environment, proxy_bypass

    scheme, host, port = origin
    proxies = getproxies_environment()
    kind = scheme if scheme in proxies else "all"
    names = (host, f"{bracketed(host)}:{port}")  # as NO_PROXY may have it
    if kind not in proxies or any(proxy_bypass(name) for name in names):
        return None
    url = proxies[kind] if "://" in proxies[kind] else f"http://{proxies[kind]}"
    variable = f"{kind}_proxy".upper()
    try:
        target = Target.of(url)
    except ValueError:
        target = None
    if target is None or target.origin[0] != "http":
        shown = without_credentials(url)
        raise HostError(f"{variable} is {shown!r}, not the http:// URL of a proxy", is_final=True)
    return Proxy(target, variable)


MAX_IDLE = 4
"""Idle connections kept for a host: so many requests there are at a time."""

WRONG_HOST = (62, 64)
"""OpenSSL's codes for a certificate of another name, and of another address."""

UNKNOWN_ISSUER = (18, 19, 20, 21)
"""OpenSSL's codes for a certificate that is signed by itself, or by an issuer that is not known."""

NOT_TLS = ("WRONG_VERSION_NUMBER", "HTTP_REQUEST", "RECORD_LAYER_FAILURE")
"""OpenSSL's reasons where what answers does not speak TLS."""


@cache
def _tls() -> ssl.SSLContext:
    return ssl.create_default_context()


class HttpPool:
    """Requests may run side by side, each over a connection of its own."""

    def __init__(self, connect_timeout_s: float, via: tuple[str, int] | None = None) -> None:
        """via: address that every request goes to, without proxies, in place of its host's."""
        self._timeouts = {"connect": connect_timeout_s}
        self._via = via
        self.loop = asyncio.new_event_loop()
        self._routes: dict[Origin, tuple[httpcore.AsyncConnectionPool, Proxy | None]] = {}

    async def request(
        self, method: str, target: Target, fields: Mapping[str, str], body: bytes | None = None
    ) -> Answer:
        """An answer whose body is yet to be read. Raises HostError, TimeoutError."""
        import httpcore

        headers = {"Host": target.host_field, "User-Agent": "swings", "Accept": "*/*"}
        headers["Accept-Encoding"] = "identity"  # objects are compressed already
        if target.authorization is not None:
            headers["Authorization"] = target.authorization
        if body is not None:
            headers["Content-Length"] = str(len(body))
            headers["Content-Type"] = "application/octet-stream"
        headers |= fields
        pool, proxy = self._route(target.origin)
        scheme, host, port = target.origin
        if proxy is not None:
            host = bracketed(host)  # as it stands in the request
        elif self._via is not None:
            host, port = self._via
        hint = "; if the server speaks TLS, use https://" if scheme == "http" else ""
        while True:
            opened: list[Any] = []  # the connection that this try opens
            request = httpcore.Request(
                method,
                httpcore.URL(scheme=scheme, host=host, port=port, target=target.path),
                headers=list(headers.items()),
                content=body,
                extensions={"timeout": self._timeouts, "trace": partial(_record, opened)},
            )
            try:
                with _named(target.origin[1], proxy, hint):
                    response = await pool.handle_async_request(request)
                break
            except BaseException as error:
                for stream in filter(None, opened):  # httpcore may leave it open when cancelled
                    await stream.aclose()
                # A host may close an idle connection just as it is used again: ask once more.
                if opened or body is not None or not isinstance(error, HostError):
                    raise
        if proxy is not None and response.status == 407:
            await response.aclose()
            raise proxy.refusal(407)
        return Answer(response)

    def _route(self, origin: Origin) -> tuple[httpcore.AsyncConnectionPool, Proxy | None]:
        if origin not in self._routes:
            import httpcore

            proxy, through = None if self._via else proxy_for(origin), None
            if proxy is not None:
                login = proxy.target.authorization
                fields = [] if login is None else [("Proxy-Authorization", login)]
                through = httpcore.Proxy(f"http://{proxy.target.host_field}", headers=fields)
            pool = httpcore.AsyncConnectionPool(
                ssl_context=_tls() if origin[0] == "https" else None,
                proxy=through,
                max_connections=None,  # the sources bound their requests
                max_keepalive_connections=MAX_IDLE,
            )
            self._routes[origin] = pool, proxy
        return self._routes[origin]

    def close(self) -> None:
        """Closes all connections, and the loop."""
        if self.loop.is_closed():
            return
        for pool, _ in self._routes.values():
            self.loop.run_until_complete(pool.aclose())
        self.loop.run_until_complete(self.loop.shutdown_asyncgens())
        self.loop.close()


class Answer:
    """An answer whose body is read piece by piece. Close it."""

    def __init__(self, response: httpcore.Response) -> None:
        self._response = response
        self._pieces = _pieces(response)
        self._reading: asyncio.Future[bytes] | None = None
        self.status = response.status
        fields = [(name.decode(), text.decode("latin-1")) for name, text in response.headers]
        self.headers = Headers(fields)

    async def piece(self, timeout_s: float) -> bytes | None:
        """The next piece of the body, empty at its end; None if nothing came in time, and the next
        call waits on. Raises HostError, TimeoutError."""
        if self._reading is None:
            self._reading = asyncio.ensure_future(anext(self._pieces, b""))
        done, _ = await asyncio.wait([self._reading], timeout=timeout_s)
        if not done:
            return None
        self._reading = None
        return done.pop().result()

    async def close(self) -> None:
        """Drops what was not read, and the connection with it."""
        if self._reading is not None:
            self._reading.cancel()
            await asyncio.gather(self._reading, return_exceptions=True)
            self._reading = None
        await self._response.aclose()


async def _pieces(response: httpcore.Response) -> AsyncIterator[bytes]:
    with _named("", None, ""):
        async with aclosing(response):
            async for piece in response.aiter_stream():
                yield piece


async def _record(opened: list[Any], event: str, details: dict[str, Any]) -> None:
    """An httpcore trace that keeps the connection which a request opens."""
    if event.startswith("connection.connect_tcp"):
        opened.append(details.get("return_value"))


@contextmanager
def _named(host: str, proxy: Proxy | None, hint: str) -> Iterator[None]:
    """Makes an error of httpcore a HostError. host: whose TLS it is. hint: of what else the host
    may speak."""
    import httpcore

    try:
        yield
    except httpcore.TimeoutException as error:
        raise TimeoutError from error
    except httpcore.ProxyError as error:  # its text begins with the status
        assert proxy is not None
        raise proxy.refusal(int(str(error)[:3])) from error
    except (httpcore.ProtocolError, httpcore.NetworkError, OSError) as error:
        cause = _cause(error) if isinstance(error, httpcore.NetworkError) else error
        if isinstance(cause, ssl.SSLError):
            raise _handshake_error(cause, host) from error
        code = cause.errno or 0 if isinstance(cause, OSError) else 0
        # The name service's codes are below 1, and it has words of its own.
        text = os.strerror(code) if code > 0 else " ".join(str(cause).split())
        text = text.rstrip(".") or "the host closed the connection"
        if isinstance(error, httpcore.ConnectError):
            to_proxy = f" to {proxy}" if proxy is not None else ""
            raise HostError(f"cannot connect{to_proxy}: {text}") from error
        raise HostError(f"the connection broke: {text}{hint}") from error


def _cause(error: BaseException) -> BaseException:
    """The first of what led to `error`, whose cause httpcore's pool hides, but not the context."""
    cause = error.__context__
    while cause is not None:
        error, cause = cause, cause.__cause__
        if isinstance(error, ExceptionGroup):  # of several addresses
            cause = error.exceptions[0]
    return error


def _handshake_error(error: ssl.SSLError, host: str) -> HostError:
    """`error` of a handshake with `host`, as an error that says what it means."""
    if isinstance(error, ssl.SSLCertVerificationError):
        if error.verify_code in WRONG_HOST:
            return HostError(f"its certificate is for another host, not for {host}", True)
        hint = ""
        if error.verify_code in UNKNOWN_ISSUER:
            hint = "; if you trust it, name a file with its certificate in SSL_CERT_FILE"
        return HostError(f"its certificate is not trusted: {error.verify_message}{hint}", True)
    if error.reason in NOT_TLS:
        return HostError("the server does not speak TLS at this port; try http://", True)
    return HostError(f"TLS failed: {error.reason or ' '.join(str(error).split())}")


LEAST_BYTES_PER_S = 2000
"""A link that is slower is too slow to play anything."""


class IdleLimit:
    """The time that an answer may go on without anything of use."""

    def __init__(self, idle_s: float, now_s: float) -> None:
        self._idle_s = idle_s
        self._since_s = now_s
        self.num_bytes = 0
        """Bytes that came since something of use did."""
        self._open_bytes = 0
        """Bytes among them whose use is not known yet."""

    def useful(self, now_s: float) -> None:
        """Something of use came, or nothing was wanted until now."""
        self._since_s = now_s
        self.num_bytes = self._open_bytes = 0

    def received(self, num_bytes: int) -> None:
        self.num_bytes += num_bytes
        self._open_bytes += num_bytes

    def judged(self) -> None:
        """The use of what came is known; where it had some, `useful` is called as well."""
        self._open_bytes = 0

    def left_s(self, now_s: float) -> float:
        """Seconds until it is over, above 0; 0 when it is."""
        end_s = self._since_s + self._idle_s + self._open_bytes / LEAST_BYTES_PER_S
        return max(0.0, end_s - now_s)

    def reason(self, now_s: float) -> str:
        """Why it is over."""
        seconds = f"{now_s - self._since_s:.0f} s"
        if not self.num_bytes:
            return f"no bytes arrived for {seconds}"
        return f"{self.num_bytes} bytes arrived in {seconds}, but no usable data"
