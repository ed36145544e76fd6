"""URLs: where a request goes, where a reference leads, whose name and password it has; and the
errors of asking. Pure.

Rule: a stream is fetched from the host that the user named, and from no other unless the user
allows it. A name and password go to their own host, and nothing else keeps them: the URLs that are
fetched, shown and raised are without them, see `codec.storage.objectstore`.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from string import punctuation
from urllib.parse import quote, unquote, urljoin, urlsplit

from codec.errors import SwingsError


class FetchError(SwingsError):
    """The server's answer cannot be used; asking again would not help."""


class BrokenError(FetchError):
    """The connection or the server failed; asking again may help.

    `retry_after_s` is how long the server asks to be left alone, seconds; None if it does not.
    """

    def __init__(self, message: str, retry_after_s: float | None = None) -> None:
        super().__init__(message)
        self.retry_after_s = retry_after_s


class MissingError(FetchError):
    """The host has no such file."""


class StoppedError(SwingsError):
    """The wait was interrupted."""


class HostError(Exception):
    """A host, or the proxy before it, gives no answer; the message names no URL.

    `is_final`: asking again would not help.
    """

    def __init__(self, message: str, is_final: bool = False) -> None:
        super().__init__(message)
        self.is_final = is_final


PORTS = {"http": 80, "https": 443}
"""Default port by scheme."""

Origin = tuple[str, str, int]
"""Scheme, host and port."""


@dataclass(frozen=True, slots=True)
class Target:
    """The origin, path and credentials of a request."""

    origin: Origin
    path: str
    """With the query, in ASCII; percent signs stay, because they are escapes already."""
    authorization: str | None

    @staticmethod
    def of(url: str) -> Target:
        """Raises ValueError if `url` is not a URL of the web."""
        parts = urlsplit(url)
        host = parts.hostname
        if parts.scheme not in PORTS or not host or not host.isprintable() or " " in host:
            raise ValueError(url)
        host = host.encode("idna").decode("ascii")  # a UnicodeError is a ValueError
        port = PORTS[parts.scheme] if parts.port is None else parts.port
        path = quote(parts.path or "/", safe=punctuation)
        if parts.query:
            path += "?" + quote(parts.query, safe=punctuation)
        authorization = None
        if parts.username is not None:
            user = f"{unquote(parts.username)}:{unquote(parts.password or '')}"
            authorization = f"Basic {b64encode(user.encode()).decode()}"
        return Target((parts.scheme, host, port), path, authorization)

    @property
    def host_field(self) -> str:
        """The Host header: without the port where it is the scheme's own."""
        scheme, host, port = self.origin
        return bracketed(host) if port == PORTS[scheme] else f"{bracketed(host)}:{port}"


def bracketed(host: str) -> str:
    """`host` as it stands in a URL: an IPv6 address in brackets."""
    return f"[{host}]" if ":" in host else host


def logins_of(urls: Iterable[str]) -> dict[Origin, str]:
    """The Authorization header for each host that one of `urls` has a name or password for."""
    logins = {}
    for url in urls:
        with suppress(ValueError):  # the request for it will report the error
            target = Target.of(url)
            if target.authorization is not None:
                logins[target.origin] = target.authorization
    return logins


def joined(base: str, reference: str, other_hosts: bool) -> str:
    """The URL that `reference` is, seen from `base`. Raises FetchError if it is none, or leads to
    another host than that of `base` and `other_hosts` are not wanted."""
    try:
        url = urljoin(base, reference)
        before, after = urlsplit(base), urlsplit(url)
        ports = before.port or PORTS.get(before.scheme), after.port or PORTS.get(after.scheme)
        host = after.hostname
    except ValueError as error:
        raise FetchError(f"{base} leads to {reference[:200]!r}, which is not a URL") from error
    if after.scheme not in PORTS or not host:
        raise FetchError(f"{base} leads to {url[:200]!r}, which is not on the web")
    if before.scheme == "https" and after.scheme == "http":
        raise FetchError(f"{base} leads to {url[:200]!r}, which is not encrypted")
    upgraded = before.scheme != after.scheme
    if not other_hosts and (host != before.hostname or (ports[0] != ports[1] and not upgraded)):
        raise FetchError(
            f"{base} leads to another host, {after.netloc[:200]}; allow it with --other-hosts"
        )
    return url
