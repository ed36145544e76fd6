"""Compiles every kernel of training before training begins.

Numba keeps compiled kernels on disk. The process that compiles them may round differently from
those that load them, and a run must give the same bytes whether it is the first after an install or
not; so a process that has compiled something starts over.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from functools import partial

import numpy as np
from numba.core.event import Event, Listener, install_listener
from rich.console import Console

from codec.camera import Camera
from codec.lattice.lattice import Lattice
from codec.progressline import waiting
from codec.slots.changepacket import change_content, encode_change_packet
from codec.slots.decoder import SlotDecoder
from codec.slots.encoder import SlotEncoder
from codec.slots.slotlayout import SlotLayout
from codec.splats import Splats
from codec.stream.segment import encode_packet
from codec.stream.wholeslice import given_rank, whole_update
from player.render.cpu import render_splats
from trainer.capture.capture import Mask
from trainer.capture.lens import Lens, straightened
from trainer.fit.config import FitConfig
from trainer.fit.leasedslots import LeasedSlots
from trainer.fit.mcmc import McmcConfig
from trainer.fit.trainer import SMALLEST_HALVED_PX, Trainer
from trainer.lease.leases import LeaseConfig
from trainer.pictures.scale import Shot
from trainer.seed.gaussians import initial_splats, stereo_seeds
from trainer.storedfiles import forget_stored

from .outputs import matured_by_contribution

_STARTED_OVER = "SWINGS_STARTED_OVER"
"""Environment variable that ends the second try where numba cannot keep what it compiles."""


class _Noise:
    """The pictures of three cameras in a row, at the smallest size that genesis halves."""

    num_frames = 3  # so that a window brings a new frame

    def __init__(self) -> None:
        side_px = SMALLEST_HALVED_PX
        self.cameras = []
        for i in range(3):
            w2c = np.eye(4)
            w2c[0, 3] = 0.2 * i
            middle_px = side_px / 2
            self.cameras.append(
                Camera(f"{i}", side_px, side_px, 60.0, 60.0, middle_px, middle_px, w2c)
            )
        shape = self.num_frames, side_px, side_px, 3
        pictures = np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)
        mask = np.ones((side_px, side_px), np.uint8)
        # Like those of a FrameCache: numba compiles anew for arrays that may be written to.
        pictures.setflags(write=False)
        mask.setflags(write=False)
        self._shots = [Shot(picture, mask) for picture in pictures]

    def shot(self, camera: int, frame: int) -> Shot:
        return self._shots[frame]

    def mask(self, camera: int, frame: int) -> Mask | None:
        return self._shots[frame].mask


OURS = ("trainer", "player", "codec")
"""Packages with kernels."""


class _OnCompiling(Listener):
    """Says once that a kernel of ours is compiled: one that is read from disk is not."""

    def __init__(self, say: Callable[[], object]) -> None:
        self._say, self._has_said = say, False

    def on_start(self, event: Event) -> None:
        module: str = event.data["dispatcher"].py_func.__module__
        if not self._has_said and module.split(".")[0] in OURS:
            self._has_said = True
            self._say()

    def on_end(self, event: Event) -> None:
        """Nothing is said of the end."""


def _misses() -> int:
    """Kernels of ours that this process has compiled."""
    from numba.core.dispatcher import Dispatcher

    return sum(
        sum(value.stats.cache_misses.values())
        for name, module in list(sys.modules.items())
        if name.split(".")[0] in OURS
        for value in vars(module).values()
        if isinstance(value, Dispatcher)
    )


def compile_kernels(sh_degree: int) -> bool:
    """Runs every kernel that training with `sh_degree` runs; whether any had to be compiled."""
    pictures = _Noise()
    rng = np.random.default_rng(0)
    picture = pictures.shot(0, 0).picture
    stereo_seeds(pictures.cameras, [picture] * 3, 8, 1.0, 10.0, rng)
    points = rng.uniform((-1, -1, 2), (1, 1, 4), (8, 3)).astype(np.float32)
    initial = initial_splats(points, np.full((8, 3), 128, np.uint8), sh_degree)
    config = FitConfig(
        num_gs=8,
        swin_size=2,
        sh_degree=sh_degree,
        genesis_iterations=4,
        settle_rounds=1,
        window_iterations=2,
        coarse_share=0.5,
        mcmc=McmcConfig(relocate_period=1, renew_share=0.5),
    )
    _train_with_slots(config, pictures, initial)
    trainer = Trainer(config, pictures, initial, 0.2)
    layout = SlotLayout(config.swin_size, (3, 1), sh_degree, (Lattice.suiting(initial),) * 2, 4)
    straightened(picture, pictures.cameras[0], Lens(k1=0.01))
    for window in trainer.windows():
        for part in matured_by_contribution(trainer, window):
            whole_update(part, layout, given_rank)
    render_splats(trainer.shown(1), pictures.cameras[0], 0.2)
    return _misses() > 0


def _train_with_slots(config: FitConfig, pictures: _Noise, initial: Splats) -> None:
    """Runs what only leased slots need, up to what a reader makes of their chunks."""
    lease = LeaseConfig(active_share=0.5, hold=0.6)
    config = replace(config, prefix_share=0.5, scene_flow=True, lease=lease)
    lattices = (Lattice.suiting(initial),) * 2
    layout = SlotLayout(config.swin_size, (3, 1), config.sh_degree, lattices, 4)
    trainer = Trainer(config, pictures, initial, 0.2, strategy=partial(LeasedSlots, layout=layout))
    encoder, decoder = SlotEncoder(layout), SlotDecoder(layout)
    for window in trainer.windows():
        for update in window.updates:
            encoded = encoder.append(update)
            if update.birth == 0:
                for layer, keyframe in enumerate(encoder.keyframes()):
                    decoder.load(keyframe.data, layer, 0)
            elif encoded is not None:
                for change in encoded.changes:
                    encode_packet(change)
                    if change.data:
                        coded = encode_change_packet(change.data, layout.sh_degree)
                        change_content(coded, len(change.data))
                changes = [change.data for change in encoded.changes]
                decoder.apply(update.birth, encoded.skip_map.data, changes)
    decoder.whole(update.birth)


def start_over_if_compiled(sh_degree: int, console: Console) -> None:
    """Does not return where a kernel had to be compiled: this program is started once more."""
    started_over = _STARTED_OVER in os.environ
    with ExitStack() as stack:

        def say() -> None:
            stack.enter_context(waiting(console, "compiling kernels (half a minute, once)"))

        with install_listener("numba:compile", _OnCompiling(say)):
            compiled = compile_kernels(sh_degree)
    if compiled and not started_over:
        os.environ[_STARTED_OVER] = "1"
        sys.stdout.flush()
        sys.stderr.flush()
        forget_stored()
        os.execv(sys.executable, sys.orig_argv)
