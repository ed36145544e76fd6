"""GET /v1/streams/{stream}/play: one response, in which the server chooses what comes next.

Rule: a play ends between two records, with one that says whether it is complete.
"""

from __future__ import annotations

import asyncio
import logging
import random
import re
import secrets
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from aiohttp import web

from codec.errors import SwingsError
from codec.stream.integrity import CheckedObject
from codec.stream.manifest import MASKS, Part, snapshot_part
from codec.stream.plainrecord import CODINGS, PlainRecordEncoder
from codec.stream.playrecord import (
    CONTENT_TYPE,
    EndRecord,
    ErrorRecord,
    Record,
    SliceRecord,
    SnapshotRecord,
    StartRecord,
    encode_record,
)
from server.abr.outlook import SendSlices, SendSnapshots
from server.abr.policies.choice import fixed_policy, own_policy
from server.abr.session import (
    Finished,
    PlaySession,
    WaitForFrames,
    WaitForNews,
    WaitUntil,
)
from server.abr.standing import PLAY_HEADER, Standing

from .client.connection import Connection, StalledError
from .client.tcpinfo import TcpInfo
from .errors import RequestError
from .library import ServedStream
from .state import STATE, ServerState, find_stream

log = logging.getLogger(__name__)

RETRY_AFTER_S = 5
"""Seconds after which a client that was refused may try again."""

MAX_FRAME = 2**31 - 1

SNAPSHOTS_BYTES = 1 << 20
"""Bytes of snapshots after which a record ends, and the next layer goes into another one."""

LIVE_POLL_S = 0.1
"""How often a play at the end of a live stream looks whether it has grown, seconds."""

TCP_INFO_S = 1.0
"""How often a play asks the kernel about its connection, for the log, seconds: a connection that
is closed does not tell."""


@dataclass(frozen=True, slots=True)
class PlayQuery:
    """What the query string asks for."""

    from_frame: int
    until_frame: int | None
    """First frame that is not wanted; None for all."""
    num_layers: int | None
    """A fixed number of layers; None for the server's choice."""
    plain: bool = False
    """Whether packets come as what is in them, see codec.stream.plainrecord."""
    paused: bool = False
    """Whether the client begins with a still picture."""


def parse_query(
    pairs: Iterable[tuple[str, str]], num_frames: int, live: bool, num_layers: int
) -> PlayQuery:
    """The checked query. Raises RequestError 400 that says what is allowed."""
    values: dict[str, str] = {}
    for key, value in pairs:
        if key not in ("from", "until", "layers", "plain", "paused") or key in values:
            raise RequestError(
                400, f"play takes from, until, layers, plain and paused once each, not {key[:40]!r}"
            )
        values[key] = value
    plain, paused = (_flag(key, values.get(key, "0")) for key in ("plain", "paused"))
    from_frame = _number("from", values["from"]) if "from" in values else 0
    # A live stream may be joined before it has its first segment.
    if from_frame >= (num_frames or int(live)):
        raise RequestError(400, f"from={from_frame}: the stream has {num_frames} frames, from 0 on")
    until_frame = _number("until", values["until"]) if "until" in values else None
    if until_frame is not None and until_frame <= from_frame:
        raise RequestError(400, f"until={until_frame} must be greater than from={from_frame}")
    layers = values.get("layers", "auto")
    if layers == "auto":
        return PlayQuery(from_frame, until_frame, None, plain, paused)
    fixed = _number("layers", layers)
    if not 1 <= fixed <= num_layers:
        raise RequestError(400, f"layers={fixed}: give auto or 1 to {num_layers}")
    return PlayQuery(from_frame, until_frame, fixed, plain, paused)


def body_coding(accepted: str) -> str:
    """The best coding of a plain body that an Accept-Encoding allows (RFC 9110, 12.5.3); nothing
    for none."""
    weights = {}
    for entry in accepted.split(","):
        name, _, weight = (part.strip().lower() for part in entry.partition(";"))
        weights[name] = weight
    for coding in CODINGS:
        if coding in weights and not re.fullmatch(r"q\s*=\s*0(\.0*)?", weights[coding]):
            return coding
    return ""


def _number(key: str, text: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) <= 10 and int(text) <= MAX_FRAME):
        raise RequestError(400, f"{key}={text[:40]!r} is not a number from 0 to {MAX_FRAME}")
    return int(text)


def _flag(key: str, text: str) -> bool:
    if text not in ("0", "1"):
        raise RequestError(400, f"{key}={text[:40]!r}: give 0 or 1")
    return text == "1"


def _figure(value: float | None, scale: float) -> str:
    """`value`, scaled, for the log; a dash where it is not known."""
    return "-" if value is None else f"{value * scale:.1f}"


async def play(request: web.Request) -> web.StreamResponse:
    stream = await find_stream(request)
    state = request.app[STATE]
    num_layers = stream.view.manifest.num_layers
    query = parse_query(request.query.items(), stream.num_frames, stream.live, num_layers)
    if state.stopping.is_set():
        raise RequestError(503, "the server is stopping", {"Retry-After": str(RETRY_AFTER_S)})
    if len(state.plays) >= state.config.max_plays:
        message = f"the server has {len(state.plays)} plays, its most; try again later"
        raise RequestError(503, message, {"Retry-After": str(RETRY_AFTER_S)})
    running = _Play(request, state, stream, query)
    outcome = "failed"
    state.metrics.active_plays.set(len(state.plays))
    try:
        outcome = await running.run()
    except StalledError:
        outcome = "stalled"
        raise
    except ConnectionError:
        outcome = "gone"
        raise
    finally:
        running.end(outcome)
        state.metrics.active_plays.set(len(state.plays))
        state.metrics.plays.add(1, outcome)
    return running.response


class _Play:
    """One play in progress."""

    def __init__(
        self, request: web.Request, state: ServerState, stream: ServedStream, query: PlayQuery
    ) -> None:
        layers = query.num_layers
        policy = own_policy(stream) if layers is None else fixed_policy(layers)
        self._token = token = secrets.token_urlsafe(16)
        headers = {"Content-Type": CONTENT_TYPE, "Cache-Control": "no-store", PLAY_HEADER: token}
        self._plain: PlainRecordEncoder | None = None
        if query.plain:
            coding = body_coding(",".join(request.headers.getall("Accept-Encoding", [])))
            headers |= {"Content-Encoding": coding} if coding else {}
            self._plain = PlainRecordEncoder(coding)
        self.response = web.StreamResponse(headers=headers)
        self._state = state
        self._stream = stream
        self._connection = Connection(request, state.config.write_timeout_s)
        self._from_frame = query.from_frame
        self._clock = asyncio.get_running_loop().time
        self._began_s = now_s = self._clock()
        last_rate_bps = state.plays.rate_bps(request.headers.get(PLAY_HEADER, ""), now_s)
        self._session = PlaySession(
            stream,
            policy,
            state.config.session,
            now_s,
            query.from_frame,
            query.until_frame,
            last_rate_bps,
            # Clients that begin together, as at the start of a show, shall not burst in step.
            rest_share=random.random(),
        )
        if query.paused:
            self._session.told(now_s, Standing(query.from_frame, paused=True))
        self._objects: dict[tuple[int, Part], CheckedObject] = {}
        self._sent_slices = 0
        self._sent_layers = 0
        self._tcp_info = TcpInfo()
        self._tcp_info_s = now_s  # when it is due
        self._entry = state.plays.begin(token, stream.name)

    def end(self, outcome: str) -> None:
        """Gives the place free, and says how the play went."""
        now_s, session, tcp = self._clock(), self._session, self._tcp_info
        self._state.plays.end(self._token, now_s)
        log.info(
            "play of %s: %s, %.1f s, %d bytes, %.2f layers; Mbit/s: %s estimated, %s by TCP; "
            "latency: %s ms, round trip %s ms by TCP",
            self._stream.name,
            outcome,
            now_s - self._began_s,
            session.sent_bytes,
            self._sent_layers / max(1, self._sent_slices),
            _figure(session.rate_bps, 1e-6),
            _figure(tcp.delivery_rate_bps, 1e-6),
            _figure(session.least_latency_s, 1e3),
            _figure(tcp.min_rtt_s, 1e3),
        )

    async def run(self) -> str:
        """Sends the whole play; gives how it ended."""
        self._connection.keep_queue_short(self._state.config.send_queue_bytes)
        await self._connection.prepare(self.response)
        view = self._stream.view
        start = StartRecord(self._from_frame, view.num_frames, view.manifest_json)
        await self._connection.send(self.response, self._encode(start))
        try:
            outcome, last = await self._send_slices()
        except (SwingsError, OSError) as error:
            if isinstance(error, ConnectionError):
                raise
            log.error("play of %s ended: %s", self._stream.name, error)
            outcome, last = "damaged", ErrorRecord("this stream is damaged on the server")
        await self._connection.send(self.response, self._encode(last, last=True))
        return outcome

    async def _send_slices(self) -> tuple[str, Record]:
        """Sends packets until there is a reason to stop; gives it, and the last record."""
        waiting_since_s: float | None = None
        config = self._state.config
        while True:
            now_s = self._clock()
            if self._connection.gone:
                raise ConnectionResetError("the client has gone")
            if self._state.stopping.is_set():
                return "stopped", self._broken_off("the server is stopping")
            self._hear(now_s)
            decision = self._session.decide(now_s)
            if not isinstance(decision, WaitForFrames):
                waiting_since_s = None
            match decision:
                case SendSlices() as send:
                    await self._send_layers(send)
                case SendSnapshots() as send:
                    await self._send_snapshots(send)
                case WaitForNews():
                    await self._pause(config.poll_s)
                case WaitUntil(time_s=time_s):
                    busy = self._session.queued_bytes > 0
                    await self._pause(config.poll_s if busy else max(0.0, time_s - now_s))
                case WaitForFrames():
                    waiting_since_s = now_s if waiting_since_s is None else waiting_since_s
                    if now_s - waiting_since_s > config.live_idle_s:
                        return "idle", self._broken_off("no new frames have come for a long time")
                    await self._pause(config.poll_s if self._session.queued_bytes else LIVE_POLL_S)
                case Finished():
                    return "complete", EndRecord(self._stream.num_frames)

    def _hear(self, now_s: float) -> None:
        """Tells the session what of its bytes the client's side has, and what the client says."""
        session, entry = self._session, self._entry
        queued = self._connection.queued_bytes()
        session.acknowledge(self._clock(), session.sent_bytes - queued)
        entry.rate_bps = session.rate_bps
        news = entry.take_news()
        if news is not None:
            session.told(self._clock(), news)
        if now_s >= self._tcp_info_s:
            self._tcp_info = self._connection.tcp_info() or self._tcp_info
            self._tcp_info_s = now_s + TCP_INFO_S

    def _broken_off(self, reason: str) -> ErrorRecord:
        resume_frame = max(self._from_frame, self._session.holding.end_frame)
        return ErrorRecord(f"{reason}; play again from frame {resume_frame}")

    async def _object(self, birth: int, part: Part) -> CheckedObject:
        """The object that holds the packet of `birth`. It is kept at hand for as long as the client
        shows frames of its segment: the lead bounds how many there are."""
        manifest = self._stream.view.manifest
        segment = manifest.segment_of(birth)
        found = self._objects.get((segment, part))
        if found is None:
            found = await self._state.cache.load(self._stream, segment, part)
            oldest = manifest.segment_of(self._session.next_frame - manifest.swin_size + 1)
            self._objects = {key: kept for key, kept in self._objects.items() if key[0] >= oldest}
            self._objects[segment, part] = found
        return found

    async def _send_layers(self, send: SendSlices) -> None:
        layers: list[Part] = [*range(send.first_layer, send.end_layer)]
        masked = self._stream.has_slots and not send.first_layer
        for birth in send.births:
            parts = [*layers, MASKS] if masked else layers
            packets = [(await self._object(birth, part)).packet(birth) for part in parts]
            mask = packets[-1] if masked else None
            record = SliceRecord(birth, tuple(packets[: len(layers)]), mask, send.first_layer)
            one = SendSlices(range(birth, birth + 1), send.first_layer, send.end_layer)
            await self._send_part(one, record)
            self._count(parts, packets)
            self._sent_slices += not send.first_layer
            self._sent_layers += len(layers)

    async def _send_snapshots(self, send: SendSnapshots) -> None:
        """Sends the snapshots in records of not much more than SNAPSHOTS_BYTES."""
        first, packets = send.first_layer, list[bytes]()
        for layer in range(send.first_layer, send.end_layer):
            part = snapshot_part(layer)
            segment = self._stream.view.manifest.segment_of(send.frame)
            snapshot = await self._state.cache.load(self._stream, segment, part)
            packets.append(snapshot.packet(send.frame))
            if sum(map(len, packets)) < SNAPSHOTS_BYTES and layer + 1 < send.end_layer:
                continue
            one = SendSnapshots(send.frame, first, layer + 1)
            await self._send_part(one, SnapshotRecord(send.frame, first, tuple(packets)))
            self._count([snapshot_part(n) for n in range(first, layer + 1)], packets)
            first, packets = layer + 1, []

    async def _send_part(self, send: SendSlices | SendSnapshots, record: Record) -> None:
        """Sends a record that is what the session has decided, or a part of it."""
        data = self._encode(record)
        self._session.sent(send, len(data), self._clock())
        await self._connection.send(self.response, data)

    def _count(self, parts: Sequence[Part], packets: Sequence[bytes]) -> None:
        for part, packet in zip(parts, packets, strict=True):
            self._state.metrics.packets.add(1, str(part))
            self._state.metrics.layer_bytes.add(len(packet), "play", str(part))

    def _encode(self, record: Record, last: bool = False) -> bytes:
        if self._plain is None:
            return encode_record(record)
        return self._plain.encode(record, last)

    async def _pause(self, seconds: float) -> None:
        """Waits, but not longer than the server runs."""
        try:
            async with asyncio.timeout(seconds):
                await self._state.stopping.wait()
        except TimeoutError:
            pass
