"""What is not a stream's own data: pages for people, the list of streams, health and metrics."""

from __future__ import annotations

import re

from aiohttp import web

from .errors import RequestError
from .html import htmlpage, webplayer
from .html.gallery import Card, front_page, missing_page
from .library import ServedStream
from .metrics import CONTENT_TYPE
from .state import STATE, find_stream

_HOST = re.compile(r"([A-Za-z0-9._-]+|\[[0-9A-Fa-f:.]+\])(:[0-9]{1,5})?")


def _page(text: str, security: str, status: int = 200) -> web.Response:
    headers = {"Content-Security-Policy": security, "Cache-Control": "no-cache"}
    return web.Response(text=text, status=status, content_type="text/html", headers=headers)


def _origin(request: web.Request) -> str:
    """scheme://host of this server as the client calls it."""
    if not _HOST.fullmatch(request.host):
        raise RequestError(400, f"Host {request.host[:80]!a} is not HOST or HOST:PORT")
    return f"{request.scheme}://{request.host}"


def _title(stream: ServedStream) -> str:
    return stream.view.manifest.title or stream.name


def _about(stream: ServedStream) -> str:
    """The stream in a few figures, for people."""
    manifest = stream.view.manifest
    layers = "1 layer" if manifest.num_layers == 1 else f"{manifest.num_layers} layers"
    return f"{manifest.num_gs:,} Gaussians, {layers}, {stream.fps:g} fps"


async def _streams(request: web.Request) -> list[ServedStream]:
    library = request.app[STATE].library
    return [library.streams[name] for name in sorted(library.streams)]


async def front(request: web.Request) -> web.StreamResponse:
    cards = [
        Card(
            stream.name,
            _title(stream),
            stream.view.manifest.poster,
            stream.num_frames / stream.fps,
            stream.live,
            _about(stream),
        )
        for stream in await _streams(request)
    ]
    return _page(front_page(cards, _origin(request)), htmlpage.SECURITY)


async def watch(request: web.Request) -> web.StreamResponse:
    """The browser player with one stream, under the address that swings-play takes too."""
    origin = _origin(request)
    try:
        stream = await find_stream(request)
    except RequestError as error:
        return _page(missing_page("../"), htmlpage.SECURITY, error.status)
    hint = f"This page needs JavaScript. On a desktop: swings-play {origin}/watch/{stream.name}"
    player = request.app[STATE].web_player
    return _page(player.watch_page(_title(stream), "../web/", hint), webplayer.SECURITY)


async def streams(request: web.Request) -> web.StreamResponse:
    listed = [
        {
            "name": stream.name,
            "title": stream.view.manifest.title,
            "live": stream.live,
            "fps": stream.fps,
            "num_frames": stream.num_frames,
            "num_layers": stream.view.manifest.num_layers,
            "manifest": f"/v1/streams/{stream.name}/manifest.json",
        }
        for stream in await _streams(request)
    ]
    broken = [
        {"name": name, "reason": reason}
        for name, reason in sorted(request.app[STATE].library.broken.items())
    ]
    body = {"streams": listed, "broken": broken}
    return web.json_response(body, headers={"Cache-Control": "no-cache"})


async def healthz(request: web.Request) -> web.StreamResponse:
    """The process runs its event loop."""
    return web.Response(text="ok\n")


async def readyz(request: web.Request) -> web.StreamResponse:
    """New requests are welcome: not while stopping."""
    if request.app[STATE].stopping.is_set():
        raise RequestError(503, "the server is stopping")
    return web.Response(text="ready\n")


async def metrics(request: web.Request) -> web.StreamResponse:
    text = request.app[STATE].metrics.text()
    return web.Response(body=text.encode(), headers={"Content-Type": CONTENT_TYPE})
