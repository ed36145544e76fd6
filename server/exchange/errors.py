"""Errors of requests, as answers to their clients."""


class RequestError(Exception):
    """A request that gets an error status and one line that says why."""

    def __init__(self, status: int, message: str, headers: dict[str, str] | None = None) -> None:
        super().__init__(message)
        self.status = status
        self.headers = headers or {}
