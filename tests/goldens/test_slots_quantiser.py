"""What section 14.1 guarantees can be kept."""

from __future__ import annotations

import math
import random

import pytest

from tests.goldens.format_decoder import f32
from tests.goldens.slots_cases import FINE
from tests.goldens.slots_decoder import Floats, Gaussian, to_floats
from tests.goldens.slots_quantiser import chosen_form, dot, forms, levels_of, quantised

ROUNDING = 1e-3
"""Of f32, in steps."""


def unit(values: list[float]) -> tuple[float, ...]:
    length = math.sqrt(dot(values, values))
    return tuple(v / length for v in values)


def random_floats(rng: random.Random) -> Floats:
    return Floats(
        tuple(rng.uniform(-3, 3) for _ in range(3)),
        tuple(rng.uniform(-9, 0) for _ in range(3)),
        unit([rng.gauss(0, 1) for _ in range(4)]),
        rng.uniform(-4, 4),
        (tuple(rng.uniform(-1, 1) for _ in range(3)),),
    )


def nudged(floats: Floats, rng: random.Random, by: float) -> Floats:
    def near(values: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(v + rng.uniform(-by, by) for v in values)

    quat = unit(list(near(floats.quat)))
    sh = tuple(map(near, floats.sh))
    return Floats(near(floats.mean), near(floats.log_scales), quat, floats.logit_opacity, sh)


def covariance(floats: Floats) -> list[float]:
    w, x, y, z = unit(list(floats.quat))
    axes = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    variances = [math.exp(2 * s) for s in floats.log_scales]
    return [
        sum(a * b * v for a, b, v in zip(first, second, variances, strict=True))
        for first in axes
        for second in axes
    ]


def test_24_forms_are_one_gaussian() -> None:
    rng = random.Random(1)
    for _ in range(20):
        floats = random_floats(rng)
        found = forms(floats)
        assert len({tuple(round(v, 6) for v in (*q, *s)) for q, s in found}) == 24
        for quat, scales in found:
            form = Floats(floats.mean, scales, quat, 0.0, floats.sh)
            assert covariance(form) == pytest.approx(covariance(floats), abs=1e-9)


def test_every_number_of_a_new_one_is_within_half_a_step() -> None:
    rng = random.Random(2)
    for _ in range(500):
        floats = random_floats(rng)
        gaussian = quantised(floats, FINE, None, 7)
        assert gaussian is not None
        found = to_floats(gaussian, FINE)
        form = chosen_form(floats, None)
        assert form[0][0] >= 0.5
        levels = levels_of(floats, form, FINE)
        back = levels_of(found, (found.quat, found.log_scales), FINE)
        for i, (a, b) in enumerate(zip(levels, back, strict=True)):
            assert abs(a - b) <= 0.5 + ROUNDING or (3 <= i < 6 and a < -128 == round(b))


def test_a_scale_below_the_lattice_is_clamped_and_one_above_escapes() -> None:
    floats = Floats((0.0,) * 3, (-40.0, -3.0, 0.0), (1.0, 0.0, 0.0, 0.0), 0.0, ((0.0,) * 3,))
    flat = quantised(floats, FINE, None, 0)
    assert flat is not None
    assert flat.attributes[:3] == (-128, 0, 60)
    assert to_floats(flat, FINE).log_scales[0] == f32(f32(-128 * FINE.log_scale) - 3)
    large = Floats(floats.mean, (9.0, 0.0, 0.0), floats.quat, 0.0, floats.sh)
    assert quantised(large, FINE, None, 0) is None


@pytest.mark.parametrize("held_steps", [0, 1.5, 4])
def test_held_numbers_stay_near_however_long_they_are_held(held_steps: float) -> None:
    rng = random.Random(3)
    held = 0
    for _ in range(30):
        floats, before = random_floats(rng), None
        for birth in range(20):
            after: Gaussian | None = quantised(floats, FINE, before, birth, held_steps)
            if after is None:
                break
            form = chosen_form(floats, None if before is None else to_floats(before, FINE))
            levels = levels_of(floats, form, FINE)
            for i, (a, b) in enumerate(
                zip(levels, (*after.position, *after.attributes), strict=True)
            ):
                clamped = 3 <= i < 6 and a < -128
                assert clamped or abs(a - b) <= max(held_steps, 0.5)
                held += not clamped and abs(a - b) > 0.5
            before, floats = after, nudged(floats, rng, 0.005)
    assert (held > 20) == (held_steps > 0)


def test_the_form_of_a_predicted_one_does_not_jump() -> None:
    """Whole turns about an axis, with axes that change places in size: half steps are small."""
    rng = random.Random(4)
    for _ in range(20):
        first, before = random_floats(rng), None
        x, y, z = unit([rng.gauss(0, 1) for _ in range(3)])
        for frame in range(200):
            half = math.pi * frame / 100
            s = math.sin(half)
            quat = (math.cos(half), s * x, s * y, s * z)
            scales = tuple(-3 + math.sin(half + i) for i in range(3))
            floats = Floats(first.mean, scales, quat, 0.0, first.sh)
            after = quantised(floats, FINE, before, frame)
            assert after is not None
            if before is not None:
                old, new = (to_floats(g, FINE) for g in (before, after))
                assert abs(dot(unit(list(old.quat)), unit(list(new.quat)))) > 0.98
                moves = zip(old.log_scales, new.log_scales, strict=True)
                assert all(abs(a - b) < 0.1 for a, b in moves)
            before = after
