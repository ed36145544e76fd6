"""GET /v1/streams/{stream}/play: one response, slice by slice, the server choosing the layers.

Rule: a play ends at a slice boundary, with a record that says whether it is complete.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from aiohttp import web

from codec.errors import SwingsError
from codec.stream.integrity import CheckedObject
from codec.stream.manifest import MASKS, Part, snapshot_part
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
from server.abr.policy import FixedPolicy, LayerPolicy, Policy
from server.abr.session import (
    Finished,
    PlaySession,
    SendSlice,
    SendSnapshots,
    WaitForFrames,
    WaitUntil,
)

from .connection import Connection, StalledError
from .errors import RequestError
from .library import ServedStream
from .state import STATE, ServerState, find_stream

log = logging.getLogger(__name__)

RETRY_AFTER_S = 5
"""Seconds after which a client that was refused may try again."""

MAX_FRAME = 2**31 - 1

SNAPSHOTS_BYTES = 1 << 20
"""Bytes of snapshots after which a record ends, and the next layer goes into another one."""


@dataclass(frozen=True, slots=True)
class PlayQuery:
    """What the query string asks for."""

    from_frame: int
    until_frame: int | None
    """First frame that is not wanted; None for all."""
    num_layers: int | None
    """A fixed number of layers; None for the server's choice."""


def parse_query(
    pairs: Iterable[tuple[str, str]], num_frames: int, live: bool, num_layers: int
) -> PlayQuery:
    """The checked query. Raises RequestError 400 that says what is allowed."""
    values: dict[str, str] = {}
    for key, value in pairs:
        if key not in ("from", "until", "layers") or key in values:
            raise RequestError(
                400, f"play takes from, until and layers once each, not {key[:40]!r}"
            )
        values[key] = value
    from_frame = _number("from", values["from"]) if "from" in values else 0
    # A live stream may be joined before it has its first segment.
    if from_frame >= (num_frames or int(live)):
        raise RequestError(400, f"from={from_frame}: the stream has {num_frames} frames, from 0 on")
    until_frame = _number("until", values["until"]) if "until" in values else None
    if until_frame is not None and until_frame <= from_frame:
        raise RequestError(400, f"until={until_frame} must be greater than from={from_frame}")
    layers = values.get("layers", "auto")
    if layers == "auto":
        return PlayQuery(from_frame, until_frame, None)
    fixed = _number("layers", layers)
    if not 1 <= fixed <= num_layers:
        raise RequestError(400, f"layers={fixed}: give auto or 1 to {num_layers}")
    return PlayQuery(from_frame, until_frame, fixed)


def _number(key: str, text: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) <= 10 and int(text) <= MAX_FRAME):
        raise RequestError(400, f"{key}={text[:40]!r} is not a number from 0 to {MAX_FRAME}")
    return int(text)


async def play(request: web.Request) -> web.StreamResponse:
    stream = await find_stream(request)
    state = request.app[STATE]
    num_layers = stream.view.manifest.num_layers
    query = parse_query(request.query.items(), stream.num_frames, stream.live, num_layers)
    if state.stopping.is_set():
        raise RequestError(503, "the server is stopping", {"Retry-After": str(RETRY_AFTER_S)})
    if state.active_plays >= state.config.max_plays:
        message = f"the server has {state.active_plays} plays, its most; try again later"
        raise RequestError(503, message, {"Retry-After": str(RETRY_AFTER_S)})
    running = _Play(request, state, stream, query)
    outcome = "failed"
    state.active_plays += 1
    state.metrics.active_plays.set(state.active_plays)
    try:
        outcome = await running.run()
    except StalledError:
        outcome = "stalled"
        raise
    except ConnectionError:
        outcome = "gone"
        raise
    finally:
        state.active_plays -= 1
        state.metrics.active_plays.set(state.active_plays)
        state.metrics.plays.add(1, outcome)
    return running.response


class _Play:
    """One play in progress."""

    def __init__(
        self, request: web.Request, state: ServerState, stream: ServedStream, query: PlayQuery
    ) -> None:
        policy: Policy = FixedPolicy(query.num_layers) if query.num_layers else LayerPolicy()
        self.response = web.StreamResponse(
            headers={"Content-Type": CONTENT_TYPE, "Cache-Control": "no-store"}
        )
        self._state = state
        self._stream = stream
        self._connection = Connection(request, state.config.write_timeout_s)
        self._from_frame = query.from_frame
        self._clock = asyncio.get_running_loop().time
        self._session = PlaySession(
            stream,
            policy,
            state.config.session,
            self._clock(),
            query.from_frame,
            query.until_frame,
        )
        self._segment = -1
        self._objects: dict[Part, CheckedObject] = {}

    async def run(self) -> str:
        """Sends the whole play; gives how it ended."""
        self._connection.keep_queue_short(self._state.config.send_queue_bytes)
        await self._connection.prepare(self.response)
        view = self._stream.view
        await self._send(StartRecord(self._from_frame, view.num_frames, view.manifest_json))
        try:
            outcome, last = await self._send_slices()
        except (SwingsError, OSError) as error:
            if isinstance(error, ConnectionError):
                raise
            log.error("play of %s ended: %s", self._stream.name, error)
            outcome, last = "damaged", ErrorRecord("this stream is damaged on the server")
        await self._send(last)
        return outcome

    async def _send_slices(self) -> tuple[str, Record]:
        """Sends slices until there is a reason to stop; gives it, and the last record."""
        waiting_since_s: float | None = None
        while True:
            now_s = self._clock()
            if self._connection.gone:
                raise ConnectionResetError("the client has gone")
            if self._state.stopping.is_set():
                return "stopped", self._broken_off("the server is stopping")
            match self._session.decide(now_s, self._connection.queued_bytes()):
                case SendSlice(birth=birth, num_layers=num_layers):
                    waiting_since_s = None
                    await self._send_slice(birth, num_layers)
                case SendSnapshots() as send:
                    waiting_since_s = None
                    await self._send_snapshots(send)
                case WaitUntil(time_s=time_s):
                    await self._pause(time_s - now_s)
                case WaitForFrames():
                    waiting_since_s = now_s if waiting_since_s is None else waiting_since_s
                    if now_s - waiting_since_s > self._state.config.live_idle_s:
                        return "idle", self._broken_off("no new frames have come for a long time")
                    await self._pause(self._state.config.refresh_s)
                    await self._state.library.refresh(self._stream, self._clock())
                case Finished():
                    return "complete", EndRecord(self._stream.num_frames)

    def _broken_off(self, reason: str) -> ErrorRecord:
        resume_frame = max(self._from_frame, self._session.next_birth)
        return ErrorRecord(f"{reason}; play again from frame {resume_frame}")

    async def _send_slice(self, birth: int, num_layers: int) -> None:
        segment = self._stream.view.manifest.segment_of(birth)
        if segment != self._segment:
            self._segment, self._objects = segment, {}
        parts: list[Part] = [*range(num_layers), *([MASKS] if self._stream.has_slots else [])]
        for part in parts:
            if part not in self._objects:
                loaded = await self._state.cache.load(self._stream, segment, part)
                self._objects[part] = loaded
        packets = [self._objects[part].packet(birth) for part in parts]
        mask = packets[num_layers] if self._stream.has_slots else None
        await self._send(SliceRecord(birth, tuple(packets[:num_layers]), mask))
        self._state.metrics.slices.add(1, str(num_layers))
        self._count(parts, packets)

    async def _send_snapshots(self, send: SendSnapshots) -> None:
        """Sends the snapshots in records of not much more than SNAPSHOTS_BYTES."""
        segment = self._stream.view.manifest.segment_of(send.frame)
        first, packets = send.first_layer, list[bytes]()
        for layer in range(send.first_layer, send.num_layers):
            part = snapshot_part(layer)
            loaded = await self._state.cache.load(self._stream, segment, part)
            packets.append(loaded.packet(send.frame))
            if sum(map(len, packets)) < SNAPSHOTS_BYTES and layer + 1 < send.num_layers:
                continue
            await self._send(SnapshotRecord(send.frame, first, tuple(packets)))
            self._count([snapshot_part(n) for n in range(first, layer + 1)], packets)
            first, packets = layer + 1, []

    def _count(self, parts: Sequence[Part], packets: Sequence[bytes]) -> None:
        for part, packet in zip(parts, packets, strict=True):
            self._state.metrics.layer_bytes.add(len(packet), "play", str(part))

    async def _send(self, record: Record) -> None:
        data = encode_record(record)
        self._session.sending(len(data), self._clock(), self._connection.queued_bytes())
        await self._connection.send(self.response, data)

    async def _pause(self, seconds: float) -> None:
        """Waits, but not longer than the server runs."""
        try:
            async with asyncio.timeout(seconds):
                await self._state.stopping.wait()
        except TimeoutError:
            pass
