"""Shapes of streams for tests."""

from __future__ import annotations

from tests.goldens.decoder import Lattice, Shape, f32

FINE = Lattice(f32(0.001), f32(0.05), -3.0, f32(1 / 127), f32(0.02), 256)
COARSE = Lattice(f32(0.01), f32(0.1), 0.5, f32(0.01), f32(0.03), 16)


def make_shape(
    swin_size: int = 3, segment_frames: int = 7, k: int = 1, slots: tuple[int, ...] = (9, 5)
) -> Shape:
    return Shape(swin_size, segment_frames, k, slots, (FINE, COARSE, FINE)[: len(slots)])
