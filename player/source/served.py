"""A stream that a swings server plays: one response, in the layers and the order it chooses, whose
records become packets.

Rule: layer 0 of the slices comes without a gap, whatever happens to the connections; a new one may
repeat some.
"""

from __future__ import annotations

import json
import random
import re
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import replace

from codec.errors import CodecError, CorruptError
from codec.framerange import FrameRange
from codec.stream.manifest import SKIP_MAPS, Manifest, Part, keyframe_part
from codec.stream.playrecord import (
    CONTENT_TYPE,
    EndRecord,
    ErrorRecord,
    KeyframeRecord,
    Record,
    RecordParser,
    SliceRecord,
    StartRecord,
)
from codec.stream.segment import INDEX_NAME, record_bytes
from player.network.fetch import (
    FetchConfig,
    Fetcher,
    FetchError,
    Response,
    Retry,
    RetryConfig,
    StoppedError,
)
from player.network.http import IdleLimit
from player.network.target import BrokenError
from server.abr.clientstatus import (
    FRAME_HEADER,
    MAX_POINTS,
    NUM_FRAMES_HEADER,
    PLAY_HEADER,
    RATE_HEADER,
    REPORT_HEADER,
    TOKEN,
    ClientStatus,
    parse_frame,
    parse_rate,
    parse_report_s,
)

from .hosted import REPLACED
from .sizelimits import SizeLimits
from .source import (
    NO_PLAY,
    REPORT_S,
    Blame,
    KeyframePackets,
    LastPlay,
    Packets,
    SlicePackets,
    check_frames,
    check_layers,
)

KEPT_BIRTHS = 1 << 14
"""Slices behind the newest one of which is known what came; what comes of older ones is of no
use."""


class PlayReceiver:
    """Checks what the records of one stream bring against its manifest, and against each other."""

    def __init__(self, name: str, manifest: Manifest, num_layers: int, frames: FrameRange) -> None:
        """num_layers: the most that may come."""
        self._name = name
        self._manifest = manifest
        self._num_layers = num_layers
        self._first_frame = self._asked_frame = frames.first
        self.next_birth = manifest.slot_layout.segment_start(frames.first)
        """The first birth of which layer 0 has not come."""
        self._joined = False
        self._limits = SizeLimits(manifest)
        self._oldest = self.next_birth
        self._end = frames.end
        # Layers that have arrived, one bit for each, by birth and by frame.
        self._slices: dict[int, int] = {}
        self._keyframes: dict[int, int] = {}

    def rejoin(self, num_frames: int) -> int:
        """The frame to ask for after a break, of a stream of `num_frames` frames."""
        # At the edge of a live stream the next frame is not there yet.
        self._joined = False
        self._asked_frame = max(min(self.next_birth, num_frames - 1), self._first_frame)
        return self._asked_frame

    def ingest(self, record: SliceRecord | KeyframeRecord) -> Packets | None:
        """Packets of `record`; None if they came already, or were not requested.
        Raises a CodecError that names what is wrong."""
        end_layer = record.first_layer + len(record.packets)
        if end_layer > self._num_layers:
            what = "a keyframe" if isinstance(record, KeyframeRecord) else "a slice"
            raise CorruptError(
                f"{self._name}: {what} has layer {end_layer - 1}; this play has {self._num_layers} "
                "layers"
            )
        if isinstance(record, KeyframeRecord):
            return self._ingest_keyframes(record)
        return self._ingest_slice(record)

    def _ingest_keyframes(self, record: KeyframeRecord) -> Packets | None:
        manifest, frame = self._manifest, record.frame
        if frame % manifest.segment_frames:
            raise CorruptError(
                f"{self._name}: a keyframe of frame {frame} arrived, which does not begin a segment"
            )

        def blame(error: CodecError, part: Part) -> CodecError:
            layer = str(part).rpartition("-")[2]
            return error.within(f"{self._name}: layer {layer} of the keyframe of frame {frame}")

        numbered = enumerate(record.packets, record.first_layer)
        self._check_packets([(keyframe_part(layer), packet) for layer, packet in numbered], blame)
        if not self._joined:
            first = manifest.slot_layout.segment_start(self._asked_frame)
            if record.first_layer or frame != first:
                raise CorruptError(
                    f"{self._name}: the play begins with layer {record.first_layer} of the "
                    f"keyframe of frame {frame}, not with layer 0 of the keyframe of frame {first}"
                )
            self._joined = True
            self.next_birth = max(self.next_birth, frame + 1)
        if not self._is_asked(frame):
            return None
        first_layer, packets = _fresh(self._keyframes, frame, record)
        return KeyframePackets(frame, first_layer, packets, blame) if packets else None

    def _ingest_slice(self, record: SliceRecord) -> Packets | None:
        birth = record.birth
        what = f"the slice born at {birth}"
        if not self._joined:
            raise CorruptError(f"{self._name}: {what} arrived before a keyframe")
        if self._end is not None and birth >= self._end:
            raise CorruptError(
                f"{self._name}: {what} arrived, but the play ends before frame {self._end}"
            )

        def blame(error: CodecError, part: Part) -> CodecError:
            place = "the skip map" if part == SKIP_MAPS else f"layer {part}"
            return error.within(f"{self._name}: {place} of {what}")

        parts: list[tuple[Part, bytes]] = [*enumerate(record.packets, record.first_layer)]
        if record.skip_map is not None:
            parts.append((SKIP_MAPS, record.skip_map))
        self._check_packets(parts, blame)
        if record.first_layer == 0:
            if birth > self.next_birth:
                raise CorruptError(
                    f"{self._name}: {what} arrived before the slice born at {self.next_birth}"
                )
            if record.skip_map is None:
                raise CorruptError(f"{self._name}: {what} has no skip map")
            if not record.packets:
                raise CorruptError(f"{self._name}: {what} has no layers")
            self.next_birth = max(self.next_birth, birth + 1)
            self._forget()
        if not self._is_asked(birth):
            return None
        first_layer, packets = _fresh(self._slices, birth, record)
        skip_map = None if first_layer else record.skip_map
        return SlicePackets(birth, first_layer, packets, skip_map, blame) if packets else None

    def _check_packets(self, parts: list[tuple[Part, bytes]], blame: Blame) -> None:
        for part, packet in parts:
            try:
                self._limits.check_packet(packet, part)
            except CodecError as error:
                raise blame(error, part) from error

    def _is_asked(self, birth: int) -> bool:
        """Whether a slice, or a keyframe, of `birth` is neither too old nor far too early."""
        manifest = self._manifest
        ahead = max(manifest.swin_size, 2 * manifest.segment_frames)
        return self._oldest <= birth < self.next_birth + ahead

    def _forget(self) -> None:
        """Drops what is known of slices that are too old to be of use."""
        while self._oldest < self.next_birth - KEPT_BIRTHS:
            self._slices.pop(self._oldest, None)
            self._keyframes.pop(self._oldest, None)
            self._oldest += 1


def _fresh(
    arrived: dict[int, int], at: int, record: SliceRecord | KeyframeRecord
) -> tuple[int, tuple[bytes, ...]]:
    """Notes that the packets of `record`, born `at`, have arrived. Gives the first layer and the
    packets from the first one that had not to the last one; some between them may have."""
    first_layer, packets, before = record.first_layer, record.packets, arrived.get(at, 0)
    arrived[at] = before | ((1 << len(packets)) - 1) << first_layer
    fresh = [n for n in range(len(packets)) if not before >> (first_layer + n) & 1]
    if not fresh:
        return first_layer, ()
    return first_layer + fresh[0], packets[fresh[0] : fresh[-1] + 1]


LOOK_S = 5.0
"""How often it is looked whether the playback is paused while nothing comes, seconds."""

MAX_REFUSAL_BYTES = 1 << 16
"""Longest body of an answer that is not a play, bytes."""

STATUS_FETCH = FetchConfig(connect_timeout_s=5.0, idle_s=5.0)
"""Limits of a status report: an older one is not worth waiting for."""


class ReceivedPoints:
    """When a client had how much of a play's body, for `ClientStatus.received`.

    One thread adds, another one takes.
    """

    def __init__(self) -> None:
        self._points: list[tuple[int, int]] = []
        self._num_bytes = 0
        self._lock = threading.Lock()

    def add(self, now_s: float, num_bytes: int) -> None:
        """`num_bytes` more have come."""
        with self._lock:
            self._num_bytes += num_bytes
            self._points.append((round(1e3 * now_s), self._num_bytes))
            if len(self._points) > MAX_POINTS:
                del self._points[:-1:2]  # every other one; the newest stays

    def take(self) -> tuple[tuple[int, int], ...]:
        """The points added since the last call."""
        with self._lock:
            points, self._points = self._points, []
        return tuple(points)


class ServedSource:
    """The /play response of a server; reconnects at the next slice when it breaks."""

    def __init__(
        self,
        name: str,
        urls: str | Sequence[str],
        fetcher: Fetcher,
        frames: FrameRange,
        layers: int | None,
        retry: RetryConfig | None = None,
        last_play: LastPlay = NO_PLAY,
        adaptive: bool = True,
    ) -> None:
        """Connects, and reads the manifest.

        urls: of the stream on one or more servers, to which /play is added. fetcher: is closed
        together with the source. layers: None leaves the choice to the server, or takes all where
        it is not adaptive. last_play: the one before this.
        """
        self.name = name
        self._urls = [urls] if isinstance(urls, str) else [*urls]
        self._fetcher = fetcher
        self._retry_config = retry or RetryConfig()
        self.adaptive = adaptive and layers is None
        self._asked_layers = "auto" if self.adaptive else layers or "all"
        self._asked = frames
        self._response: Response | None = None
        self._token = last_play.token  # a server that takes no reports gives none
        self._rate_bps = last_play.rate_bps  # only `send_status` changes it
        self._ended_play = ""
        self._received = ReceivedPoints()
        self.report_s = REPORT_S
        self._told_frames = 0  # only `send_status` changes it
        self._reported_frame: int | None = None  # the next one to show, as last reported
        self._identity = b""  # only `send_status` changes it
        self._idle = IdleLimit(fetcher.config.idle_s, time.monotonic())
        self._paused = False  # only `send_status` changes it
        self._parser = RecordParser()
        self._waiting: list[Record] = []
        try:
            start = self._connect_any(frames.first)
            self.manifest = self._manifest_of(start)
            self.num_layers = check_layers(layers, self.manifest, name)
            self._num_frames = start.num_frames
            self.frames = check_frames(frames, self.manifest, self._num_frames, name)
            self._limits = SizeLimits(self.manifest)
            self._parser.limit_bytes = self._limits.record_bytes
            self._receiver = PlayReceiver(name, self.manifest, self.num_layers, self.frames)
            self._status_fetcher = fetcher.another(STATUS_FETCH)
        except BaseException:
            self._disconnect()
            raise

    @property
    def play(self) -> LastPlay:
        return LastPlay(self._token, self._rate_bps)

    @property
    def num_frames(self) -> int:
        return max(self._num_frames, self._told_frames, self._receiver.next_birth)

    @property
    def received_bytes(self) -> int:
        return self._fetcher.received_bytes

    @property
    def _url(self) -> str:
        """URL of the stream on the current server."""
        return self._urls[0]

    def _connect(self, frame: int) -> StartRecord:
        """Asks for the slices that show from `frame` on; gives the first record."""
        url = f"{self._url}/play?from={frame}&layers={self._asked_layers}&reports=1"
        if self._asked.end is not None:
            url += f"&until={self._asked.end}"
        self._disconnect()
        headers = self.play.headers()
        if self._reported_frame is not None:
            # Else the server would send a whole lead beyond the one that is here.
            headers[FRAME_HEADER] = str(self._reported_frame)
        self._response = response = self._fetcher.open(url, headers)
        self._parser, self._waiting = RecordParser(), []
        self._received = ReceivedPoints()
        self._idle.useful(time.monotonic())
        if response.status != 200:
            raise self._refusal(response)
        if response.content_type.partition(";")[0].strip() != CONTENT_TYPE:
            raise FetchError(
                f"{self.name} is not a stream: the server sent {response.content_type}"
            )
        token = response.headers.get(PLAY_HEADER, "")
        self._token = token if re.fullmatch(TOKEN, token) else ""
        self._set_report_s(response)
        record = self._next_record()
        if not isinstance(record, StartRecord):
            raise CorruptError(f"{self.name}: the response does not begin with a start record")
        self._idle.useful(time.monotonic())
        return record

    def _connect_any(self, frame: int) -> StartRecord:
        """The same on the first server that answers."""
        for _ in self._urls[1:]:
            try:
                return self._connect(frame)
            except BrokenError:
                self._urls.append(self._urls.pop(0))
        return self._connect(frame)

    def _refusal(self, response: Response) -> FetchError:
        """The error for an answer that is not 200, with the server's own words if it has some."""
        reason = f"HTTP {response.status}"
        try:
            said = json.loads(response.rest(MAX_REFUSAL_BYTES))["error"]
        except (ValueError, RecursionError, KeyError, TypeError, FetchError):
            said = None  # another server's error page: its status says enough
        if isinstance(said, str):
            reason += f", {said[:200]}"
        if response.status >= 500 or response.status == 429:
            return BrokenError(f"{self.name}: {reason}", response.retry_after_s)
        if response.status == 404:
            return FetchError(f"{self.name} is not a stream: {reason}")
        return FetchError(f"{self.name}: {reason}")

    def _first_record(self, fetcher: Fetcher) -> bytes:
        """The index's record of segment 0, which no other stream has; none if it is not known."""
        num_bytes = record_bytes(self.manifest.num_layers)
        asked = {"Range": f"bytes=0-{num_bytes - 1}"}
        found = b""
        with closing(fetcher.open(f"{self._url}/{INDEX_NAME}", asked)) as response:
            if response.status not in (200, 206):
                return b""
            for piece in response.pieces():
                found += piece
                if len(found) >= num_bytes:
                    return found[:num_bytes]
        return b""

    def _manifest_of(self, start: StartRecord) -> Manifest:
        try:
            return Manifest.from_json(start.manifest)
        except CodecError as error:
            raise error.within(self.name) from error

    def _next_record(self) -> Record:
        """The next record. Raises BrokenError when the response ends before it, or when it is the
        server's word that the play broke off."""
        assert self._response is not None
        while not self._waiting:
            piece = self._piece()
            if not piece:
                raise BrokenError(f"{self.name}: the response ended early")
            try:
                self._waiting = self._parser.feed(piece)
            except CodecError as error:
                raise error.within(self.name) from error
            if self._waiting:
                self._idle.judged()
        record = self._waiting.pop(0)
        if isinstance(record, ErrorRecord):
            raise BrokenError(f"{self.name}: the server reports: {record.message}")
        return record

    def _piece(self) -> bytes:
        """The next bytes of the response. Raises BrokenError when none come, FetchError when those
        that come are of no use."""
        assert self._response is not None
        idle = self._idle
        while (left_s := idle.left_s(time.monotonic())) > 0:
            piece = self._response.read(min(left_s, LOOK_S))
            if piece is not None:
                idle.received(len(piece))
                self._received.add(time.monotonic(), len(piece))
                return piece
            if self._paused and not idle.num_bytes:
                idle.useful(time.monotonic())  # a paused player needs no data
        reason = f"{self.name}: {idle.reason(time.monotonic())}"
        raise FetchError(reason) if idle.num_bytes else BrokenError(reason)

    def packets(self) -> Iterator[Packets]:
        try:
            yield from self._packets()
        finally:
            # By the thread that reads: the next source may use the connections already.
            self._disconnect()

    def _packets(self) -> Iterator[Packets]:
        retry = Retry(self._retry_config)
        connected, receiver = True, self._receiver
        while True:
            try:
                if not connected:
                    self._reconnect()
                    connected = True
                record = self._next_record()
            except BrokenError as error:
                connected = False
                self._disconnect()
                end = self.frames.end
                if end is not None and receiver.next_birth >= end:
                    return  # layer 0 is whole; the rest is not worth another connection
                self._urls.append(self._urls.pop(0))
                now_s = time.monotonic()
                self._fetcher.pause(retry.delay_s(error, now_s, random.random()))
                continue
            if isinstance(record, EndRecord):
                end = record.num_frames
                if self._asked.end is not None:
                    end = min(end, self._asked.end)
                if receiver.next_birth < end:
                    message = f"the stream ended before frame {receiver.next_birth}"
                    raise CorruptError(f"{self.name}: {message}")
                return
            if not isinstance(record, SliceRecord | KeyframeRecord):
                raise CorruptError(f"{self.name}: a second start record arrived")
            packets = receiver.ingest(record)
            if packets is not None:
                retry.progress()
                yield packets
                # The caller may have taken its time with them.
                self._idle.useful(time.monotonic())

    def _reconnect(self) -> None:
        self._num_frames = max(self._num_frames, self._receiver.next_birth)
        # Two streams that were made alike have the same manifest.
        known = self._identity
        if known and self._first_record(self._fetcher) not in (known, b""):
            raise CorruptError(f"{self.name}: {REPLACED}")
        end = self._asked.end
        last = self._num_frames if end is None else min(self._num_frames, end)
        start = self._connect(self._receiver.rejoin(last))
        manifest = self._manifest_of(start)
        if not manifest.is_same_but_live(self.manifest):
            raise CorruptError(f"{self.name}: {REPLACED}")
        self._parser.limit_bytes = self._limits.record_bytes
        self._num_frames = max(self._num_frames, start.num_frames)

    def _disconnect(self) -> None:
        if self._response is not None:
            self._response.close()
            self._response = None

    def send_status(self, status: ClientStatus) -> bool:
        token = self._token
        if status.frame is not None:
            self._reported_frame = status.frame
        self._paused = status.paused
        status = replace(status, received=self._received.take())
        if token and token != self._ended_play:
            try:
                answer = self._status_fetcher.post(f"{self._url}/play/{token}", status.to_json())
                if answer.status == 204 and not self._identity:
                    self._identity = self._first_record(self._status_fetcher)
            except StoppedError:
                return False
            except FetchError:
                return True  # lost; the next report supersedes it
            rate_bps = parse_rate(answer.headers.get(RATE_HEADER, ""))
            self._rate_bps = rate_bps or self._rate_bps
            self._set_report_s(answer)
            # More than what came: a play is sent a few seconds ahead, and less while it is paused.
            told_frames = parse_frame(answer.headers.get(NUM_FRAMES_HEADER, "")) or 0
            self._told_frames = max(self._told_frames, told_frames)
            if answer.status == 404:
                self._ended_play = token  # the connection broke, and another play may follow
            elif answer.status == 405:
                return False
        return bool(token)

    def _set_report_s(self, response: Response) -> None:
        self.report_s = parse_report_s(response.headers.get(REPORT_HEADER, "")) or REPORT_S

    def interrupt(self) -> None:
        self._fetcher.interrupt()
        self._status_fetcher.interrupt()

    def close(self) -> None:
        self._disconnect()
        self._fetcher.close()
        self._status_fetcher.close()
