"""Responses other than a stream's data: HTML pages, the list of streams, health and metrics."""

from __future__ import annotations

import asyncio
import logging
import math
import re
from collections import Counter
from dataclasses import replace
from urllib.parse import parse_qsl, quote

from markupsafe import Markup

from codec.stream.pictures import picture_path, picture_size_px
from server.exchange.errors import RequestError
from server.exchange.response import Response, json_response
from server.html import gallery, htmlpage, watchpage
from server.html.gallery import Card, card_html, front_page
from server.html.htmlpage import message_page
from server.html.watchpage import WatchedStream, watch_page
from server.library import ServedStream
from server.operate.prometheus import CONTENT_TYPE

from .call import Call

log = logging.getLogger(__name__)

NO_REFERRER = {"Referrer-Policy": "no-referrer"}
"""A page's own URL may hold its signature."""

_PREFIX = re.compile(r"(/[A-Za-z0-9._~-]{1,80}){1,8}")

REVALIDATE = {"Cache-Control": "no-cache"}


def _page(text: str, security: str, status: int = 200) -> Response:
    fields = {
        "Content-Type": "text/html; charset=utf-8",
        "Content-Security-Policy": security,
        **NO_REFERRER,
        **REVALIDATE,
    }
    return Response(status, fields, text.encode())


def _text(text: str) -> Response:
    return Response(200, {"Content-Type": "text/plain; charset=utf-8"}, text.encode())


def refused_page(has_expired: bool) -> Response:
    """What a person sees of a link without permission."""
    if has_expired:
        page = message_page("This link has expired", "Ask whoever sent it for a new one.")
    else:
        text = "Ask whoever runs this server for one. A link that was cut short does not open."
        page = message_page("This page opens with a link made for it", text)
    response = _page(page, htmlpage.SECURITY, 403)
    return Response(403, {**response.fields, "Cache-Control": "no-store"}, response.body)


def busy_page(error: RequestError) -> Response:
    """What a person sees where there is no room, or not any more."""
    text = "Try again in a moment; streams go on where they were."
    response = _page(message_page("This server is busy", text), htmlpage.SECURITY, error.status)
    fields = {**response.fields, "Cache-Control": "no-store", **error.headers}
    return Response(error.status, fields, response.body)


def _origin(call: Call) -> str:
    """scheme://host of this server as the client calls it, and the path where a proxy has it."""
    scheme = call.state.scheme
    said = call.request.fields.get("X-Forwarded-Proto", "")
    if said in ("http", "https") and call.peer_is_proxy:
        scheme = said
    prefix = call.request.fields.get("X-Forwarded-Prefix", "").rstrip("/")
    if not (call.peer_is_proxy and _PREFIX.fullmatch(prefix)):
        prefix = ""
    return f"{scheme}://{call.request.host}{prefix}"


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


def _streams(call: Call) -> list[ServedStream]:
    return [stream for _, stream in sorted(call.state.library.streams.items())]


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


def front(call: Call) -> Response:
    streams = sorted(_streams(call), key=_place)
    titles = Counter(map(_title, streams))
    cards = [_card(stream, titles) for stream in streams]
    page = front_page(cards, call.state.library.broken, _origin(call))
    return _page(page, gallery.SECURITY)


async def watch(call: Call) -> Response:
    """The browser player with one stream, under the address that swings-play takes too."""
    origin = _origin(call)
    try:
        stream = call.stream()
    except RequestError as error:
        there = Markup('It may have been removed or renamed. See <a href="../">all streams</a>.')
        page = message_page("There is no such stream", there)
        return _page(page, htmlpage.SECURITY, error.status)
    player = call.state.web_player
    # An address that needs a signature is not one to be passed on.
    watched = _watched(stream, origin)
    path = picture_path(stream.view.manifest.poster) or ""
    if stream.live and not await asyncio.to_thread(stream.has_picture, path):
        watched = replace(watched, poster="")  # it is drawn at the end
    page = watch_page(watched, player, shared=call.state.signer is None)
    return _page(page, watchpage.security(player))


def _watched(stream: ServedStream, origin: str) -> WatchedStream:
    manifest = stream.view.manifest
    camera = manifest.camera()
    aspect = camera.width_px / camera.height_px
    poster = quote(picture_path(manifest.poster) or "")
    title, about = _title(stream), _about(stream)
    return WatchedStream(stream.name, title, about, origin, aspect, poster, is_live=stream.live)


async def oembed(call: Call) -> Response:
    """How a site shows a stream in a frame of its own, as oEmbed has it (https://oembed.com)."""
    if call.state.signer is not None:
        raise RequestError(404, "streams with signed URLs cannot be embedded by oEmbed")
    query = dict(parse_qsl(call.request.query))
    if query.get("format", "json") != "json":
        raise RequestError(501, "the only format is json")
    most_px = []
    for key in ("maxwidth", "maxheight"):
        text = query.get(key, "")
        if text and not re.fullmatch("[1-9][0-9]{0,4}", text):
            raise RequestError(400, f"{key}={text[:40]!a} is not a number of pixels")
        most_px.append(int(text) if text else None)
    stream = call.stream()
    watched = _watched(stream, _origin(call))
    if stream.view.manifest.poster:
        data = await asyncio.to_thread(stream.read_picture, stream.view.manifest.poster)
        watched = replace(watched, poster_px=picture_size_px(data) if data else None)
    return json_response(watchpage.oembed(watched, *most_px), 200, REVALIDATE)


def streams(call: Call) -> Response:
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
        for stream in _streams(call)
    ]
    broken = [
        {"name": name, "reason": reason}
        for name, reason in sorted(call.state.library.broken.items())
    ]
    return json_response({"streams": listed, "broken": broken}, 200, REVALIDATE)


def healthz(call: Call) -> Response:
    """The process runs its event loop."""
    return _text("ok\n")


def readyz(call: Call) -> Response:
    """New requests are welcome: not while stopping."""
    state = call.state
    if state.stopping.is_set():
        raise RequestError(503, "the server is stopping")
    if not state.overload.accepts_plays(len(state.plays)):
        raise RequestError(503, "the server cannot accept another play")
    return _text("ready\n")


def metrics(call: Call) -> Response:
    text = call.state.metrics.text()
    return Response(200, {"Content-Type": CONTENT_TYPE}, text.encode())
