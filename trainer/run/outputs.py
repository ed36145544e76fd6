"""The outputs of a run beside its log and its checkpoint: streams, their order, sound and poster,
and snapshots.

Slices sent whole are ordered by `--rank`. By contribution, which is summed over the views and over
the frames in which a Gaussian shows, what is small, thin or hidden ranks low. The sound, a file's
or that of the capture's videos, is encoded before training begins, so that a bad file ends the run
at once.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np
from PIL import Image

from codec.arrays import Doubles
from codec.errors import InvalidError, SwingsError
from codec.files import temporary_beside
from codec.outputlock import writing_alone
from codec.slice import Slice, active_splats
from codec.slots.slotlayout import Update
from codec.splats import Splats
from codec.storage.openstorage import Target, is_url, open_growing
from codec.stream import StreamReader, StreamWriter
from codec.stream.finishing import finish_pictures
from codec.stream.manifest import MANIFEST_NAME, SEGMENTS_NAME, Manifest
from codec.stream.poster import write_poster
from codec.stream.segment import INDEX_NAME
from codec.stream.sound import (
    DEFAULT_BITRATE_BPS,
    SAMPLE_RATE,
    SoundObject,
    SoundSource,
    first_sample,
    segment_sound,
)
from codec.stream.wholeslice import Rank
from codec.stream.writer import SHAPE
from codec.tracks.soundfile import Samples, encode, read_samples, shifted
from player.render.cpu import render_splats
from trainer.capture.capture import Capture
from trainer.fit.observer import Window
from trainer.fit.trainer import Trainer
from trainer.pictures.framecache import FrameCache
from trainer.score.meter import QualityMeter
from trainer.score.sheet import comparison, save_png
from trainer.score.truth import captured, displayed
from trainer.step.contribution import summed_contribution
from trainer.step.raster import Parameters, View
from trainer.storedfiles import block_file, by_its_name, translated

from .checkpoint import CHECKPOINT_NAME, SETTINGS_NAME
from .config import TrainConfig

CONTRIBUTION = "contribution"
"""The name of this rank in options."""


def writer_rank(rank: str) -> Rank:
    """The rank with which a StreamWriter keeps slices that are ordered by `rank`."""
    return Rank.GIVEN if rank == CONTRIBUTION else Rank(rank)


def _most_first(part: Slice, importance: Doubles) -> Slice:
    """`part` with its Gaussians by falling importance; equal ones keep their order."""
    order = np.argsort(-importance, kind="stable")
    return Slice(part.birth, part.splats.take(order), part.start_offsets[order])


def slices_by_contribution(reader: StreamReader, views: Sequence[View]) -> Iterator[Slice]:
    """All slices of a stream in order of birth, the Gaussians that contribute most first.

    Every frame is rendered once for each of `views`. Raises InvalidError for a stream without a
    frame.
    """
    manifest = reader.manifest
    if reader.num_frames == 0:
        raise InvalidError(f"{reader.name}: the stream has no finished segment yet")
    sums: dict[int, Doubles] = {}
    window: list[Slice] = []
    for frame in range(reader.num_frames):
        window = reader.window(frame, manifest.num_layers)
        splats = active_splats(window, frame, manifest.swin_size)
        values = Parameters(*splats.arrays)
        rows = np.arange(len(splats), dtype=np.int32)
        contributions = summed_contribution(values, rows, views, [None] * len(views))
        first = 0
        for part in window:
            shown = np.flatnonzero(part.active(frame, manifest.swin_size))
            total = sums.setdefault(part.birth, np.zeros(len(part.splats)))
            total[shown] += contributions[first : first + len(shown)]
            first += len(shown)
        # No later frame shows the oldest slice.
        yield _most_first(window[0], sums.pop(window[0].birth))
    for part in window[1:]:
        yield _most_first(part, sums[part.birth])


def matured_by_contribution(trainer: Trainer, window: Window) -> tuple[Slice, ...]:
    """The slices of `window`, which `trainer` has just given, the Gaussians that contribute most
    first."""
    contributions = trainer.contributions(window)
    return tuple(_most_first(*pair) for pair in zip(window.slices, contributions, strict=True))


log = logging.getLogger(__name__)

SOURCE = SoundSource("main", 2)
"""The one source of a trained stream; swings-stream audio adds others."""


@dataclass(frozen=True, slots=True)
class CaptureSound:
    """The encoded sound of a capture, whole, to be cut into the segments of its stream."""

    whole: SoundObject
    fps: float

    def objects(self, first_frame: int, end_frame: int) -> Mapping[str, bytes]:
        """The objects of a segment of the stream, by their names. Raises InvalidError."""
        begin, stop = first_sample(first_frame, self.fps), first_sample(end_frame, self.fps)
        return {SOURCE.part: segment_sound(self.whole, begin, stop).pack()}


def capture_sound(
    config: TrainConfig, capture: Capture, frames: range, fps_of: Callable[[], float]
) -> CaptureSound | None:
    """The sound of `frames` of the capture: of `config.audio` from the capture's frame 0 on, else
    of the first of its videos that has any; None without. fps_of: of the stream; is called where
    there is sound. Raises a SwingsError for a file that was asked for; a video whose sound cannot
    be read is logged and left out."""
    if config.audio is not None:
        return _encoded(config.audio, frames, fps_of())
    if config.silent:
        return None
    starts_s = capture.starts_s or (0.0,) * len(capture.videos)
    for video, start_s in zip(capture.videos, starts_s, strict=True):
        try:
            if not _has_sound(video):
                continue
            found = _encoded(video, frames, fps_of(), start_s)
        except SwingsError as error:
            log.warning("the sound of a video is left out: %s", error)
            continue
        log.info("the stream gets the sound of %s", video)
        return found
    return None


def _encoded(file: Path, frames: range, fps: float, start_s: float = 0.0) -> CaptureSound:
    """start_s: the time in the file at which frame 0 is."""
    offset_s = -start_s - first_sample(frames.start, fps) / SAMPLE_RATE
    pieces = shifted(_samples(file), SOURCE.channels, offset_s)
    length = first_sample(len(frames), fps)
    return CaptureSound(encode(pieces, SOURCE.channels, length, DEFAULT_BITRATE_BPS), fps)


def _has_sound(video: Path) -> bool:
    try:
        return any(len(piece) for piece in islice(_samples(video), 1))
    except InvalidError:
        return False


def _samples(file: Path) -> Iterator[Samples]:
    """The samples of `file`, which may lie in an object store; see `read_samples`."""
    with by_its_name(file), translated():
        yield from read_samples(file, SOURCE.channels, block_file(file))


SNAPSHOT_FOLDER = "snapshots"
"""In the work folder: pictures of a stream beside the capture's."""


def bare_targets(config: TrainConfig) -> list[Target]:
    """The places of a run that was stopped before its first checkpoint: they hold nothing to go on
    from, and nothing to lose. Empty for any other run."""
    if (config.work_folder / CHECKPOINT_NAME).exists():
        return []
    targets = [t for t in run_targets(config) if open_growing(t, SHAPE).names()]
    return targets if all(map(_is_bare, targets)) else []


BARE_NAMES = {MANIFEST_NAME, INDEX_NAME, SEGMENTS_NAME}
"""Names in the folder of a stream without a frame."""


def _is_bare(target: Target) -> bool:
    names = open_growing(target, SHAPE).names() - LEFTOVERS
    if not names <= BARE_NAMES:
        return False
    if MANIFEST_NAME in names:
        reader = StreamReader(target, max_gaussians=None)
        return reader.manifest.live and not reader.records
    return True


LEFTOVERS = {SETTINGS_NAME} | {
    temporary_beside(Path(name)).name
    for name in (MANIFEST_NAME, INDEX_NAME, CHECKPOINT_NAME, SETTINGS_NAME)
}
"""Names of what a killed run may have left beside its stream."""


def clear_bare(targets: Sequence[Target]) -> None:
    """Makes the places that `bare_targets` found fit for a new stream."""
    for target in targets:
        place = open_growing(target, SHAPE)
        for name in place.names() & {MANIFEST_NAME, *LEFTOVERS}:
            place.delete(name)


def run_targets(config: TrainConfig) -> list[Target]:
    """The places of the streams that a run writes."""
    return [config.target] + ([config.raw_stream] if config.raw_stream else [])


@contextmanager
def writing_run(config: TrainConfig) -> Iterator[None]:
    """Holds the locks of all folders that a run writes. Raises ConflictError if another process
    writes one."""
    places = [*run_targets(config), config.work_folder]
    folders = [Path(place) for place in places if not is_url(place)]
    absolute = {folder.absolute() for folder in folders}
    with ExitStack() as stack:
        for folder in folders:
            if absolute.isdisjoint(folder.absolute().parents):
                folder.parent.mkdir(parents=True, exist_ok=True)
                stack.enter_context(writing_alone(folder))
        yield


def check_targets(config: TrainConfig, bare: Sequence[Target] = ()) -> list[Target]:
    """The places to write. Raises InvalidError for one that holds something else, and for a log
    that has no place. bare: what `bare_targets` found."""
    if config.log is not None and not config.log.parent.is_dir():
        raise InvalidError(f"{config.log.parent} is not a folder; the log cannot be written there")
    targets = run_targets(config)
    if config.resume:
        return targets
    for target in targets:
        if target not in bare:
            _check_empty(target)
    if config.work_folder != config.target and not bare:
        _check_empty(config.work_folder)
    return targets


def _check_empty(target: Target) -> None:
    if is_url(target):
        open_growing(target, SHAPE).check_unused()
        return
    path = Path(target)
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise InvalidError(
            f"{path} exists and is not empty; remove it, name another folder, or --resume"
        )


def has_manifest(target: Target) -> bool:
    """Whether a writer has begun a stream at `target`."""
    return MANIFEST_NAME in open_growing(target, SHAPE).names()


OpenWriters = Callable[[Sequence[Slice]], tuple[list[StreamWriter], QualityMeter]]
"""Opens the streams of a run; gives their writers, and the quality of the first one."""


class Outputs:
    """The streams of a run; all of them get the same slices."""

    def __init__(self, open_writers: OpenWriters) -> None:
        self._open_writers = open_writers
        self.writers: list[StreamWriter] = []
        """None before `open`."""
        self.pending: list[Slice | Update] = []
        """Slices that may not be in a finished segment of every stream yet, in order of birth."""
        self._without_poster: list[StreamWriter] = []

    def open(self, parts: Sequence[Slice]) -> None:
        """Opens the streams, whose first slices are `parts` if they have no manifest yet."""
        self.writers, self.quality = self._open_writers(parts)
        self._without_poster = [w for w in self.writers if w.durable_birth <= 0]

    @property
    def manifest(self) -> Manifest:
        """The first stream's manifest."""
        return self.writers[0].manifest

    @property
    def played_bytes(self) -> int:
        """Bytes on disk of the first stream that a player from frame 0 on fetches."""
        return self.writers[0].played_bytes

    @property
    def slice_bytes(self) -> int:
        """Size of the last slice in the first stream: its packets."""
        return self.writers[0].slice_bytes

    def deliver(self, parts: Sequence[Slice | Update]) -> None:
        """Appends slices, or updates of slots, to the streams that lack them."""
        if not self.writers and parts:
            self.open([part for part in parts if isinstance(part, Slice)])
        for part in parts:
            for writer in self.writers:
                if part.birth >= writer.next_birth:
                    writer.append(part)
            self.pending.append(part)
        self.pending = [
            p for p in self.pending if any(p.birth >= w.durable_birth for w in self.writers)
        ]
        for writer in self._without_poster:
            if writer.durable_birth > 0:  # its first frames are there
                write_poster(writer.target, render_splats)
        self._without_poster = [w for w in self._without_poster if w.durable_birth <= 0]


@contextmanager
def open_outputs(
    config: TrainConfig,
    targets: Sequence[Target],
    manifest: Manifest | None,
    make: Callable[[Splats], Manifest],
    cache: FrameCache,
    sound: CaptureSound | None = None,
) -> Iterator[Outputs]:
    """A stream in each of the folders; a resumed run leaves out those that are finished.

    manifest: None for streams of whole slices that have none yet: `make` makes it of the
    first slice, because the lattice of such a stream goes by trained ones. sound: of all streams.

    Leaving finishes the streams; leaving by an exception keeps what is in finished segments. Each
    stream gets a poster with its first segment, and one of its first frame, and a storyboard,
    when it is finished.
    """
    with ExitStack() as stack:

        def open_writers(parts: Sequence[Slice]) -> tuple[list[StreamWriter], QualityMeter]:
            wanted = manifest or make(parts[0].splats)
            wanted = replace(wanted, sound=(SOURCE,) if sound is not None else ())
            writers, meters = [], []
            for target, exact in zip(targets, (False, True), strict=False):
                quality = QualityMeter(cache, wanted)
                rank = writer_rank(config.rank)
                if not has_manifest(target):
                    # by settings and log
                    writer = StreamWriter.create(target, wanted, rank, quality, exact, in_use=True)
                else:
                    reader = StreamReader(target, max_gaussians=None)
                    if not reader.manifest.live:
                        continue
                    writer = StreamWriter.resume(target, rank, quality, exact)
                    quality.recall(reader, writer.next_birth)
                    if writer.manifest.sound and sound is None:
                        raise InvalidError(f"{target}: the sound that it began with is gone")
                if sound is not None and writer.manifest.sound:
                    writer.sound = sound.objects
                writers.append(stack.enter_context(writer))
                meters.append(quality)
            return writers, meters[0]

        outputs = Outputs(open_writers)
        if manifest is not None:
            outputs.open(())
        yield outputs
    for writer in outputs.writers:  # again: now there is all of the stream to choose from
        finish_pictures(writer.target, render_splats)


def write_snapshot(
    splats: Splats, frame: int, cache: FrameCache, near_planes: Sequence[float], work_folder: Path
) -> None:
    """Draws what shows in a frame of the stream, as the first of the capture's `watching` cameras
    sees it, to a PNG in the work folder. near_planes: of all cameras."""
    index = cache.capture.watching[0]
    truth = captured(cache.image(index, cache.frames[frame]))
    shown = displayed(splats, cache.camera(index), near_planes[index])
    path = work_folder / SNAPSHOT_FOLDER / f"{frame:06d}.png"
    save_png(Image.fromarray(comparison(shown, truth)), path)
