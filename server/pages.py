"""What is not a stream's own: the front page, the list of streams, health and metrics."""

from __future__ import annotations

import asyncio
from html import escape

from aiohttp import web

from .errors import RequestError
from .library import ServedStream
from .metrics import CONTENT_TYPE
from .state import STATE

_PAGE = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>swings</title>
<style>body {{ font: 16px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 40rem }}</style>
<h1>Streams</h1>
<ul>
{items}
</ul>
<p>Play one with <code>swings-play {origin}/v1/streams/NAME</code>.</p>
</html>
"""

_ITEM = '<li><a href="/v1/streams/{name}/manifest.json">{title}</a>: {facts}</li>'


async def _streams(request: web.Request) -> list[ServedStream]:
    library = request.app[STATE].library
    await library.rescan(asyncio.get_running_loop().time())
    return [library.streams[name] for name in sorted(library.streams)]


async def front(request: web.Request) -> web.StreamResponse:
    items = []
    for stream in await _streams(request):
        seconds = stream.num_frames / stream.fps
        length = f"{stream.num_frames} frames, {seconds:.1f} s at {stream.fps:g} fps"
        facts = f"live, {length} so far" if stream.live else length
        title = escape(stream.view.manifest.title or stream.name)
        items.append(_ITEM.format(name=stream.name, title=title, facts=facts))
    page = _PAGE.format(items="\n".join(items), origin=escape(str(request.url.origin())))
    policy = "default-src 'none'; style-src 'unsafe-inline'"
    headers = {"Content-Security-Policy": policy, "Cache-Control": "no-cache"}
    return web.Response(text=page, content_type="text/html", headers=headers)


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
