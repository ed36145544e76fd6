"""URLs that a stranger chose: where they lead, and whether to follow. Pure.

Rule: a stream is fetched from the host that the user named, and from no other unless he says so.
"""

from __future__ import annotations

from urllib.parse import urljoin, urlsplit

from .faults import FetchError

PORTS = {"http": 80, "https": 443}
"""Where a URL leads that names no port."""


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
