"""The CPU renderer, compared with the ring that it draws."""

from __future__ import annotations

import numpy as np

from player.render.cpu import CpuRenderer, render_splats
from player.render.ring import Ring
from tests.support.hosted_streams import SWIN_SIZE, random_slice, small_manifest


def test_the_cpu_renderer_shows_slices_from_their_birth_on() -> None:
    manifest = small_manifest(slice_size=50)
    cpu, ring = CpuRenderer(manifest), Ring(SWIN_SIZE, 50, 1)
    for birth in range(1 - SWIN_SIZE, 4):
        cpu.put(random_slice(birth, 50))
    for birth in range(1 - SWIN_SIZE, 4):
        ring.put(random_slice(birth, 50))
        if birth >= 0:
            expected = render_splats(ring.active(birth), manifest.camera(), manifest.near_m)
            np.testing.assert_array_equal(cpu.render(birth, manifest.camera()), expected)
    assert cpu.uploaded_bytes == (SWIN_SIZE + 3) * 50 * (4 * (3 + 3 + 4 + 1 + 12) + 1)
