"""Admission control: limits on connections, or plays, for each address and in total.

Rule: no clock and no sockets. There is one entry for each address that holds something, and none
for one that does not.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from ipaddress import IPv6Address, IPv6Network

from codec.errors import InvalidError

from .clientaddress import Network, is_trusted, parse_address

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

    @property
    def has_room(self) -> bool:
        """Whether one more may be held in all."""
        return self.num_held < self._max_all

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
    if is_trusted(parsed, exempt):
        return ""
    if isinstance(parsed, IPv6Address):
        return str(IPv6Network((parsed, CLIENT_BITS), strict=False))
    return str(parsed)
