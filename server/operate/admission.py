"""Whom a connection speaks for, its peer or the client of a proxy that is trusted; and limits on
connections, or plays, for each of them and in total.

Rule: no clock and no sockets. Only what a trusted proxy wrote counts. Everything left of the first
stranger in X-Forwarded-For may have been made up by that stranger.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from ipaddress import IPv4Address, IPv4Network, IPv6Address, IPv6Network, ip_address, ip_network

from codec.errors import InvalidError, SwingsError

if sys.platform != "win32":
    import resource

Address = IPv4Address | IPv6Address
Network = IPv4Network | IPv6Network

MAX_HOPS = 16
"""Entries of X-Forwarded-For that are looked at, from the right."""


def parse_proxies(text: str) -> tuple[Network, ...]:
    """The networks in `text`, CIDRs between commas. Raises InvalidError for what is not one."""
    networks = []
    for word in filter(None, (word.strip() for word in text.split(","))):
        try:
            networks.append(ip_network(word))
        except ValueError as error:
            raise InvalidError(
                f"trusted proxy {word[:60]!a} is not an address or a network such as 10.0.0.0/8"
            ) from error
    return tuple(networks)


@lru_cache(maxsize=4096)
def parse_address(text: str) -> Address | None:
    """The address in `text`, which may have a port, brackets or a zone; None where it has none.

    An IPv4 address that is written as an IPv6 one counts as IPv4.
    """
    text = text.strip()
    if text.startswith("["):
        text = text[1:].partition("]")[0]
    elif text.count(":") == 1:  # an IPv6 address has more of them
        text = text.partition(":")[0]
    try:
        address = ip_address(text.partition("%")[0])
    except ValueError:
        return None
    mapped = address.ipv4_mapped if isinstance(address, IPv6Address) else None
    return mapped or address


@lru_cache(maxsize=4096)
def is_proxy(text: str, proxies: tuple[Network, ...]) -> bool:
    """Whether the address in `text` is one of the trusted proxies."""
    address = parse_address(text)
    return address is not None and any(address in network for network in proxies)


def client_address(peer: str, forwarded_for: Sequence[str], proxies: tuple[Network, ...]) -> str:
    """The address of the client of a request.

    peer: address of the connection; what cannot be read as one, as of a Unix socket, is given back.
    forwarded_for: the values of all X-Forwarded-For lines, in order. The right-most entry that
    is not itself a trusted proxy is the client; where all are, it is the left-most.
    """
    client = peer
    entries = [entry for line in forwarded_for for entry in line.split(",")]
    for entry in (peer, *reversed(entries[-MAX_HOPS:])):
        address = parse_address(entry)
        if address is None:
            break  # the proxy wrote "unknown", or let a stranger's nonsense through
        client = str(address)
        if not is_proxy(entry, proxies):
            break
    return client


CLIENT_BITS = 64
"""Leading bits of an IPv6 address that a provider assigns to a customer; the customer chooses the
other bits."""


@dataclass(frozen=True, slots=True)
class AdmissionConfig:
    """Limits on what clients hold at the same time, in one worker."""

    max_connections: int = 4096
    """Maximum concurrent connections, if the open-file limit allows that many."""
    max_address_connections: int = 256
    """Maximum concurrent connections from one address (IPv6: one /64). A school or a mobile network
    may use one address."""
    max_address_plays: int = 64
    """Maximum concurrent plays for one address (IPv6: one /64)."""

    def __post_init__(self) -> None:
        for name in ("max_connections", "max_address_connections", "max_address_plays"):
            if not getattr(self, name) > 0:
                raise InvalidError(f"{name} is {getattr(self, name)}; it must be positive")


class Refusal(StrEnum):
    """Why a client is not admitted."""

    FULL = "full"
    """All places are taken."""
    ADDRESS = "address"
    """This address has all that one may have."""


class Admission:
    """Counts what is held, of one kind."""

    def __init__(self, max_all: int, max_address: int, exempt: Sequence[Network] = ()) -> None:
        """exempt: addresses that many clients share, such as trusted proxies': they count in all
        only."""
        self._max_all = max_all
        self._max_address = max_address
        self._exempt = tuple(exempt)
        self._held: Counter[str] = Counter()
        self.num_held = 0
        """Number held by all addresses, exempt ones included."""

    def admit(self, address: str) -> Refusal | None:
        """Counts one more for `address`, which `release` must give back; or says why not."""
        if self.num_held >= self._max_all:
            return Refusal.FULL
        client = client_of(address, self._exempt)
        if client:
            if self._held[client] >= self._max_address:
                return Refusal.ADDRESS
            self._held[client] += 1
        self.num_held += 1
        return None

    def release(self, address: str) -> None:
        """Gives back what `admit` gave. Raises ValueError where there is nothing to give back."""
        client = client_of(address, self._exempt)
        if self.num_held <= 0 or (client and client not in self._held):
            raise ValueError(f"{address} holds nothing")
        self.num_held -= 1
        if client:
            self._held[client] -= 1
            if not self._held[client]:
                del self._held[client]


@lru_cache(maxsize=4096)
def client_of(address: str, exempt: tuple[Network, ...]) -> str:
    """The client that `address` counts as; empty if the address is exempt."""
    parsed = parse_address(address)
    if parsed is None:
        return address
    if is_proxy(address, exempt):
        return ""
    if isinstance(parsed, IPv6Address):
        return str(IPv6Network((parsed, CLIENT_BITS), strict=False))
    return str(parsed)


RESERVE = 80
"""Descriptors kept for what is not a connection: files of objects, the log, the event loop."""

WINDOWS_SOCKETS = 512
"""The most sockets that `select`, and so an event loop, watches on Windows."""

RAISE_TO = 65_536
"""The soft limit is raised to the hard one, but not above this: an unlimited table costs memory."""


def connection_limit(wanted: int) -> int:
    """The most connections, `wanted` or fewer, that this process has descriptors for.

    Raises the process's own soft limit as far as the hard one allows. Raises SwingsError where
    there is not room for one.
    """
    if sys.platform == "win32":
        return min(wanted, WINDOWS_SOCKETS - RESERVE)
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY:
        return wanted
    most = RAISE_TO if hard == resource.RLIM_INFINITY else min(hard, RAISE_TO)
    if soft < most:
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))
        soft = most
    if soft <= RESERVE:
        raise SwingsError(
            f"the limit of open files is {soft}, which leaves none for connections; "
            f"raise it (ulimit -n) to {RESERVE + wanted}"
        )
    return min(wanted, soft - RESERVE)
