"""Shapes of streams to try version 2 with, and how to compare what comes back."""

from __future__ import annotations

from tests.goldens.format_decoder import f32
from tests.goldens.slots_decoder import Gaussian, Lattice, Shape, Slot
from tests.goldens.slots_folder import without_passed_starts

FINE = Lattice(f32(0.001), f32(0.05), -3.0, f32(1 / 127), f32(0.02), 256)
COARSE = Lattice(f32(0.01), f32(0.1), 0.5, f32(0.01), f32(0.03), 16)


def make_shape(
    swin_size: int = 3, segment_frames: int = 7, k: int = 1, slots: tuple[int, ...] = (9, 5)
) -> Shape:
    return Shape(swin_size, segment_frames, k, slots, (FINE, COARSE, FINE)[: len(slots)])


SHAPES = [
    make_shape(),
    make_shape(swin_size=1, segment_frames=4),
    make_shape(swin_size=5, segment_frames=3, k=4, slots=(1, 4, 2)),
    make_shape(swin_size=2, segment_frames=30, k=16, slots=(6,)),
]


def seen(gaussian: Slot) -> object:
    """What must come back, bit for bit."""
    if isinstance(gaussian, Gaussian) and gaussian.escaped:
        return gaussian.start, gaussian.escaped
    return gaussian


def assert_same(found: list[list[list[Slot]]], truth: list[list[list[Slot]]], frame: int) -> None:
    found, truth = (without_passed_starts(lanes, frame) for lanes in (found, truth))
    for lane, true_lane in zip(found, truth, strict=True):
        for slots, true_slots in zip(lane, true_lane, strict=True):
            assert list(map(seen, slots)) == list(map(seen, true_slots))
