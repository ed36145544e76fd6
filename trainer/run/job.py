"""A training run from end to end: a capture in, a stream out, and what is printed at its end, or of
a run that is resumed after it.
"""

from __future__ import annotations

import logging
import shlex
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

from codec.console import interruptible
from codec.progressline import ProgressLine, clock
from codec.storage.openstorage import Target
from codec.stream import StreamReader
from codec.stream.finishing import finish_pictures
from codec.stream.manifest import Manifest
from codec.tools.audit import layer_summaries
from player.render.cpu import render_splats
from trainer.fit.leasedslots import LeasedSlots
from trainer.fit.observer import Observer
from trainer.fit.strategy import WholeSlices
from trainer.fit.trainer import Trainer
from trainer.pictures.framecache import CapturePictures, FrameCache

from .checkpoint import (
    CHECKPOINT_NAME,
    KEEP_S,
    Checkpoint,
    GenesisKeeper,
    KeepTimer,
    forget_run,
    load_checkpoint,
    save_checkpoint,
    write_settings,
)
from .config import TrainConfig, config_to_json
from .fromvideos import with_poses
from .liveview import LiveView, Preview
from .monitor import LOG_NAME, Monitor, RunLog
from .outputs import (
    CONTRIBUTION,
    CaptureSound,
    bare_targets,
    capture_sound,
    check_targets,
    clear_bare,
    has_manifest,
    matured_by_contribution,
    open_outputs,
    run_targets,
    write_snapshot,
    writing_run,
)
from .prepare import Prepared, first_gaussians, fps_of, make_manifest, prepare, shared_settings


def finish_outputs(config: TrainConfig) -> Manifest | None:
    """The manifest of a run whose streams are all finished; None for any other run.

    A run that was killed after its last frame may have left its checkpoint, and not the last
    poster and the storyboard: all are put right. Raises CodecError for a manifest that cannot be
    read.
    """
    readers = []
    for target in run_targets(config):
        if not has_manifest(target):
            return None
        reader = StreamReader(target)
        if reader.manifest.live:
            return None
        readers.append(reader)
    if (config.work_folder / CHECKPOINT_NAME).exists():
        for target in run_targets(config):
            finish_pictures(target, render_splats)
        forget_run(config.work_folder)
    return readers[0].manifest


def show_result(config: TrainConfig, took_s: float, console: Console) -> None:
    """Prints quality and size of a stream that was finished now, and what to do with it. took_s:
    time of this run, seconds."""
    reader = StreamReader(config.target)
    whole = layer_summaries(reader)[-1]
    figures = [f"{reader.num_frames} frames"]
    if whole.psnr_db is not None:
        figures.append(f"{whole.psnr_db:.2f} dB")
    figures.append(f"{whole.size_bytes / reader.num_frames / 1e3:.1f} kB a frame")
    figures.append(f"{whole.bitrate_bps / 1e6:.2f} Mbit/s")
    stream, capture = (shlex.quote(str(place)) for place in (config.target, config.capture))
    for line in (
        f"{config.target}: {', '.join(figures)}; this run took {clock(took_s)}",
        f"to watch it: swings-serve {stream}",
        f"to score it: swings-eval {stream} {capture} --sheet sheet.png",
    ):
        console.print(line, highlight=False, markup=False, soft_wrap=True)


def show_finished(config: TrainConfig, console: Console) -> None:
    """Prints that the stream of `config` is finished."""
    frames = StreamReader(config.target).num_frames
    console.print(
        f"{config.target} is finished, {frames} frames; nothing is left to train",
        highlight=False, markup=False, soft_wrap=True,
    )  # fmt: skip


log_to = logging.getLogger(__name__)


@dataclass(slots=True)
class _Progress:
    """How far a run is, for the line that says where it was stopped."""

    num_frames: int
    finished_frames: int = 0
    can_resume: bool = False
    """Whether there is a checkpoint."""

    @property
    def is_finished(self) -> bool:
        return self.finished_frames == self.num_frames


@contextmanager
def telling_where_it_stopped(progress: _Progress, console: Console) -> Iterator[None]:
    """Where a signal ends the block: prints after which frame, and that the run can be resumed."""
    try:
        yield
    except KeyboardInterrupt:
        if progress.can_resume:
            done = progress.finished_frames
            when = f"after frame {done - 1}" if done else "before the first frame was finished"
            with suppress(OSError):  # the terminal may be gone
                line = f"stopped {when}; --resume continues from there"
                console.print(line, highlight=False, soft_wrap=True)
        raise


def train_stream(
    config: TrainConfig,
    console: Console,
    on_checked: Callable[[], None] = lambda: None,
    observers: Sequence[Observer] = (),
) -> Manifest:
    """Trains `config.capture` into `config.stream`; progress goes to `console`.

    on_checked: called when capture and settings were found good, before anything is computed.
    observers: called for every window; one has ended when its frame and its checkpoint are written.

    A resumed run that is finished already is left as it is. Raises SwingsError before anything is
    written when the capture or the settings cannot work; what stops it later leaves a valid,
    shorter stream and a checkpoint to resume from. Ctrl-C raises KeyboardInterrupt when the running
    window has ended.
    """
    config.check_slices()
    with writing_run(config):
        if config.resume:
            finished = finish_outputs(config)
            if finished is not None:
                show_finished(config, console)
                return finished
        view = _live_view(config, console)
        start = _checked(config, console)
        on_checked()
        _announce(start, console)
        clear_bare(start.bare)
        config.work_folder.mkdir(parents=True, exist_ok=True)
        begin_s = time.monotonic()
        with view or nullcontext():
            manifest = _train(start, console, [*observers, *([view] if view else [])])
        show_result(start.config, time.monotonic() - begin_s, console)
        return manifest


def _live_view(config: TrainConfig, console: Console) -> LiveView | None:
    if config.serve is None:
        return None
    say = partial(console.print, highlight=False, markup=False, soft_wrap=True)
    return LiveView(config.target, config.serve, config.work_folder, say)


@dataclass(frozen=True, slots=True)
class _Start:
    """The start of a run, found good."""

    config: TrainConfig
    bare: list[Target]
    """Places that a run left before its first checkpoint."""
    targets: list[Target]
    prepared: Prepared
    settings: Mapping[str, Any]
    found: Checkpoint | None
    """Where a resumed run goes on."""
    sound: CaptureSound | None
    doubts: list[str]

    @property
    def checkpoint(self) -> Path:
        return self.config.work_folder / CHECKPOINT_NAME


def _checked(config: TrainConfig, console: Console) -> _Start:
    """Opens the capture, and the checkpoint of a resumed run. Writes nothing; raises SwingsError
    where something cannot work."""
    bare = bare_targets(config) if config.resume else []
    if bare:
        config = replace(config, resume=False)
    targets = check_targets(config, bare)
    config = with_poses(config, console)
    with console.status("reading what the cameras see"):
        prepared = prepare(config)
        doubts = [] if config.resume else prepared.find_doubts()
    settings = shared_settings(config, prepared)
    path = config.work_folder / CHECKPOINT_NAME
    found = load_checkpoint(path, settings) if config.resume else None
    fps = partial(fps_of, prepared.capture, config)
    sound = capture_sound(config, prepared.capture, prepared.frames, fps)
    return _Start(config, bare, targets, prepared, settings, found, sound, doubts)


def _announce(start: _Start, console: Console) -> None:
    """Says where the run is computed, and what makes its result doubtful."""
    prepared = start.prepared
    console.print(f"backend: {prepared.picked.why}", highlight=False, markup=False, soft_wrap=True)
    if prepared.scale < 1:
        width_px, height_px = prepared.size_px
        scaled = f"pictures: scaled to {width_px}x{height_px} pixels; for another size --longest-px"
        console.print(scaled, highlight=False, markup=False, soft_wrap=True)
    if prepared.memory is not None:
        console.print(prepared.memory, highlight=False, markup=False, soft_wrap=True)
    if start.bare:
        log_to.warning(
            f"{start.config.target} was stopped before its first checkpoint; training starts anew"
        )
    for doubt in start.doubts:
        log_to.warning(doubt)


def _train(start: _Start, console: Console, observers: Sequence[Observer]) -> Manifest:
    """Trains all windows from the start, or from the checkpoint on."""
    config, prepared, found = start.config, start.prepared, start.found
    options = config_to_json(replace(config, resume=False))
    if found is None:
        write_settings(config.work_folder, options)
    progress = _Progress(len(prepared.frames))
    with telling_where_it_stopped(progress, console), ExitStack() as stack:
        cache = stack.enter_context(
            FrameCache(prepared.capture, prepared.frames, prepared.scale, config.cache_bytes)
        )
        pictures = CapturePictures(cache, prepared.capture.training)
        log_path = config.log or config.work_folder / LOG_NAME
        log = stack.enter_context(RunLog(log_path, config.tensorboard))
        initial, manifest = None, None
        if found is None:
            with console.status("making the first Gaussians"):
                initial = first_gaussians(config, prepared, pictures)
            if not config.whole_slices:
                manifest = make_manifest(config, prepared, cache, initial)
        elif has_manifest(config.target):
            manifest = StreamReader(config.target, max_gaussians=None).manifest
        line = ProgressLine(console)
        monitor = Monitor(line, log, config.fit, len(prepared.frames), size_px=prepared.size_px)
        trainer = Trainer(
            config.fit, pictures, initial, prepared.training_planes, prepared.far_m,
            prepared.picked.backend,
            (
                monitor, GenesisKeeper(lambda: keep(), KeepTimer(KEEP_S)),
                *([Preview(config.target, manifest, lambda frame: trainer.shown(frame))]
                  if config.serve is not None and manifest is not None else []),
                *observers,
            ),
            WholeSlices if config.whole_slices or manifest is None
            else partial(LeasedSlots, layout=manifest.slot_layout),
            prepared.search_from_m,
        )  # fmt: skip
        if found is not None:
            trainer.restore(found.state)
        make = partial(make_manifest, config, prepared, cache)
        outputs = stack.enter_context(
            open_outputs(config, start.targets, manifest, make, cache, start.sound)
        )

        def keep() -> None:
            state = trainer.state()
            save_checkpoint(start.checkpoint, state, outputs.pending, start.settings, options)

        if found is not None:
            outputs.deliver(found.pending)
        else:
            keep()
        first, swin_size = trainer.next_window, config.fit.swin_size
        progress.finished_frames = first
        progress.can_resume = True
        for frame in range(first, first + swin_size + 1):
            pictures.prefetch(frame, first)
        stack.enter_context(line)
        asked = stack.enter_context(interruptible())
        for window in trainer.windows():
            frame = window.first_frame
            # While the next window is trained, what the one after it brings is read. The frame that
            # was just finished is still scored.
            pictures.prefetch(frame + 1 + swin_size, frame)
            if window.updates:
                outputs.deliver(window.updates)
                trainer.strategy.record_sent_bytes(window, outputs.slice_bytes)
            elif config.rank == CONTRIBUTION:
                outputs.deliver(matured_by_contribution(trainer, window))
            else:
                outputs.deliver(window.slices)
            # Before the checkpoint: a run that is killed in between draws it again.
            if config.snapshot_every and frame % config.snapshot_every == 0:
                write_snapshot(
                    trainer.shown(frame), frame, cache, prepared.near_planes, config.work_folder
                )
            keep()
            progress.finished_frames = frame + 1
            shown = trainer.num_shown(frame)
            monitor.frame_finished(frame, shown, outputs.played_bytes, outputs.quality)
            if asked.is_set() and not progress.is_finished:
                raise KeyboardInterrupt
    forget_run(config.work_folder)
    return outputs.manifest
