"""The server's errors: those that end it, and those that are an answer to a client."""

from codec.errors import SwingsError


class ServerError(SwingsError):
    """The server cannot start, or go on, with what it was given."""


class RequestError(Exception):
    """A request that gets an error status and one line that says why."""

    def __init__(self, status: int, message: str, headers: dict[str, str] | None = None) -> None:
        super().__init__(message)
        self.status = status
        self.headers = headers or {}
