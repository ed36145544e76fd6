"""Effect of one Gaussian on one row of pixels, function by function."""

from __future__ import annotations

import numpy as np

from player.render.blend import blend_pixel, exp_minus, rows_hit
from player.render.project import ALPHA_MAX, ALPHA_MIN, TILE_PX, TRANSMITTANCE_MIN

F = np.float32


def test_exp_minus_is_exact_to_two_millionths_where_anything_shows() -> None:
    q = np.linspace(0, 6, 5001, dtype=np.float32)
    got = np.array([exp_minus(x) for x in q])
    # 3e-8 from the polynomial, the rest from eight roundings squared three times
    assert np.abs(got / np.exp(-q.astype(np.float64)) - 1).max() < 2e-6


def test_rows_are_hit_where_the_ellipse_reaches_them() -> None:
    rng = np.random.default_rng(0)
    empty, full = 0, 0
    for _ in range(2000):
        # Conics of needles and discs, with tiles on them and outside.
        angle, (long_px, short_px) = rng.uniform(0, np.pi), rng.uniform(0.4, 9, 2)
        axes = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        conic = axes.T @ np.diag([long_px**-2, short_px**-2]) @ axes
        a, b, c = conic[0, 0], conic[0, 1], conic[1, 1]
        q_max, left, top = rng.uniform(0.1, 5.5), rng.uniform(-30, 15), rng.uniform(-30, 15)
        first, end = rows_hit(F(a), F(b), F(c), F(q_max), F(left), F(top))
        for row in range(TILE_PX):
            dy = top + row
            # Minimum distances of the row's pixel centres, and of their line, to the centre.
            dx = left + np.arange(TILE_PX)
            outside = (0.5 * (a * dx**2 + c * dy**2) + b * dx * dy).min() / q_max
            between = np.clip(-b * dy / a, left, left + TILE_PX - 1)
            on_line = (0.5 * (a * between**2 + c * dy**2) + b * between * dy) / q_max
            # A row is skipped only if the line through its pixel centres misses, too.
            hit = first <= row < end
            assert hit or outside > 0.999
            assert not hit or on_line < 1.001
        empty += first >= end
        full += end - first == TILE_PX
    assert 500 < empty < 1900
    assert full > 50


def test_thresholds_of_a_pixel() -> None:
    # Too opaque: clamped.
    alpha, weight, after = blend_pixel(F(1), F(0.999))
    assert (alpha, weight) == (F(ALPHA_MAX), F(ALPHA_MAX))
    np.testing.assert_allclose(after, 1 - ALPHA_MAX, rtol=1e-5)
    # Too faint: skipped.
    assert blend_pixel(F(0.7), F(0.99 * ALPHA_MIN))[1:] == (0, F(0.7))
    assert blend_pixel(F(0.7), F(ALPHA_MIN))[1] > 0
    # Too little transmittance after it: the pixel ends without its contribution.
    seen = F(2 * TRANSMITTANCE_MIN)
    assert blend_pixel(seen, F(0.6))[1:] == (0, 0)
    assert blend_pixel(seen, F(0.4))[1] > 0
    # An ended pixel stays ended.
    assert blend_pixel(F(0), F(0.4))[1:] == (0, 0)
