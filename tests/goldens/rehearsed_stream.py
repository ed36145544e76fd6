"""The stream of the player's rehearsal; `regenerate` writes it into player/rehearsed."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np

import player
from codec.camera import Camera
from codec.lattice.lattice import Lattice, States, quantise
from codec.slots.slotlayout import KEPT, NEW, PREDICTED, Update
from codec.splats import Splats
from codec.stream import StreamWriter
from codec.stream.manifest import Manifest

FOLDER = Path(player.__file__).with_name("rehearsed")
NUM_FRAMES, _SWIN_SIZE, _SLICE_SIZE, _SIZE_PX = 2, 2, 60, 32
_CAMERA = Camera("front", _SIZE_PX, _SIZE_PX, 30.0, 30.0, 16.0, 16.0, np.eye(4))


def write_rehearsed(folder: Path) -> None:
    """Writes a stream of new, predicted and kept Gaussians as `folder`, and replaces an old one."""
    shutil.rmtree(folder, ignore_errors=True)
    splats = _some_splats()
    lattice = Lattice.suiting(splats)
    states, _ = quantise(splats, lattice)
    with StreamWriter.create(folder, _manifest(lattice)) as writer:
        for birth in range(1 - _SWIN_SIZE, NUM_FRAMES):
            writer.append(_update(birth, states))


def _some_splats() -> Splats:
    rng = np.random.default_rng(0)
    arrays = (
        rng.uniform((-0.5, -0.5, 3), (0.5, 0.5, 4), (_SLICE_SIZE, 3)),
        np.full((_SLICE_SIZE, 3), -2.0),
        rng.normal(size=(_SLICE_SIZE, 4)),
        np.full(_SLICE_SIZE, 2.0),
        rng.normal(size=(_SLICE_SIZE, 16, 3)),
    )
    return Splats(*(array.astype(np.float32) for array in arrays))


def _manifest(lattice: Lattice) -> Manifest:
    return Manifest(
        fps=30.0,
        swin_size=_SWIN_SIZE,
        slots=(_SLICE_SIZE,),
        lattice=(lattice,),
        segment_frames=NUM_FRAMES,
        sh_degree=3,
        antialias=False,
        near_m=0.1,
        bounds=((-1.0, -1.0, 2.0), (1.0, 1.0, 5.0)),
        cameras=(_CAMERA,),
        default_camera=_CAMERA.name,
        live=False,
    )


def _update(birth: int, states: States) -> Update:
    statuses = np.full(_SLICE_SIZE, NEW, np.uint8)
    if birth > 0:
        statuses[1:] = PREDICTED
        statuses[-1] = KEPT
        # A tenth of the numbers change: such planes take less if they are coded.
        attributes = states.attributes.copy()
        attributes[:, :-1] += np.random.default_rng(1).random(attributes[:, :-1].shape) < 0.1
        states = replace(states, attributes=attributes)
    coded = np.flatnonzero(statuses)
    nothing = np.zeros(len(coded), np.uint8)
    return Update(
        birth, statuses, states.take(coded), nothing, nothing.astype(np.bool_), Splats.empty(3)
    )
