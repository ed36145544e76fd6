"""Updates of slots whose Gaussians move slightly, jump, end, begin, or are replaced by others."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from codec.arrays import Floats
from codec.lattice.lattice import Lattice, States
from codec.slots.slotlayout import ENDED, KEPT, NEW, PREDICTED, SlotLayout, Update
from codec.splats import Splats
from codec.stream import StreamWriter
from tests.support.slots.slot_streams import slot_manifest

MOVED, JUMPED, ENDED_NOW, REUSED, BEGUN = 0.5, 0.01, 0.01, 0.01, 0.1
"""Shares of the slots with a Gaussian; the last is a share of the empty slots."""

STEP_M, TURN, GROWTH, FADE = 0.02, 3, 1, 5
"""Maximum changes of a Gaussian per frame: in metres, and in steps of the lattice."""


def moving_updates(layout: SlotLayout, num_frames: int, seed: int = 0) -> Iterator[Update]:
    """Updates of a stream of one lane in front of the cameras of `slot_manifest`. A fifth of the
    slots is empty at first."""
    rng = np.random.default_rng(seed)
    count = layout.num_slots
    levels = np.repeat([lattice.opacity_levels for lattice in layout.lattices], layout.slots)
    steps_m = np.repeat([lattice.position_m for lattice in layout.lattices], layout.slots)
    here = np.zeros(count, np.bool_)
    positions = np.zeros((count, 3), np.int64)
    attributes = np.zeros((count, layout.num_planes - 3), np.int64)
    for birth in range(num_frames):
        draw = rng.random(count)
        statuses = np.full(count, KEPT, np.uint8)
        if birth == 0:
            statuses[draw < 0.8] = NEW
        else:
            edges = np.cumsum([MOVED, JUMPED, ENDED_NOW, REUSED])
            kinds = np.array([PREDICTED, PREDICTED, ENDED, NEW, KEPT], np.uint8)
            statuses[here] = kinds[np.searchsorted(edges, draw[here], "right")]
            statuses[~here & (draw < BEGUN)] = NEW
        new, moved = statuses == NEW, statuses == PREDICTED
        jumped = moved & (draw >= MOVED)
        places_m = rng.uniform((-1, -1, 3), (1, 1, 5), (count, 3))
        anywhere = np.rint(places_m / steps_m[:, None]).astype(np.int64)
        way = np.rint(rng.uniform(-STEP_M, STEP_M, (count, 3)) / steps_m[:, None]).astype(np.int64)
        positions = np.where((new | jumped)[:, None], anywhere, positions + way * moved[:, None])
        made = rng.integers(-128, 128, attributes.shape)
        made[:, :3] = rng.integers(-32, -24, (count, 3))
        made[:, 3:6] = rng.integers(-8, 8, (count, 3))
        made[:, -1] = rng.integers(0, levels)
        turned = attributes.copy()
        turned[:, :3] += rng.integers(-GROWTH, GROWTH + 1, (count, 3))
        turned[:, 3:6] += rng.integers(-TURN, TURN + 1, (count, 3))
        turned[:, -1] += rng.integers(-FADE, FADE + 1, count)
        turned[:, :-1] = turned[:, :-1].clip(-128, 127)
        turned[:, -1] = turned[:, -1].clip(0, levels - 1)
        attributes = np.where(new[:, None], made, np.where(moved[:, None], turned, attributes))
        here = (here | new) & (statuses != ENDED)
        coded = np.flatnonzero(new | moved)
        states = States(positions[coded].astype(np.int32), attributes[coded].astype(np.uint8))
        nothing = np.zeros(len(coded), np.uint8)
        yield Update(birth, statuses, states, nothing, nothing > 0, Splats.empty(layout.sh_degree))


def write_jumps(path: Path, num_frames: int, at_frame: int, places_m: Floats) -> Path:
    """Writes a stream of three equal Gaussians at the first three of `places_m` (5, 3). At
    `at_frame` the first one jumps to the fourth place, and the slot of the second one gets a new
    Gaussian at the last place."""
    lattice = Lattice(0.01, 0.125, 1 / 60, 0.056, 161)
    layout = SlotLayout(1, (3,), 0, (lattice,), num_frames)
    attributes = np.zeros((3, layout.num_planes - 3), np.uint8)
    attributes[:, :3], attributes[:, -1] = np.int8(-24).view(np.uint8), 160
    attributes[:, 6] = 20
    positions = np.rint(places_m / lattice.position_m).astype(np.int32)
    with StreamWriter.create(path, slot_manifest(layout)) as writer:
        for birth in range(num_frames):
            statuses, rows = np.full(3, NEW, np.uint8), [0, 1, 2]
            if birth > 0:
                moves = birth == at_frame
                statuses = np.array([PREDICTED, NEW, KEPT] if moves else [KEPT] * 3, np.uint8)
                rows = [3, 4] if moves else []
            states = States(positions[rows], attributes[: len(rows)])
            nothing = np.zeros(len(rows), np.uint8)
            writer.append(Update(birth, statuses, states, nothing, nothing > 0, Splats.empty(0)))
    return path


def write_moving_stream(path: Path, num_frames: int, layout: SlotLayout, **changes: object) -> Path:
    """Writes a finished stream of `moving_updates` to `path`. changes: fields of the manifest."""
    with StreamWriter.create(path, slot_manifest(layout, **changes)) as writer:
        for update in moving_updates(layout, num_frames):
            writer.append(update)
    return path
