"""The thread that fetches and decodes sound ahead of the playback."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from codec.errors import SwingsError
from codec.stream.manifest import Manifest
from player.network.fetch import StoppedError
from player.source.soundfiles import SoundFiles

from .decodedsound import DecodedSound, SegmentLoader

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
