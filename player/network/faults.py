"""Errors between the player and a host."""

from __future__ import annotations

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
