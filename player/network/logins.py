"""Names and passwords that a user gives in URLs: each goes to its own host, and nowhere else.

Rule: nothing else keeps them. The URLs that are fetched, shown and raised are without them, see
`codec.storage.credentials`.
"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress

from .httpconnection import Target

Origin = tuple[str, str, int]
"""Scheme, host and port."""


def logins_of(urls: Iterable[str]) -> dict[Origin, str]:
    """The Authorization header for each host that one of `urls` has a name or password for."""
    logins = {}
    for url in urls:
        with suppress(ValueError):  # whoever fetches it says what is wrong with it
            target = Target.of(url)
            if target.authorization is not None:
                logins[target.place] = target.authorization
    return logins
