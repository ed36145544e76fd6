"""Responses other than a stream's data: HTML pages, the list of streams, health and metrics."""

from __future__ import annotations

import asyncio
import logging
import math
import re
from collections import Counter
from dataclasses import replace
from urllib.parse import quote

from aiohttp import HttpVersion11, web
from markupsafe import Markup

from codec.stream.pictures import picture_path, picture_size_px
from server.html import htmlpages
from server.html.htmlpages import (
    Card,
    WatchedStream,
    card_html,
    front_page,
    message_page,
    watch_page,
)
from server.http.content import NO_STORE, REVALIDATE
from server.http.errors import RequestError
from server.library import ServedStream
from server.operate.admission import is_proxy
from server.operate.prometheus import CONTENT_TYPE
from server.state.serverstate import STATE

from .asked import STREAM, stream_of

log = logging.getLogger(__name__)

_PREFIX = re.compile(r"(/[A-Za-z0-9._~-]{1,80}){1,8}")

_HOST = re.compile(r"(?:[A-Za-z0-9._-]{1,255}|\[[0-9A-Fa-f:.]{2,64}\])(?::(?P<port>[0-9]{1,5}))?")

routes = web.RouteTableDef()


def _page(text: str, security: str, status: int = 200, caching: str = REVALIDATE) -> web.Response:
    headers = {
        "Content-Security-Policy": security,
        "Referrer-Policy": "no-referrer",  # its own URL may hold its signature
        "Cache-Control": caching,
    }
    return web.Response(status=status, text=text, content_type="text/html", headers=headers)


def refused_page(has_expired: bool) -> web.Response:
    """What a person sees of a link without permission."""
    if has_expired:
        page = message_page("This link has expired", "Ask whoever sent it for a new one.")
    else:
        text = "Ask whoever runs this server for one. A link that was cut short does not open."
        page = message_page("This page opens with a link made for it", text)
    return _page(page, htmlpages.PLAIN_SECURITY, 403, NO_STORE)


def busy_page(error: RequestError) -> web.Response:
    """What a person sees where there is no room, or not any more."""
    page = message_page(
        "This server is busy", "Try again in a moment; streams go on where they were."
    )
    response = _page(page, htmlpages.PLAIN_SECURITY, error.status, NO_STORE)
    if "Retry-After" in error.headers:
        response.headers["Retry-After"] = error.headers["Retry-After"]
    return response


def _origin(request: web.Request) -> str:
    """scheme://host of this server as the client calls it, and the path where a proxy has it.
    Raises RequestError 400 for a host that is none."""
    host = request.headers.get("Host")
    match = _HOST.fullmatch(host or "")
    if (host is not None or request.version >= HttpVersion11) and (
        match is None or int(match["port"] or 0) > 65535
    ):
        raise RequestError(400, f"Host {(host or '')[:80]!a} is not HOST or HOST:PORT")
    state = request.app[STATE]
    scheme, prefix = state.scheme, ""
    if is_proxy(request.remote or "", state.proxies):
        said = request.headers.get("X-Forwarded-Proto", "")
        scheme = said if said in ("http", "https") else scheme
        prefix = request.headers.get("X-Forwarded-Prefix", "").rstrip("/")
        prefix = prefix if _PREFIX.fullmatch(prefix) else ""
    return f"{scheme}://{host or ''}{prefix}"


def _title(stream: ServedStream) -> str:
    return stream.view.manifest.title or stream.name


def _about(stream: ServedStream) -> str:
    """The stream in a few figures, for people."""
    manifest = stream.view.manifest
    layers = "1 layer" if manifest.num_layers == 1 else f"{manifest.num_layers} layers"
    about = f"up to {manifest.num_gs:,} Gaussians, {layers}"  # its slots, which may be empty
    return about if _is_still(stream) else f"{about}, {stream.fps:g} fps"


def _is_still(stream: ServedStream) -> bool:
    """Whether it is one picture, without time."""
    return stream.num_frames == 1 and not stream.live


def _streams(request: web.Request) -> list[ServedStream]:
    return [stream for _, stream in sorted(request.app[STATE].library.streams.items())]


def _card(stream: ServedStream, titles: Counter[str]) -> Markup:
    """The card of `stream`; its name alone if the rest cannot be shown, so that one stream never
    takes the page of all from the others. titles: how many streams have each."""
    try:
        seconds = stream.num_frames / stream.fps
        title = _title(stream)
        if titles[title] > 1 and title != stream.name:
            title = f"{title} ({stream.name})"
        card = Card(
            stream.name,
            title,
            picture_path(stream.view.manifest.poster),
            seconds if math.isfinite(seconds) and not _is_still(stream) else None,
            stream.live,
            _about(stream),
        )
        return card_html(card)
    except Exception:
        log.exception("the front page shows only the name of %s", stream.name)
        return card_html(Card(stream.name, stream.name))


def _place(stream: ServedStream) -> tuple[bool, list[tuple[int, str]]]:
    """Sorts live streams first, then by title, with `take 2` before `take 10`."""
    parts = re.findall(r"(\d{1,18})|(\D+)", _title(stream))
    return not stream.live, [(int(digits or 0), text.casefold()) for digits, text in parts]


@routes.get("/")
async def front(request: web.Request) -> web.Response:
    streams = sorted(_streams(request), key=_place)
    titles = Counter(map(_title, streams))
    cards = [_card(stream, titles) for stream in streams]
    page = front_page(cards, request.app[STATE].library.broken, _origin(request))
    return _page(page, htmlpages.SECURITY)


@routes.get("/watch/{stream}")
async def watch(request: web.Request) -> web.Response:
    """The browser player with one stream, under the address that swings-play takes too."""
    origin, state = _origin(request), request.app[STATE]
    try:
        stream = stream_of(request)
    except RequestError as error:
        there = Markup('It may have been removed or renamed. See <a href="../">all streams</a>.')
        page = message_page("There is no such stream", there)
        return _page(page, htmlpages.PLAIN_SECURITY, error.status)
    player = state.web_player
    # An address that needs a signature is not one to be passed on.
    watched = _watched(stream, origin)
    path = picture_path(stream.view.manifest.poster) or ""
    if stream.live and not await asyncio.to_thread(stream.has_picture, path):
        watched = replace(watched, poster="")  # it is drawn at the end
    page = watch_page(watched, player, shared=state.signer is None)
    return _page(page, htmlpages.security(player))


def _watched(stream: ServedStream, origin: str) -> WatchedStream:
    manifest = stream.view.manifest
    camera = manifest.camera()
    aspect = camera.width_px / camera.height_px
    poster = quote(picture_path(manifest.poster) or "")
    title, about = _title(stream), _about(stream)
    return WatchedStream(
        name=stream.name,
        title=title,
        about=about,
        origin=origin,
        aspect=aspect,
        poster=poster,
        is_live=stream.live,
        sh_degree=manifest.sh_degree,
    )


@routes.get(f"{STREAM}/oembed.json")
async def oembed(request: web.Request) -> web.Response:
    """How a site shows a stream in a frame of its own, as oEmbed has it (https://oembed.com)."""
    if request.app[STATE].signer is not None:
        raise RequestError(404, "streams with signed URLs cannot be embedded by oEmbed")
    query = request.query
    if query.get("format") not in (None, "", "json"):
        raise RequestError(501, "the only format is json")
    most_px = []
    for key in ("maxwidth", "maxheight"):
        text = query.get(key, "")
        if text and not re.fullmatch("[1-9][0-9]{0,4}", text):
            raise RequestError(400, f"{key}={text[:40]!a} is not a number of pixels")
        most_px.append(int(text) if text else None)
    stream = stream_of(request)
    watched = _watched(stream, _origin(request))
    if stream.view.manifest.poster:
        data = await asyncio.to_thread(stream.read_picture, stream.view.manifest.poster)
        watched = replace(watched, poster_px=picture_size_px(data) if data else None)
    return web.json_response(
        htmlpages.oembed(watched, *most_px), headers={"Cache-Control": REVALIDATE}
    )


@routes.get("/v1/streams")
async def streams(request: web.Request) -> web.Response:
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
        for stream in _streams(request)
    ]
    broken = [
        {"name": name, "reason": reason}
        for name, reason in sorted(request.app[STATE].library.broken.items())
    ]
    return web.json_response(
        {"streams": listed, "broken": broken}, headers={"Cache-Control": REVALIDATE}
    )


@routes.get("/healthz")
async def healthz(request: web.Request) -> web.Response:
    """The process runs its event loop."""
    return web.Response(text="ok\n")


@routes.get("/readyz")
async def readyz(request: web.Request) -> web.Response:
    """New requests are welcome: not while stopping."""
    state = request.app[STATE]
    if state.stopping.is_set():
        raise RequestError(503, "the server is stopping")
    if not state.overload.accepts_plays(len(state.plays)):
        raise RequestError(503, "the server cannot accept another play")
    return web.Response(text="ready\n")


@routes.get("/metrics")
async def metrics(request: web.Request) -> web.Response:
    text = request.app[STATE].metrics.text()
    return web.Response(body=text.encode(), headers={"Content-Type": CONTENT_TYPE})
