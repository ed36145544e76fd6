"""Whom a connection speaks for: its peer, or the client of a proxy that is trusted.

Rule: only what a trusted proxy wrote counts. Everything left of the first stranger in
X-Forwarded-For may have been made up by that stranger.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from ipaddress import IPv4Address, IPv4Network, IPv6Address, IPv6Network, ip_address, ip_network

from codec.errors import InvalidError

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


def is_trusted(address: Address, proxies: Sequence[Network]) -> bool:
    return any(address in network for network in proxies)


@lru_cache(maxsize=4096)
def is_proxy(peer: str, proxies: tuple[Network, ...]) -> bool:
    """Whether `peer`, the address of a connection, is one of the trusted proxies."""
    address = parse_address(peer)
    return address is not None and is_trusted(address, proxies)


def client_address(peer: str, forwarded_for: Sequence[str], proxies: Sequence[Network]) -> str:
    """The address of the client of a request.

    peer: address of the connection; what cannot be read as one, as of a Unix socket, is given back.
    forwarded_for: the values of all X-Forwarded-For lines, in order. The right-most entry that
    is not itself a trusted proxy is the client; where all are, it is the left-most.
    """
    address = parse_address(peer)
    if address is None:
        return peer
    if not proxies or not is_trusted(address, proxies):
        return str(address)
    entries = [entry for line in forwarded_for for entry in line.split(",")]
    for entry in reversed(entries[-MAX_HOPS:]):
        before = parse_address(entry)
        if before is None:
            break  # the proxy wrote "unknown", or let a stranger's nonsense through
        address = before
        if not is_trusted(address, proxies):
            break
    return str(address)
