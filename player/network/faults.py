"""What can go wrong between the player and a host."""

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
    """Whoever waited was told to stop."""
