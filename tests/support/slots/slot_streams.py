"""Small streams of updates on disk, and a model of a player's display."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from codec.lattice.lattice import States
from codec.slice import Slice
from codec.slots.slotlayout import KEPT, NEW, PREDICTED, SlotLayout, Update
from codec.splats import Splats
from codec.stream import StreamWriter
from codec.stream.manifest import Manifest
from player.render.cpu import Ring
from tests.support.hosted_streams import small_manifest
from tests.support.slots.updates import patternless_updates, small_layout


def slot_manifest(layout: SlotLayout, **changes: object) -> Manifest:
    """A manifest of streams with the slots of `layout`."""
    values: dict[str, object] = {
        "swin_size": layout.swin_size,
        "segment_frames": layout.segment_frames,
        "slots": layout.slots,
        "lattice": layout.lattices,
    }
    return small_manifest(1, layout.sh_degree, **(values | changes))  # type: ignore[arg-type]


def write_slot_stream(
    path: Path, num_frames: int, layout: SlotLayout | None = None, seed: int = 0, **changes: object
) -> Path:
    """Writes a finished stream of random updates to `path`. changes: fields of the manifest."""
    layout = small_layout() if layout is None else layout
    with StreamWriter.create(path, slot_manifest(layout, **changes)) as writer:
        for update in patternless_updates(layout, num_frames, seed):
            writer.append(update)
    return path


def busy_updates(layout: SlotLayout, num_frames: int, seed: int = 0) -> Iterator[Update]:
    """Updates of a busy stream of SH degree 0: two thirds of the slots change in each slice. The
    Gaussians are in front of the cameras of `slot_manifest`."""
    rng = np.random.default_rng(seed)
    count = layout.num_slots
    levels = np.repeat([lattice.opacity_levels for lattice in layout.lattices], layout.slots)
    steps_m = np.repeat([lattice.position_m for lattice in layout.lattices], layout.slots)
    for birth in range(1 - layout.swin_size, num_frames):
        statuses = np.full(count, NEW, np.uint8)
        if birth > 0:
            statuses = rng.choice(np.array([KEPT, PREDICTED, NEW], np.uint8), count)
        coded = np.flatnonzero(statuses >= PREDICTED)
        means = rng.uniform((-1, -1, 3), (1, 1, 5), (len(coded), 3))
        positions = np.rint(means / steps_m[coded, None]).astype(np.int32)
        attributes = rng.integers(0, 256, (len(coded), layout.num_planes - 3)).astype(np.uint8)
        # Log-scales of -4 to -1, so that the Gaussians are visible.
        attributes[:, :3] = rng.integers(-32, -8, (len(coded), 3)).astype(np.int8).view(np.uint8)
        attributes[:, -1] = rng.integers(0, levels[coded])
        yield Update(
            birth,
            statuses,
            States(positions, attributes),
            np.zeros(len(coded), np.uint8),
            np.zeros(len(coded), np.bool_),
            Splats.empty(layout.sh_degree),
        )


def write_busy_stream(path: Path, num_frames: int, layout: SlotLayout, **changes: object) -> Path:
    """Writes a finished stream of `busy_updates` to `path`. changes: fields of the manifest."""
    with StreamWriter.create(path, slot_manifest(layout, **changes)) as writer:
        for update in busy_updates(layout, num_frames):
            writer.append(update)
    return path


class Shown:
    """The lanes of a player, which follow only the rules of slices."""

    def __init__(self, manifest: Manifest) -> None:
        self._ring = Ring(manifest.swin_size, manifest.slice_size, manifest.sh_degree)

    def after(self, slices: Iterable[Slice], frame: int) -> Splats:
        """The Gaussians shown at `frame` after `slices` have arrived, too."""
        for slice in slices:
            self._ring.put(slice)
        return self._ring.active(frame)


def gaussians(splats: Splats) -> Counter[bytes]:
    """Number of occurrences of each Gaussian."""
    flat = [array.reshape(len(splats), math.prod(array.shape[1:])) for array in splats.arrays]
    rows = np.concatenate(flat, axis=1)
    data, size = rows.tobytes(), rows.shape[1] * rows.itemsize
    return Counter(data[i : i + size] for i in range(0, len(data), size))
