"""The proxy for a host, from HTTP_PROXY, HTTPS_PROXY, ALL_PROXY and NO_PROXY in the environment.

Rule: the standard library reads the variables, so that they mean what they mean to other programs.
"""

from __future__ import annotations

import os
from dataclasses import dataclass

from codec.storage.credentials import without_credentials

from .faults import HostError
from .requesttarget import Origin, Target, bracketed


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
