"""What became of each request, for the log and the metrics."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from aiohttp import web
from aiohttp.abc import AbstractAccessLogger

from server.operate.admission import Network, client_address, is_proxy
from server.operate.log import EventLog, LogRequests, Value
from server.operate.prometheus import Metrics
from server.operate.sign.signing import Grant, without_signatures

CLIENT_GONE: Final = 499
"""Status logged for a response that its client did not read to the end; it is never sent."""

NOT_HTTP: Final = "UNKNOWN"
"""The method of what aiohttp could not read; no request has it."""

SIGNED: Final = "/t/{signature}"
"""How the routes of signed URLs begin."""

FACTS = web.RequestKey("facts", Mapping[str, Value])
"""More facts about a request, by field name; requests that have some, such as plays, have a line in
any case."""

NOTE = web.RequestKey("note", str)
"""Why a request failed."""

GRANT = web.RequestKey("grant", Grant)
"""The access that its signature gives, which its path has not got any more."""

WAITS_FROM_S = web.RequestKey("waits_from_s", float)
"""When its handler began to wait for what it answers, by the event loop's clock."""

SENT_BYTES = web.RequestKey("sent_bytes", int)
"""How much was written to a client that has gone; else aiohttp's writer knows."""

COUNTED_BYTES = web.RequestKey("counted_bytes", int)
"""How much of that was counted while it was sent."""


def address_of(request: web.BaseRequest, proxies: tuple[Network, ...]) -> str:
    """The address of the client: that of the connection, or what a trusted proxy says it is."""
    peer = request.remote or ""
    if "X-Forwarded-For" in request.headers and is_proxy(peer, proxies):
        return client_address(peer, request.headers.getall("X-Forwarded-For"), proxies)
    return peer


def request_log(
    metrics: Metrics,
    count: Callable[[int], None],
    proxies: tuple[Network, ...],
    log: EventLog | None,
    told: LogRequests,
) -> type[AbstractAccessLogger]:
    """The access logger of an application. count: called with the bytes of each response, but for
    those that were counted while it was sent. log: None for no lines."""

    class RequestLog(AbstractAccessLogger):
        def log(self, request: web.BaseRequest, response: web.StreamResponse, time: float) -> None:
            status = response.status
            sent_bytes = request.get(SENT_BYTES, request.writer.output_size)
            metrics.requests.add(1, _route_of(request), str(status))
            count(sent_bytes - request.get(COUNTED_BYTES, 0))
            if log is None or not (status >= 400 or told is LogRequests.ALL or FACTS in request):
                return
            fields: dict[str, Value] = {"address": address_of(request, proxies)}
            if request.method != NOT_HTTP:
                grant, url = request.get(GRANT), request.rel_url
                fields["method"] = request.method
                fields["path"] = without_signatures(grant.path if grant else url.raw_path)
                fields["query"] = without_signatures(url.raw_query_string) or None
            fields |= {"status": status, "bytes": sent_bytes, "ms": round(1e3 * time, 1)}
            note = request.get(NOTE)
            fields["note"] = without_signatures(note) if note else None
            log.event("request", **fields, **request.get(FACTS, {}))

    return RequestLog


def _route_of(request: web.BaseRequest) -> str:
    """The route's template, as the label of metrics."""
    if not isinstance(request, web.Request) or request.method == NOT_HTTP:
        return "unmatched"
    resource = request.match_info.route.resource
    return "unmatched" if resource is None else resource.canonical.removeprefix(SIGNED)
