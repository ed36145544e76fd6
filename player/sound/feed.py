"""Sound ahead of the picture: a thread fetches and decodes it by segment, and each source is mixed
for a listener at the camera (`gains_of`): panned, and softer with the distance.

Rule: pure but for the thread of `SoundFeed`; `SegmentLoader` alone asks for bytes, and one thread
may put segments while another mixes. A source at a place is as in WebAudio's PannerNode with its
defaults: panned with equal power, and beyond 1 m as much softer as it is farther. The others are
heard as they are.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Container, Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
import numpy.typing as npt

from codec.camera import Camera
from codec.errors import CodecError, CorruptError, SwingsError, UnsupportedError
from codec.stream.manifest import Manifest
from codec.stream.sound import (
    MAX_PACKET_SAMPLES,
    PREROLL,
    SAMPLE_RATE,
    SoundObject,
    SoundSource,
    first_sample,
    packet_samples,
)
from codec.tracks.soundfile import PacketDecoder, Samples
from player.network.fetch import StoppedError
from player.source.soundfiles import SoundFiles

Stereo = npt.NDArray[np.float32]
"""(n, 2), left and right, -1..1."""

REFERENCE_M = 1.0
"""A source is at its full loudness up to this distance."""

Gains = tuple[float, float]
"""Gains of the left and of the right ear."""


def gains_of(source: SoundSource, time_s: float, camera: Camera) -> Gains:
    """The gains of `source` at `time_s` of the stream for a listener at `camera`, who looks along
    it."""
    place = source.position_m(time_s)
    if place is None:
        return 1.0, 1.0
    right, down, forward = camera.w2c[:3, :3] @ np.asarray(place) + camera.w2c[:3, 3]
    distance_m = math.hypot(right, down, forward)
    across_m = math.hypot(right, forward)
    # In front and behind are the same for two ears.
    azimuth = math.asin(max(-1.0, min(1.0, right / across_m))) if across_m > 1e-9 else 0.0
    share = azimuth / math.pi + 0.5
    gain = REFERENCE_M / max(distance_m, REFERENCE_M)
    return gain * math.cos(share * math.pi / 2), gain * math.sin(share * math.pi / 2)


@dataclass(frozen=True, slots=True)
class SourcePiece:
    """Some samples of one source, and how loud they are at the first and after the last."""

    samples: npt.NDArray[np.int16]
    """(n, channels)."""
    begin: Gains
    end: Gains


def mix(pieces: Sequence[SourcePiece], num_samples: int) -> Stereo:
    """The sum of `pieces`, each of `num_samples`, not limited."""
    mixed = np.zeros((num_samples, 2), np.float32)
    for piece in pieces:
        samples = piece.samples.astype(np.float32) / 32768
        if piece.begin == piece.end:
            mixed += samples * np.array(piece.begin, np.float32)
        else:
            ramp = np.linspace(piece.begin, piece.end, num_samples, endpoint=False)
            mixed += samples * ramp.astype(np.float32)
    return mixed


def to_int16(mixed: Stereo) -> npt.NDArray[np.int16]:
    """`mixed` in 16 bits; what is louder is clipped."""
    return np.rint(np.clip(mixed * 32768, -32768, 32767)).astype(np.int16)


MAX_SEGMENT_S = 1200
"""Seconds of sound in a segment, of all channels of all sources together. More is not played: all
samples of a segment are held."""


def check_playable(manifest: Manifest) -> None:
    """Raises UnsupportedError for segments of too much sound to hold their samples."""
    channels = sum(source.channels for source in manifest.sound)
    _, stop = segment_span(manifest, 0)
    if channels * stop > MAX_SEGMENT_S * SAMPLE_RATE:
        raise UnsupportedError(
            f"its segments of {manifest.segment_frames} frames hold {channels} channels of sound, "
            f"more than {MAX_SEGMENT_S} s together; play it with --mute"
        )


def segment_span(manifest: Manifest, segment: int) -> tuple[int, int]:
    """The samples that are heard with `segment`, if it is whole: the first, and the one after the
    last."""
    first_frame = segment * manifest.segment_frames
    end_frame = first_frame + manifest.segment_frames
    return first_sample(first_frame, manifest.fps), first_sample(end_frame, manifest.fps)


class SegmentDecoder:
    """The decoder of one source. A segment that follows the one before goes on from its state; any
    other one begins with its own packets."""

    def __init__(self, source: SoundSource, manifest: Manifest) -> None:
        self._source, self._manifest = source, manifest
        self._segment = -1  # the one that was decoded last
        self._end = 0  # position where the next packet is to begin
        self._decoder = PacketDecoder(source.channels)
        self._tail: Samples = np.zeros((0, source.channels), np.int16)  # before `_end`

    def decode(self, segment: int, data: bytes, end_frame: int = 0) -> Samples:
        """All samples of `segment`, (n, channels), with the object `data`; silence where the source
        or its packets have ended. end_frame: the frames before it are in the stream, so that their
        sound must be there. Raises CorruptError."""
        found = SoundObject.parse(data)
        if found.channels != self._source.channels:
            raise CorruptError(f"sound: {found.channels} channels, not {self._source.channels}", 12)
        begin, stop = segment_span(self._manifest, segment)
        # The last segment is shorter; which one that is, is not known while the stream is live.
        known = max(first_sample(end_frame, self._manifest.fps), found.end - found.pre_skip)
        found.check_covers(begin, min(stop, known))
        samples = np.zeros((stop - begin, found.channels), np.int16)
        last = min(stop, found.num_samples)
        # Packets before the first of these positions, and after the other, are not needed: a
        # stranger may send very many of them.
        least, most = begin + found.pre_skip - PREROLL, last + found.pre_skip
        starts = list(accumulate(map(packet_samples, found.packets), initial=found.first))
        goes_on = segment == self._segment + 1 and max(starts[0], least) <= self._end <= starts[-1]
        if not goes_on:
            self._decoder, self._tail = PacketDecoder(found.channels), samples[:0]
            self._end = max((at for at in starts if at <= least), default=found.first)
        pieces = [self._tail]
        for at, packet in zip(starts, found.packets, strict=False):
            if at == self._end and at < most:
                pieces.append(self._decoder.decode(packet))
                self._end += len(pieces[-1])
        decoded = np.concatenate(pieces)
        self._segment = segment
        # The next segment begins in the last packet.
        self._tail = decoded[max(0, len(decoded) - MAX_PACKET_SAMPLES) :]
        from_sample = self._end - len(decoded) - found.pre_skip
        there = decoded[max(0, begin - from_sample) : max(0, last - from_sample)]
        offset = max(0, from_sample - begin)
        samples[offset : offset + len(there)] = there
        return samples


ReadSound = Callable[[int, SoundSource], bytes]
"""Gives the object of a source in a segment. Raises what a place of files raises."""


class SegmentLoader:
    """Reads and decodes all sources of one segment after another."""

    def __init__(self, manifest: Manifest, read: ReadSound) -> None:
        """Raises UnsupportedError for a stream whose sound is not played."""
        check_playable(manifest)
        self._read = read
        self._decoders = [(source, SegmentDecoder(source, manifest)) for source in manifest.sound]

    def load(self, segment: int, end_frame: int) -> list[Samples]:
        """The samples of each source. Blocks. end_frame: the frames before it are in the stream.
        Raises a SwingsError."""
        found = []
        for source, decoder in self._decoders:
            data = self._read(segment, source)
            try:
                found.append(decoder.decode(segment, data, end_frame))
            except CodecError as error:
                raise error.within(f"segment {segment}, {source.part}") from error
        return found


class DecodedSound:
    """Decoded segments. What is not there is silent."""

    def __init__(self, manifest: Manifest) -> None:
        self._manifest = manifest
        self._segments: dict[int, list[Samples]] = {}

    def segment_at(self, sample: int) -> int:
        """The segment with which `sample` is heard."""
        manifest = self._manifest
        frame = int(sample * manifest.fps / SAMPLE_RATE)
        segment = frame // manifest.segment_frames
        # Segments begin at whole samples, which lie before their frames.
        while segment_span(manifest, segment)[1] <= sample:
            segment += 1
        return segment

    def has(self, segment: int) -> bool:
        return segment in self._segments

    def put(self, segment: int, samples: list[Samples]) -> None:
        """samples: of each source of the manifest, of the whole segment."""
        self._segments[segment] = samples

    def keep(self, segments: Container[int]) -> None:
        """Drops all others."""
        for segment in [one for one in self._segments if one not in segments]:
            del self._segments[segment]

    def mix(self, begin: int, stop: int, camera: Camera, then: Camera | None = None) -> Stereo:
        """The samples `begin` to `stop`, as heard at `camera` at the first of them and at `then`
        after the last; there too if it is None."""
        spans = list(self._spans(max(0, begin), stop))
        pieces = []
        for number, source in enumerate(self._manifest.sound):
            samples: Samples = np.zeros((stop - begin, source.channels), np.int16)
            for at, found, low, high in spans:
                samples[at - begin : at - begin + high - low] = found[number][low:high]
            first = gains_of(source, begin / SAMPLE_RATE, camera)
            last = first if then is None else gains_of(source, stop / SAMPLE_RATE, then)
            pieces.append(SourcePiece(samples, first, last))
        return mix(pieces, stop - begin)

    def _spans(self, begin: int, stop: int) -> Iterator[tuple[int, list[Samples], int, int]]:
        """The parts of the samples `begin` to `stop` that are here: the first sample of each, its
        segment, and where the part begins and ends in that."""
        while begin < stop:
            segment = self.segment_at(begin)
            first, end = segment_span(self._manifest, segment)
            last = min(stop, end)
            found = self._segments.get(segment)
            if found is not None:
                yield begin, found, begin - first, last - first
            begin = last


log = logging.getLogger(__name__)

AHEAD_S = 10.0
"""Seconds of sound that are fetched before they are heard."""

LOOK_S = 0.05
"""Seconds between two looks at where the playback is."""

REST_SHARE = 4.0
"""After a segment that was fetched ahead the link belongs to the pictures, for so many times as
long as the segment took."""

GROWTH_SHARE = 0.8
"""A segment is fetched at least this often, as a share of its length: where latency takes the time
and not the link, the lead grows all the same."""

URGENT_S = 0.3
"""A segment is fetched without such a rest if it is to be heard in less than this and twice as long
as the one before took."""


@dataclass(frozen=True, slots=True)
class Whereabouts:
    """Where a playback is, and where it goes on."""

    frame: int
    first_frame: int
    end_frame: int
    loops: bool
    rate: float = 1.0


def wanted_segments(manifest: Manifest, at: Whereabouts) -> list[int]:
    """The segments to be heard within AHEAD_S, in their order; at least the next one too."""
    length = manifest.segment_frames
    left = max(math.ceil(AHEAD_S * manifest.fps), length + 1)
    found: list[int] = []
    frame = at.frame
    while left > 0 and frame < at.end_frame:
        segment = frame // length
        if segment in found:
            break  # all of a short loop
        found.append(segment)
        end = min((segment + 1) * length, at.end_frame)
        left -= end - frame
        frame = end
        if frame == at.end_frame and at.loops:
            frame = at.first_frame
    return found


def due_s(manifest: Manifest, at: Whereabouts, segment: int) -> float:
    """Seconds until `segment`, one of those wanted, is heard."""
    frames = segment * manifest.segment_frames - at.frame
    if frames < 0 and segment != at.frame // manifest.segment_frames:
        frames += at.end_frame - at.first_frame  # in the next round
    return max(0, frames) / manifest.fps / at.rate


class FetchPace:
    """When the link is for the next segment of sound, and when for the pictures alone. A play
    shares a link that carries little more than layer 0 with whatever is fetched beside it: ten
    seconds of sound at once would stall the pictures, and the sound with them. Pure: times come
    in."""

    def __init__(self) -> None:
        self._took_s = 0.0
        self._rests_until_s = -math.inf

    def fetched(self, began_s: float, now_s: float, length_s: float) -> None:
        """A segment that is heard for `length_s` took from `began_s` until now."""
        self._took_s = took_s = now_s - began_s
        rest_s = min(REST_SHARE * took_s, max(0.0, GROWTH_SHARE * length_s - took_s))
        self._rests_until_s = now_s + rest_s

    def allows(self, due_s: float, now_s: float) -> bool:
        """Whether a segment that is heard in `due_s` is to be fetched now."""
        return now_s >= self._rests_until_s or due_s < URGENT_S + 2 * self._took_s


def segment_before(manifest: Manifest, at: Whereabouts) -> int:
    """The segment that was just heard, which a step back needs, and the end of which is still heard
    where pictures are drawn a frame late. May be one that there is not."""
    segment, first = (frame // manifest.segment_frames for frame in (at.frame, at.first_frame))
    starts_anew = at.loops and segment == first
    return (at.end_frame - 1) // manifest.segment_frames if starts_anew else segment - 1


class SoundFeed:
    """Fills `decoded` while the `with` block runs. A segment that cannot be had stays silent, and
    is logged."""

    def __init__(
        self,
        manifest: Manifest,
        files: SoundFiles,
        decoded: DecodedSound,
        where: Callable[[], Whereabouts],
    ) -> None:
        """files: is closed at the end. Raises UnsupportedError for a stream whose sound is not
        played."""
        self._manifest, self._files, self._decoded, self._where = manifest, files, decoded, where
        self._loader, self._pace = SegmentLoader(manifest, files.read), FetchPace()
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="sound")
        self.failed: set[int] = set()
        """Segments that cannot be had."""
        self.loaded = 0
        """Segments that were fetched and decoded."""

    def __enter__(self) -> SoundFeed:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._stopped.set()
        self._files.interrupt()
        self._thread.join()
        self._files.close()

    def _run(self) -> None:
        while not self._stopped.is_set():
            at = self._where()
            wanted = wanted_segments(self._manifest, at)
            self._decoded.keep({*wanted, segment_before(self._manifest, at)})
            lacking = (one for one in wanted if not self._decoded.has(one))
            segment = next((one for one in lacking if one not in self.failed), None)
            began_s = time.monotonic()
            if segment is None or not self._pace.allows(
                due_s(self._manifest, at, segment), began_s
            ):
                self._stopped.wait(LOOK_S)
                continue
            try:
                self._decoded.put(segment, self._loader.load(segment, at.end_frame))
                self.loaded += 1
                length_s = self._manifest.segment_frames / self._manifest.fps / at.rate
                self._pace.fetched(began_s, time.monotonic(), length_s)
            except StoppedError:
                return
            except SwingsError as error:
                self.failed.add(segment)
                log.warning("no sound from here to the next segment: %s", error)
