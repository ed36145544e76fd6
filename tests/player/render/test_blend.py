"""Effect of one Gaussian on one row of pixels, function by function."""

from __future__ import annotations

import numpy as np

from player.render.blend import blend_pixel, exp_minus
from player.render.recipe import ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN

F = np.float32


def test_exp_minus_is_exact_to_two_millionths_where_anything_shows() -> None:
    q = np.linspace(0, 6, 5001, dtype=np.float32)
    got = np.array([exp_minus(x) for x in q])
    # 3e-8 from the polynomial, the rest from eight roundings squared three times
    assert np.abs(got / np.exp(-q.astype(np.float64)) - 1).max() < 2e-6


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
