"""What is not a stream's own data: pages for people, the list of streams, health and metrics."""

from __future__ import annotations

import asyncio
import re
from html import escape

from aiohttp import web

from .errors import RequestError
from .library import ServedStream
from .metrics import CONTENT_TYPE
from .state import STATE, find_stream

_PAGE = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>{title}</title>
<style>body {{ font: 16px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 40rem }}</style>
{body}
</html>
"""

_FRONT = """<h1>Streams</h1>
<ul>
{items}
</ul>
<p>Play one with <code>swings-play {origin}/watch/NAME</code>.</p>"""

_ITEM = '<li><a href="/watch/{name}">{title}</a>: {length}</li>'

_WATCH = """<h1>{title}</h1>
<p>{length}; {num_gs} Gaussians in a frame, {num_layers} layers.</p>
<p>Play it with <code>swings-play {origin}/watch/{name}</code>.</p>
<p><a href="/v1/streams/{name}/manifest.json">Its manifest</a>, <a href="/">all streams</a></p>"""

_MISSING = """<h1>There is no such stream</h1>
<p>See <a href="/">all streams</a>.</p>"""

_SECURITY = "default-src 'none'; style-src 'unsafe-inline'"

_HOST = re.compile(r"([A-Za-z0-9._-]+|\[[0-9A-Fa-f:.]+\])(:[0-9]{1,5})?")


def _page(title: str, body: str, status: int = 200) -> web.Response:
    """An HTML page that may load nothing. title: plain text; body: HTML."""
    return web.Response(
        text=_PAGE.format(title=escape(title), body=body),
        status=status,
        content_type="text/html",
        headers={"Content-Security-Policy": _SECURITY, "Cache-Control": "no-cache"},
    )


def _origin(request: web.Request) -> str:
    """scheme://host of this server as the client calls it."""
    if not _HOST.fullmatch(request.host):
        raise RequestError(400, f"Host {request.host[:80]!a} is not HOST or HOST:PORT")
    return f"{request.scheme}://{request.host}"


def _title(stream: ServedStream) -> str:
    return stream.view.manifest.title or stream.name


def _length(stream: ServedStream) -> str:
    """How long the stream is, for people."""
    seconds = stream.num_frames / stream.fps
    length = f"{stream.num_frames} frames, {seconds:.1f} s at {stream.fps:g} fps"
    return f"live, {length} so far" if stream.live else length


async def _streams(request: web.Request) -> list[ServedStream]:
    library = request.app[STATE].library
    await library.rescan(asyncio.get_running_loop().time())
    return [library.streams[name] for name in sorted(library.streams)]


async def front(request: web.Request) -> web.StreamResponse:
    items = [
        _ITEM.format(name=stream.name, title=escape(_title(stream)), length=_length(stream))
        for stream in await _streams(request)
    ]
    return _page("swings", _FRONT.format(items="\n".join(items), origin=_origin(request)))


async def watch(request: web.Request) -> web.StreamResponse:
    """The page of one stream, under the address that the player takes too."""
    try:
        stream = await find_stream(request)
    except RequestError as error:
        return _page("swings", _MISSING, error.status)
    manifest = stream.view.manifest
    body = _WATCH.format(
        name=stream.name,
        title=escape(_title(stream)),
        length=_length(stream),
        num_gs=manifest.num_gs,
        num_layers=manifest.num_layers,
        origin=_origin(request),
    )
    return _page(_title(stream), body)


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
    return web.json_response({"streams": listed}, headers={"Cache-Control": "no-cache"})


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
