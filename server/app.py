"""The HTTP application: which URL goes where."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import suppress

from aiohttp import web

from codec.stream.index import INDEX_NAME
from codec.stream.manifest import MANIFEST_NAME, MASKS
from server.abr.standing import TOKEN

from . import objects, pages
from .config import ServerConfig
from .library import Library
from .middleware import add_headers, surround
from .news import take_news
from .play import play
from .state import STATE, ServerState

_NUMBER = "0|[1-9][0-9]{0,8}"

_PART = f"{_NUMBER}|{MASKS}|snapshot-(?:{_NUMBER})"
"""What a segment has an object of; which of them there are, the stream says."""

_PICTURE = r"[A-Za-z]{3,4}"
"""How the name of a poster ends."""


def make_app(library: Library, config: ServerConfig) -> web.Application:
    """The application that serves `library`; it must run on one event loop."""
    app = web.Application(middlewares=[surround])
    app[STATE] = ServerState(library, config)
    app.on_response_prepare.append(add_headers)
    app.on_shutdown.append(_stop_plays)
    app.cleanup_ctx.append(_watch_library)
    stream = "/v1/streams/{stream}"
    app.add_routes(
        [
            web.get("/", pages.front),
            web.get("/watch/{stream}", pages.watch),
            web.get("/web/{asset:.+}", objects.web_asset),
            web.get("/healthz", pages.healthz),
            web.get("/readyz", pages.readyz),
            web.get("/metrics", pages.metrics),
            web.get("/v1/streams", pages.streams),
            web.get(f"{stream}/{MANIFEST_NAME}", objects.manifest),
            web.get(f"{stream}/{INDEX_NAME}", objects.index),
            web.get(
                f"{stream}/segments/{{segment:{_NUMBER}}}/{{layer:{_PART}}}",
                objects.segment_object,
            ),
            web.get(f"{stream}/play", play, allow_head=False),
            web.post(f"{stream}/play/{{play:{TOKEN}}}", take_news),
            # Last: its name may hold anything but for its end.
            web.get(f"{stream}/{{poster:.+\\.{_PICTURE}}}", objects.poster),
        ]
    )
    return app


async def _watch_library(app: web.Application) -> AsyncIterator[None]:
    watching = asyncio.create_task(app[STATE].library.watch())
    yield
    watching.cancel()
    with suppress(asyncio.CancelledError):
        await watching


async def _stop_plays(app: web.Application) -> None:
    app[STATE].stopping.set()
