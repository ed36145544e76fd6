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
RETRY_AFTER_S = 5
"""Seconds after which a refused client may ask again."""

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

    def check_room(self, continues: bool = False) -> None:
        """Raises RequestError 503 unless one more play may begin. continues: see
        `Overload.accepts_plays`."""
        state = self.state
        if state.stopping.is_set():
            raise RequestError(503, "the server is stopping", {"Retry-After": str(RETRY_AFTER_S)})
        if not state.overload.accepts_plays(len(state.plays), continues):
            state.metrics.refused.add(1, "play_load")
            message = f"the server is full, with {len(state.plays)} plays; try again later"
            after_s = max(RETRY_AFTER_S, state.overload.retry_after_s)
            raise RequestError(503, message, {"Retry-After": str(after_s)})

    def take_place(self) -> None:
        """Takes a play's place for the client, which `give_back_place` gives back. Raises
        RequestError 429."""
        refusal = self.state.play_admission.admit(self.address)
        if refusal is not None:
            self.state.metrics.refused.add(1, f"play_{refusal}")
            message = "too many plays from this address; try again later"
            raise RequestError(429, message, {"Retry-After": str(RETRY_AFTER_S)})

    def give_back_place(self) -> None:
        self.state.play_admission.release(self.address)

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
