"""A training run from end to end: a capture in, a stream out."""

from __future__ import annotations

import logging
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace

from rich.console import Console

from codec.stream import StreamReader
from codec.stream.manifest import Manifest
from trainer.errors import InterruptedRunError
from trainer.fit.trainer import Observer, Trainer
from trainer.pictures.feed import CapturePictures
from trainer.pictures.framecache import FrameCache
from trainer.rig.doubts import rig_doubts

from .checkpoint import CHECKPOINT_NAME, load_checkpoint, save_checkpoint
from .config import TrainConfig
from .monitor import Monitor
from .outputs import bare_targets, check_targets, clear_bare, open_outputs, write_snapshot
from .prepare import first_gaussians, make_manifest, prepare, shared_settings
from .progressline import ProgressLine
from .rank import CONTRIBUTION, matured_by_contribution
from .runlog import LOG_NAME, RunLog
from .storedconfig import config_to_json

log_to = logging.getLogger(__name__)


@contextmanager
def interruptible() -> Iterator[threading.Event]:
    """Ctrl-C sets the event, so that the running window can end; a second one ends at once."""
    asked = threading.Event()

    def stop(number: int, frame: object) -> None:
        if asked.is_set():
            raise KeyboardInterrupt
        asked.set()

    if threading.current_thread() is not threading.main_thread():
        yield asked
        return
    before = signal.signal(signal.SIGINT, stop)
    try:
        yield asked
    finally:
        signal.signal(signal.SIGINT, before)


def train_stream(
    config: TrainConfig,
    console: Console,
    on_checked: Callable[[], None] = lambda: None,
    observers: Sequence[Observer] = (),
) -> Manifest:
    """Trains `config.capture` into `config.stream`; progress goes to `console`.

    on_checked: called when capture and settings were found good, before anything is computed.
    observers: told of every window; one has ended when its frame and its checkpoint are written.

    Raises SwingsError before anything is written when the capture or the settings cannot work; what
    stops it later leaves a valid, shorter stream and a checkpoint to resume from.
    """
    config.check_profile()
    bare = bare_targets(config) if config.resume else []
    if bare:
        config = replace(config, resume=False)
    targets = check_targets(config, bare)
    with console.status("what the cameras see"):
        prepared = prepare(config)
    settings = shared_settings(config, prepared)
    checkpoint = config.work_folder / CHECKPOINT_NAME
    options = config_to_json(replace(config, resume=False))
    found = load_checkpoint(checkpoint, settings) if config.resume else None
    on_checked()
    console.print(f"backend: {prepared.picked.why}", highlight=False, markup=False, soft_wrap=True)
    if bare:
        log_to.warning(
            f"{config.target} was stopped before its first checkpoint; it begins anew, with the "
            "settings given now"
        )
    for doubt in rig_doubts(prepared.capture) if found is None else ():
        log_to.warning(doubt)
    clear_bare(bare)
    if config.work_folder != config.target:
        config.work_folder.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        cache = stack.enter_context(
            FrameCache(prepared.capture, prepared.frames, config.scale, config.cache_bytes)
        )
        pictures = CapturePictures(cache, prepared.capture.training)
        log_path = config.log or config.work_folder / LOG_NAME
        log = stack.enter_context(RunLog(log_path, config.tensorboard))
        if found is None:
            with console.status("first Gaussians"):
                initial = first_gaussians(config, prepared, pictures)
            manifest = make_manifest(config, prepared, cache, initial)
        else:
            initial, manifest = None, StreamReader(config.target, max_gaussians=None).manifest
        line = ProgressLine(console)
        monitor = Monitor(line, log, config.fit, len(prepared.frames))
        trainer = Trainer(
            config.fit, pictures, initial, prepared.near_m, prepared.far_m, prepared.picked.backend,
            (monitor, *observers), manifest.slot_layout if manifest.has_slots else None,
            prepared.search_from_m,
        )  # fmt: skip
        if found is not None:
            trainer.restore(found.state)
        outputs = stack.enter_context(open_outputs(config, targets, manifest, cache))
        if found is not None:
            outputs.deliver(found.pending)
        else:
            save_checkpoint(checkpoint, trainer.state(), outputs.pending, settings, options)
        first, swin_size = trainer.next_window, config.fit.swin_size
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
                trainer.spent(window, outputs.slice_bytes)
            elif config.rank == CONTRIBUTION:
                outputs.deliver(matured_by_contribution(trainer, window))
            else:
                outputs.deliver(window.slices)
            save_checkpoint(checkpoint, trainer.state(), outputs.pending, settings, options)
            shown = trainer.num_shown(frame)
            monitor.frame_finished(frame, shown, outputs.played_bytes, outputs.quality)
            if config.snapshot_every and frame % config.snapshot_every == 0:
                write_snapshot(
                    trainer.shown(frame), frame, cache, prepared.near_m, config.work_folder
                )
            if asked.is_set() and frame + 1 < len(prepared.frames):
                raise InterruptedRunError(
                    f"stopped after frame {frame}; --resume goes on from there"
                )
    checkpoint.unlink()
    return manifest
