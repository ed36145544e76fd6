"""A live stream made of a numbered sequence that somebody is still writing.

Rule: nothing that a file does ends the stream, and time goes on: what is missing or cannot be read
is stood for by the frame before.
"""

from __future__ import annotations

import logging
import math
import statistics
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from codec.coders.blocks import Effort
from codec.errors import InvalidError
from codec.foreign.notes import notes, one_import
from codec.framerange import FrameRange
from codec.progressline import Counter
from codec.slots.encoder import SlotEncoder
from codec.slots.slotlayout import MAX_SEGMENT_FRAMES, MAX_SLOTS, Update
from codec.splats import Splats, array_shapes
from codec.stream.finishing import finish_pictures
from codec.stream.manifest import Manifest
from codec.stream.pictures import Draw
from codec.stream.poster import POSTER_NAME
from codec.stream.reader import StreamReader
from codec.stream.segment import encode_packet
from codec.stream.wholeslice import RANKS
from codec.stream.writer import StreamWriter

from .importing import ImportOptions, fps_of, make_manifest, make_plan
from .incomingfiles import POLL_S, Arrival, Arrivals, Troubles
from .slotfiller import HOLD, SlotFiller, SlotPlan, steps_of
from .survey import Survey

_log = logging.getLogger(__name__)

IDLE_S = 5.0
"""A writer that is silent for so long is reported."""

MAX_GAP_S = 10.0
"""A jump of the numbers by more than this is no gap."""

MAX_DELAYS = 10_000
"""Delays that are kept for their median."""


@dataclass(frozen=True, slots=True)
class FollowOptions:
    """Settings of --follow."""

    segment_s: float = 0.2
    """Length of a segment. Viewers get a frame when its segment is written, so shorter is sooner;
    each segment costs disk space for a keyframe."""
    room: float = 1.25
    """Slots of the stream, as a multiple of the Gaussians in the first file. Of a file with more,
    the least important are left out."""
    patience_s: float = 1.0
    """A frame that is missing or unfinished is given up when a later file has been there for this
    time; the frame before stands for it."""
    end_after_s: float | None = None
    """Finish the stream when no frame has come for this time; by default only Ctrl-C does."""
    step: int = 1
    """Step of the numbers in the file names from one frame to the next."""

    def __post_init__(self) -> None:
        for name in ("segment_s", "room", "patience_s", "end_after_s"):
            value = getattr(self, name)
            if value is not None and not 0 < value < float("inf"):
                raise InvalidError(f"{name.replace('_', '-')} {value:g}: choose more than 0")
        if self.room < 1:
            raise InvalidError(f"room {self.room:g}: choose 1 or more")
        if self.step < 1:
            raise InvalidError(f"step {self.step}: choose 1 or more")


@dataclass(frozen=True, slots=True)
class Followed:
    """A stream that `follow_folder` wrote."""

    manifest: Manifest
    num_frames: int
    """All frames of the stream, with those that were there before a resume."""
    num_bytes: int
    """Size of all objects."""
    troubles: str
    """Problems of the files, counted; empty without any."""
    median_delay_s: float | None
    """Median time from the last write of a file until its segment stood; None without any."""


def _nothing(done: int, total: int | None, what: str | None = None) -> None:
    pass


@one_import()
def follow_folder(
    folder: Path,
    stream: Path,
    options: ImportOptions,
    follow: FollowOptions,
    resume: bool,
    stop: threading.Event,
    draw: Draw | None = None,
    progress: Counter = _nothing,
    now_s: Callable[[], float] = time.monotonic,
) -> Followed:
    """Writes the frames of `folder` to a live stream at `stream` as they come, and finishes it once
    `stop` is set, or by `follow.end_after_s`.

    resume: goes on with the stream that is there, after its last finished segment. progress: is
    called with the number of frames. By an exception the stream stays live, to be resumed. Raises
    InvalidError for options that do not go together, and what StreamWriter raises.
    """
    for name, given in (
        ("--exact", options.exact),
        ("--frames", options.frames != FrameRange()),
    ):
        if given:
            raise InvalidError(f"{name} cannot be combined with --follow")
    _rehearse()
    troubles = Troubles()
    arrivals = Arrivals(folder, None, follow.step, follow.patience_s, troubles, now_s)
    waiting = _Waiting(arrivals, follow, stop, now_s)
    if resume:
        follower = _Follower.resumed(stream, options, follow, troubles)
        arrivals.next_number = follower.next_number
        first = None
    else:
        options = replace(options, fps=fps_of(folder, options))
        first = waiting.next()
        while first is not None and first.splats is None:
            first = waiting.next()  # nothing stands for what is before the first frame
        if first is None:
            raise InvalidError(f"{folder}: no frame came; nothing was written")
        title = folder.resolve().name if options.title is None else options.title
        poster = POSTER_NAME if draw is not None else None
        follower = _Follower.created(
            stream, first, replace(options, title=title), follow, troubles, poster
        )
    writer = follower.writer
    try:
        with writer:
            if first is not None:
                follower.write(first)
            progress(writer.next_birth, None, f"frame {writer.next_birth}")
            while (arrival := waiting.next()) is not None:
                follower.check_gap(arrivals.first_number, arrival)
                follower.write(arrival)
                progress(writer.next_birth, None, f"frame {writer.next_birth}")
    except BaseException:
        kept = max(writer.durable_birth, 0)
        _log.warning("%s stays live, with %d frames; --resume goes on from there", stream, kept)
        raise
    manifest = writer.manifest
    if draw is not None and manifest.poster is not None:
        manifest = finish_pictures(stream, draw)
    if notes().left_out:
        troubles.counts["files without some of their Gaussians"] = len(notes().left_out)
    delays_s = follower.delays_s
    return Followed(
        manifest,
        writer.next_birth,
        writer.bytes_written,
        str(troubles),
        statistics.median(delays_s) if delays_s else None,
    )


def _rehearse() -> None:
    """Loads and compiles all that a frame goes through, so that the first one need not wait."""
    rng = np.random.default_rng(0)
    options = ImportOptions(fps=1)
    splats = Splats(*(rng.normal(size=shape).astype(np.float32) for shape in array_shapes(64, 0)))
    survey = Survey()
    survey.take(Path(), splats)
    plan = make_plan(survey, options, splats)
    manifest = make_manifest(survey, options, "", plan.slots, plan.lattices)
    filler, encoder = SlotFiller(plan, RANKS[options.rank]), SlotEncoder(manifest.slot_layout)
    moved = replace(splats, means=splats.means + np.float32(0.1))
    for birth, frame in enumerate((splats, moved, moved.take(np.arange(64)[::-1]))):
        encoded = encoder.append(filler.update(birth, frame))
        assert encoded is not None
        for chunk in (encoded.skip_map, *encoded.changes):
            encode_packet(chunk, effort=Effort.QUICK)


class _Waiting:
    """Waits for frames, until there is an end of them."""

    def __init__(
        self,
        arrivals: Arrivals,
        follow: FollowOptions,
        stop: threading.Event,
        now_s: Callable[[], float],
    ) -> None:
        self._arrivals, self._follow, self._stop, self._now_s = arrivals, follow, stop, now_s

    def next(self) -> Arrival | None:
        """The next frame; None when the stream shall end."""
        began_s, is_reported, end_s = self._now_s(), False, self._follow.end_after_s
        while not self._stop.is_set():
            arrival = self._arrivals.poll()
            if arrival is not None:
                return arrival
            idle_s = self._now_s() - began_s
            if end_s is not None and idle_s >= end_s:
                return None
            if idle_s >= IDLE_S and not is_reported:
                is_reported = True
                name = self._arrivals.next_name
                _log.warning("waiting for %s since %.0f s; Ctrl-C ends the stream", name, idle_s)
            self._stop.wait(POLL_S)
        return None


class _Follower:
    """Writes arrivals to a stream."""

    def __init__(
        self,
        writer: StreamWriter,
        options: ImportOptions,
        follow: FollowOptions,
        filler: SlotFiller,
        troubles: Troubles,
    ) -> None:
        self.writer = writer
        self._options, self._step = options, follow.step
        self._filler, self._troubles = filler, troubles
        self._unwritten_s: list[float] = []  # when the files of the unfinished segment came
        self.delays_s: deque[float] = deque(maxlen=MAX_DELAYS)

    @staticmethod
    def created(
        stream: Path,
        first: Arrival,
        options: ImportOptions,
        follow: FollowOptions,
        troubles: Troubles,
        poster: str | None,
    ) -> _Follower:
        """The follower of a new stream, which is laid out by its first frame."""
        assert first.splats is not None  # nothing stands for the first frame
        survey, splats = Survey(), options.kept(first.splats)
        survey.take(Path(str(first.number)), splats)
        survey.num_gs = min(max(1, math.ceil(follow.room * len(splats))), MAX_SLOTS)
        plan = make_plan(survey, options, splats)
        fps = options.fps
        assert fps is not None
        manifest = replace(
            make_manifest(survey, options, options.title or "", plan.slots, plan.lattices),
            segment_frames=int(np.clip(round(follow.segment_s * fps), 1, MAX_SEGMENT_FRAMES)),
            capture_frame=first.number,
            poster=poster,
        )
        writer = StreamWriter.create(stream, manifest, effort=Effort.QUICK)
        return _Follower(writer, options, follow, SlotFiller(plan, RANKS[options.rank]), troubles)

    @staticmethod
    def resumed(
        stream: Path, options: ImportOptions, follow: FollowOptions, troubles: Troubles
    ) -> _Follower:
        """The follower that goes on with `stream`."""
        writer = StreamWriter.resume(stream, effort=Effort.QUICK)
        manifest = writer.manifest
        slots = manifest.slots
        lower, upper = (np.array(corner) for corner in manifest.bounds)
        shares = tuple(count / sum(slots) for count in slots)
        bounds = HOLD * np.array([steps_of(lattice) for lattice in manifest.lattice])
        plan = SlotPlan(slots, shares, manifest.sh_degree, manifest.lattice, bounds, lower, upper)
        filler = SlotFiller(plan, RANKS[options.rank])
        if writer.next_birth > 0:
            reader = StreamReader(stream, max_gaussians=None)
            filler.go_on_after(reader.decoder_at(writer.next_birth - 1, len(slots)).lanes[0])
        return _Follower(writer, options, follow, filler, troubles)

    @property
    def next_number(self) -> int:
        """The number of the file of the next frame."""
        return self.writer.manifest.capture_frame + self._step * self.writer.next_birth

    def check_gap(self, following: int | None, arrival: Arrival) -> None:
        """Raises InvalidError if so many files are missing that it is another sequence. following:
        the number of the first file after `arrival`."""
        if arrival.splats is not None or following is None:
            return
        missing = (following - arrival.number) // self._step
        if missing > MAX_GAP_S * self.writer.manifest.fps:
            raise InvalidError(
                f"frames {arrival.number} to {following - 1} are missing, more than "
                f"{MAX_GAP_S:g} s; renumber the files and go on with --resume, or begin another "
                "stream"
            )

    def write(self, arrival: Arrival) -> None:
        """Appends the next frame."""
        writer = self.writer
        birth, written_before = writer.next_birth, writer.bytes_written
        if arrival.splats is None:
            update = Update.keeping(birth, writer.manifest.slot_layout)
        else:
            update = self._filler.update(birth, self._fitting(arrival.number, arrival.splats))
        writer.append(update)
        self._unwritten_s.append(arrival.written_s)
        if writer.bytes_written > written_before:
            now_s = time.time()
            self.delays_s.extend(now_s - written_s for written_s in self._unwritten_s)
            self._unwritten_s.clear()

    def _fitting(self, number: int, splats: Splats) -> Splats:
        """`splats` as the stream can hold them."""
        manifest = self.writer.manifest
        kept, room = self._options.kept(splats), sum(manifest.slots)
        if kept.sh_degree != manifest.sh_degree:
            self._troubles.note(
                "files of another SH degree",
                f"frame {number} has SH degree {kept.sh_degree}, the stream "
                f"{manifest.sh_degree}; what is more is dropped, what is less is 0",
            )
            kept = kept.with_degree(manifest.sh_degree)
        if len(kept) > room:
            self._troubles.note(
                "files over the room",
                f"frame {number} has {len(kept)} Gaussians, the stream room for {room}; the least "
                "important are left out; begin with a larger --live.room",
            )
            order = np.argsort(-RANKS[self._options.rank](kept), kind="stable")
            kept = kept.take(np.sort(order[:room]))
        return kept
