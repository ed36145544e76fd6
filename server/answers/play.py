"""GET /v1/streams/{stream}/play: one response, in which the server chooses what comes next.

Rule: a play ends between two records, with one that says whether it is complete.
"""

from __future__ import annotations

import asyncio
import logging
import math
import random
import time
from collections.abc import Sequence

from aiohttp import web

from codec.errors import SwingsError
from codec.stream.playrecord import (
    CONTENT_TYPE,
    EndRecord,
    ErrorRecord,
    Record,
    StartRecord,
    encode_record,
)
from server.abr.clientstatus import (
    FRAME_HEADER,
    PLAY_HEADER,
    RATE_HEADER,
    REPORT_HEADER,
    ClientStatus,
    parse_frame,
    parse_rate,
)
from server.abr.decisioncontext import FixedLayers, SendKeyframes, SendSlices
from server.abr.receipts import MOST_BEHIND_BYTES, REPORT_S, Receipts
from server.abr.session import Finished, PlaySession, WaitForAck, WaitForFrames, WaitUntil
from server.http.connection import TcpInfo
from server.http.content import NO_STORE, StreamedResponse
from server.http.requestlog import FACTS
from server.operate.workers import is_issued, make_token
from server.state.caches import CodedRecord
from server.state.serverstate import STATE
from server.study.choice import make_policy

from .asked import STREAM, PlayQuery, parse_query, room_for_play, stream_of, waits
from .statusreport import may_continue

log = logging.getLogger(__name__)

KEYFRAMES_BYTES = 1 << 20
"""Bytes of keyframes after which a record ends, and the next layer goes into another one."""

PLAYS_PER_REST = 100
"""For so many plays that run already a new one rests once more as long between two bursts."""

TOGETHER_BYTES = 32 * 1024
"""Bytes of records that are written in one go."""

ENOUGH_LEAD_S = 1.0
"""Lead of a client, in seconds of media, above which a busy worker serves other clients first."""

BUSY_SHARE = 0.6
"""Used share of a core above which a worker counts as busy: below the load that sheds layers."""

BUSY_LAG_S = 0.005
"""Lateness of the event loop above which a worker counts as busy, seconds."""

BUSY_FILL = 0.5
"""Seconds by which a busy worker lets a sufficient lead grow per second."""

REPLACED = "the stream was replaced or removed"

MAX_LOOK_S = 2.0
"""Longest time in which a play that cannot go on waits for the reason."""

MAX_PAUSE_S = 0.5
"""Longest time in which a play does not look around, seconds."""

REPORT_MS = str(round(1000 * REPORT_S))

TCP_INFO_S = 1.0
"""How often a play asks the kernel about its connection, for the log, seconds: a connection that
is closed has no figures."""


_OF_PROXIES = ("X-Forwarded-For", "Forwarded", "Via")
"""Fields that proxies add to a request."""


def _figure(value: float | None, scale: float) -> float | None:
    """`value`, scaled, for the log."""
    return None if value is None else round(value * scale, 1)


routes = web.RouteTableDef()


@routes.get(f"{STREAM}/play", allow_head=False)
async def play(request: web.Request) -> web.StreamResponse:
    waits(request)
    query = asked_query(request)
    with room_for_play(request, await _continues(request)):
        running = Play(request, query)
        response = StreamedResponse(request, running.headers, request.app[STATE].count_sent)
        # Nothing may wait before: its end gives back what it holds.
        await running.run(response)
        return await response.end()


def asked_query(request: web.Request) -> PlayQuery:
    """Parses the query of a play. Raises RequestError for one that cannot be played."""
    played = stream_of(request)
    num_layers, records = played.view.manifest.num_layers, played.view.records
    # A segment's start: there all that shows can be had at once.
    edge_frame = records[-1].first_frame if records else 0
    pairs = request.query.items()
    return parse_query(pairs, played.num_frames, played.live, num_layers, edge_frame)


async def _continues(request: web.Request) -> bool:
    """Whether a client without which the server is full continues an earlier play."""
    state, token = request.app[STATE], request.headers.get(PLAY_HEADER, "")
    accepts, num_plays = state.overload.accepts_plays, len(state.plays)
    if accepts(num_plays) or not accepts(num_plays, continues=True):
        return False
    return is_issued(token, state.play_secret, time.time()) and await may_continue(state, token)


class Play:
    """One play in progress."""

    def __init__(self, request: web.Request, query: PlayQuery) -> None:
        """It is registered until `run` ends."""
        state, played, asked = request.app[STATE], stream_of(request), request.headers
        layers = query.num_layers
        policy = make_policy(state.config.policy) if layers is None else FixedLayers(layers)
        # A status report may arrive at another worker, which finds this worker by the token.
        self.token = token = make_token(state.number, state.play_secret, time.time())
        self.headers = {"Content-Type": CONTENT_TYPE, "Cache-Control": NO_STORE}
        self.headers["X-Accel-Buffering"] = "no"  # nginx passes each slice on at once
        self.headers[PLAY_HEADER] = token
        self._receipts = Receipts() if query.reports else None
        self._request = request
        self._state = state
        self._stream = played
        self._from_frame = query.from_frame
        self._clock = asyncio.get_running_loop().time
        now_s = self._clock()
        # A returning client names its previous play and that play's rate, which this worker may
        # know better.
        rate_bps = state.plays.rate_bps(asked.get(PLAY_HEADER, ""), now_s)
        self._session = PlaySession(
            played,
            policy,
            state.config.pacing,
            now_s,
            query.from_frame,
            query.until_frame,
            rate_bps or parse_rate(asked.get(RATE_HEADER, "")),
            # Clients that begin together, as at the start of a show, must not burst in step. With
            # many plays, each is sent more at a time, but less often.
            rest_share=random.random() + len(state.plays) / PLAYS_PER_REST,
        )
        next_frame = parse_frame(asked.get(FRAME_HEADER, ""))
        if query.paused or next_frame is not None:
            frame = query.from_frame if next_frame is None else next_frame
            self._session.on_status(now_s, ClientStatus(frame, paused=query.paused))
        self._limited_s = now_s
        is_proxied = any(name in asked for name in _OF_PROXIES)
        if is_proxied and self._receipts is not None:
            self._session.report_s = REPORT_S
            self.headers[REPORT_HEADER] = REPORT_MS
        self._sent_slices = 0
        self._sent_layers = 0
        self._tcp_info = TcpInfo()
        self._tcp_info_s = now_s  # when it is due
        self._entry = state.plays.begin(token, played.name)
        self._entry.report_s = self._session.report_s
        state.metrics.active_plays.set(len(state.plays))

    async def run(self, response: StreamedResponse) -> None:
        """Sends the whole play."""
        self._response, self._connection = response, response.connection
        outcome = "failed"
        try:
            outcome = await self._send()
        except ConnectionError:
            outcome = self._connection.cut or "gone"
            raise
        except asyncio.CancelledError:
            outcome = self._connection.cut or "stopped"
            raise
        finally:
            self._end(outcome)

    def _end(self, outcome: str) -> None:
        """Gives its place back, and notes how it went."""
        plays, metrics = self._state.plays, self._state.metrics
        plays.end(self.token, self._clock())
        metrics.active_plays.set(len(plays))
        metrics.plays.add(1, outcome)
        session, tcp = self._session, self._tcp_info
        self._request[FACTS] = {
            "outcome": outcome,
            "layers": round(self._sent_layers / max(1, self._sent_slices), 2),
            "estimated_mbps": _figure(session.rate_bps, 1e-6),
            "tcp_mbps": _figure(tcp.delivery_rate_bps, 1e-6),
            "latency_ms": _figure(session.least_latency_s, 1e3),
            "tcp_rtt_ms": _figure(tcp.min_rtt_s, 1e3),
        }

    async def _send(self) -> str:
        """Sends the records; gives how the play ended."""
        self._connection.hold_at_most(self._state.config.send_queue_bytes)
        view = self._stream.view
        start = encode_record(StartRecord(self._from_frame, view.num_frames, view.manifest_json))
        if self._receipts is not None:
            self._receipts.start_bytes = len(start)
        await self._response.write(start)
        try:
            outcome, last = await self._send_slices()
        except ConnectionError:
            raise
        except (SwingsError, OSError) as error:
            # Perhaps there is another stream in its place, which the next look finds.
            await asyncio.sleep(min(MAX_LOOK_S, 2 * self._state.config.refresh_s))
            if self._stream.gone:
                outcome, last = "replaced", self._broken_off(REPLACED)
            else:
                log.error("play of %s ended: %s", self._stream.name, error)
                outcome, last = "damaged", ErrorRecord("this stream is damaged on the server")
        await self._response.write(encode_record(last))
        return outcome

    async def _send_slices(self) -> tuple[str, Record]:
        """Sends packets until there is a reason to stop; gives it, and the last record."""
        waiting_since_s: float | None = None
        config = self._state.config
        while True:
            now_s = self._clock()
            if self._stream.gone:
                return "replaced", self._broken_off(REPLACED)
            if self._state.stopping.is_set():
                return "stopped", self._broken_off("the server is stopping")
            self._update_session(now_s)
            self._session.max_layers = self._state.overload.max_layers(self._stream.num_layers)
            self._limit_lead(now_s)
            decision = self._session.decide(now_s)
            if not isinstance(decision, WaitForFrames):
                waiting_since_s = None
            match decision:
                case SendSlices() as send:
                    await self._send_layers(send)
                case SendKeyframes() as send:
                    await self._send_keyframes(send)
                case WaitForAck():
                    await self._pause(config.poll_s)
                case WaitUntil(time_s=time_s):
                    busy = self._session.queued_bytes > 0
                    await self._pause(config.poll_s if busy else max(0.0, time_s - now_s))
                case WaitForFrames():
                    waiting_since_s = now_s if waiting_since_s is None else waiting_since_s
                    if now_s - waiting_since_s > config.live_idle_s:
                        return "idle", self._broken_off("no new frames arrived for a long time")
                    await self._wait_for_frames()
                case Finished():
                    return "complete", EndRecord(self._stream.num_frames)

    def _update_session(self, now_s: float) -> None:
        """Passes the acknowledged bytes and the client's newest status to the session."""
        session, entry = self._session, self._entry
        status = entry.pop_status()
        took_bytes = session.sent_bytes - self._connection.queued_bytes()
        if self._receipts is not None and status is not None:
            came = self._receipts.take(status.received, session.sent_bytes, self._clock())
            if not session.report_s and took_bytes - self._receipts.came_bytes > MOST_BEHIND_BYTES:
                session.report_s = entry.report_s = REPORT_S
                session.doubt(self._clock(), self._receipts.came_bytes)
            elif session.report_s:
                for at_s, came_bytes in came:
                    session.acknowledge(at_s, came_bytes)
        if not session.report_s:
            session.acknowledge(self._clock(), took_bytes)
        entry.rate_bps = session.rate_bps
        if status is not None:
            session.on_status(self._clock(), status)
        if now_s >= self._tcp_info_s:
            self._tcp_info = self._connection.tcp_info() or self._tcp_info
            self._tcp_info_s = now_s + TCP_INFO_S

    def _broken_off(self, reason: str) -> ErrorRecord:
        resume_frame = max(self._from_frame, self._session.holding.end_frame)
        return ErrorRecord(f"{reason}; play again from frame {resume_frame}")

    async def _send_layers(self, send: SendSlices) -> None:
        coded, error = await self._state.records.slices(self._stream, send)
        first, end = send.births.start, send.births.start + len(coded)
        sent = SendSlices(range(first, end), send.first_layer, send.end_layer)
        self._session.sent_slices(sent, [len(one.data) for one in coded], self._clock())
        await self._write(coded)
        self._sent_slices += 0 if send.first_layer else len(coded)
        self._sent_layers += (send.end_layer - send.first_layer) * len(coded)
        if error is not None:
            raise error

    async def _send_keyframes(self, send: SendKeyframes) -> None:
        """Sends the keyframes in records of not much more than KEYFRAMES_BYTES."""
        frame, first, records = send.frame, send.first_layer, self._state.records
        while first < send.end_layer:
            coded = await records.keyframes(
                self._stream, frame, first, KEYFRAMES_BYTES, send.end_layer
            )
            end = first + len(coded.parts)
            one = SendKeyframes(frame, first, end)
            self._session.sent(one, len(coded.data), self._clock())
            await self._write([coded])
            first = end

    async def _write(self, coded: Sequence[CodedRecord]) -> None:
        """Writes records of the same parts, short ones together."""
        unsent = [one.data for one in coded]
        metrics = self._state.metrics
        for n, part in enumerate(coded[0].parts if coded else ()):
            num_bytes = sum(one.packet_bytes[n] for one in coded)
            metrics.packets.add(len(coded), str(part))
            metrics.layer_bytes.add(num_bytes, "play", str(part))
        while unsent:
            count, num_bytes = 0, 0
            while count < len(unsent) and num_bytes < TOGETHER_BYTES:
                num_bytes += len(unsent[count])
                count += 1
            data = b"".join(unsent[:count])
            del unsent[:count]
            await self._response.write(data)

    def _limit_lead(self, now_s: float) -> None:
        """In a busy worker, lets a sufficient lead grow only slowly, so that clients that wait for
        their first picture or have a short lead are served first."""
        state, session = self._state, self._session
        if state.busy_share <= BUSY_SHARE and state.lag_s <= BUSY_LAG_S:
            session.max_lead_s = math.inf
        elif session.max_lead_s == math.inf:
            session.max_lead_s = max(ENOUGH_LEAD_S, session.lead_s)
        else:
            session.max_lead_s += BUSY_FILL * (now_s - self._limited_s)
        self._limited_s = now_s

    async def _pause(self, seconds: float) -> None:
        """Waits, but not long: the server may stop meanwhile."""
        await asyncio.sleep(min(seconds, MAX_PAUSE_S))

    async def _wait_for_frames(self) -> None:
        if self._session.queued_bytes:
            await self._pause(self._state.config.poll_s)
        else:
            await self._stream.wait_for_growth(self._stream.view.num_segments, MAX_PAUSE_S)
