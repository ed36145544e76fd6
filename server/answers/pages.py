"""What is not a stream's own data: pages for people, the list of streams, health and metrics."""

from __future__ import annotations

import logging
import math

from codec.stream.poster import poster_path
from server.html import htmlpage, webplayer
from server.html.gallery import Card, card_html, front_page, missing_page
from server.http.errors import RequestError
from server.http.response import Response, json_response
from server.library import ServedStream
from server.operate.prometheus import CONTENT_TYPE

from .call import Call

log = logging.getLogger(__name__)

NO_REFERRER = {"Referrer-Policy": "no-referrer"}
"""A page's own URL may hold its signature."""

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


def _origin(call: Call) -> str:
    """scheme://host of this server as the client calls it."""
    scheme = call.state.scheme
    said = call.request.fields.get("x-forwarded-proto", "")
    if said in ("http", "https") and call.peer_is_proxy:
        scheme = said
    return f"{scheme}://{call.request.host}"


def _title(stream: ServedStream) -> str:
    return stream.view.manifest.title or stream.name


def _about(stream: ServedStream) -> str:
    """The stream in a few figures, for people."""
    manifest = stream.view.manifest
    layers = "1 layer" if manifest.num_layers == 1 else f"{manifest.num_layers} layers"
    return f"{manifest.num_gs:,} Gaussians, {layers}, {stream.fps:g} fps"


def _streams(call: Call) -> list[ServedStream]:
    return [stream for _, stream in sorted(call.state.library.streams.items())]


def _card(stream: ServedStream) -> str:
    """The card of `stream`; its name alone if the rest cannot be shown, so that one stream never
    takes the page of all from the others."""
    try:
        seconds = stream.num_frames / stream.fps
        card = Card(
            stream.name,
            _title(stream),
            poster_path(stream.view.manifest),
            seconds if math.isfinite(seconds) else None,
            stream.live,
            _about(stream),
        )
        return card_html(card)
    except Exception:
        log.exception("the front page shows only the name of %s", stream.name)
        return card_html(Card(stream.name, stream.name))


def front(call: Call) -> Response:
    cards = [_card(stream) for stream in _streams(call)]
    return _page(front_page(cards, _origin(call)), htmlpage.UNFRAMED)


def watch(call: Call) -> Response:
    """The browser player with one stream, under the address that swings-play takes too."""
    origin = _origin(call)
    try:
        stream = call.stream()
    except RequestError as error:
        return _page(missing_page("../"), htmlpage.SECURITY, error.status)
    hint = f"This page needs JavaScript. On a desktop: swings-play {origin}/watch/{stream.name}"
    player = call.state.web_player
    return _page(player.watch_page(_title(stream), "../web/", hint), webplayer.SECURITY)


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
