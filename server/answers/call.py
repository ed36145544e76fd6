"""A request as the handlers get it, and how they find what it names."""

from __future__ import annotations

from collections.abc import Coroutine, Mapping
from dataclasses import dataclass
from typing import Any
from urllib.parse import unquote

from server.exchange.errors import RequestError
from server.exchange.request import Request
from server.exchange.response import AnyResponse
from server.library import ServedStream
from server.state.serverstate import ServerState

Answer = AnyResponse | Coroutine[Any, Any, AnyResponse]
"""The result of a handler: a response, or a coroutine that returns one."""


_OF_PROXIES = ("X-Forwarded-For", "Forwarded", "Via")
"""Fields that proxies add to a request."""


@dataclass(frozen=True, slots=True)
class Call:
    """One request to one route."""

    state: ServerState
    request: Request
    address: str
    """Address of the client."""
    peer_is_proxy: bool
    """Whether the connection is a proxy's that is trusted."""
    names: Mapping[str, str]
    """The parts of the path by the names that the route gives them, as they were sent."""

    @property
    def is_proxied(self) -> bool:
        """Whether something between the client and this server takes in what is sent to it."""
        return any(name in self.request.fields for name in _OF_PROXIES)

    def name(self, key: str) -> str:
        """A part of the path, with its %XX read."""
        return unquote(self.names[key])

    def stream(self) -> ServedStream:
        """The stream that the URL names. Raises RequestError 404 where there is none."""
        name = self.name("stream")
        stream = self.state.library.streams.get(name)
        if stream is None:
            raise RequestError(404, f"no stream is named {name[:80]!a}; /v1/streams lists all")
        return stream
