"""The paper's quantisation: within the precision of fp16 and bytes, without clamping."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.errors import InvalidError
from codec.lattice.quantise import MAX_LOGIT
from codec.pose import Doubles
from codec.splats import Floats, Splats, sh_count
from tests.support.trained_like import trained_like_splats
from trainer.score.ablation import quantise_case
from trainer.score.papercoding import quantise_attribute

FIELDS = {
    "means": "means", "rotation": "quats", "scale": "log_scales", "feat": "sh",
    "opacity": "logit_opacities",
}  # fmt: skip
"""The field of each column of the paper's Table 6."""


@st.composite
def gaussians(draw: st.DrawFn) -> Splats:
    """Up to 40 Gaussians in the range of fp16, with numbers of any magnitude."""
    count = draw(st.integers(0, 40))
    degree = draw(st.integers(0, 3))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    largest = 2.0 ** draw(st.integers(-30, 15))

    def numbers(*shape: int) -> Floats:
        return rng.uniform(-largest, largest, shape).astype(np.float32)

    quats = rng.normal(size=(count, 4))
    if draw(st.booleans()):
        quats[:, 1:] *= 0.01  # hardly turned: one component near 1 or -1
    quats *= 10.0 ** draw(st.integers(-30, 30))
    return Splats(
        numbers(count, 3), numbers(count, 3), quats.astype(np.float32), numbers(count),
        numbers(count, sh_count(degree), 3),
    )  # fmt: skip


def half_error(values: Floats) -> Doubles:
    """Half the distance between neighbouring fp16 at `values`: 11 bits, down to 2^-24."""
    bound: Doubles = np.maximum(2.0**-11 * np.abs(values.astype(np.float64)), 2.0**-25)
    return bound


def error(found: Floats, expected: Floats) -> Doubles:
    difference: Doubles = np.abs(found.astype(np.float64) - expected)
    return difference


def unit(quats: Floats) -> Doubles:
    doubles = quats.astype(np.float64)
    units: Doubles = doubles / np.linalg.norm(doubles, axis=1, keepdims=True)
    return units


def same(a: Splats, b: Splats, but: str = "") -> bool:
    """Whether all fields except `but` are equal bit for bit."""
    names = set(FIELDS.values()) - {but}
    return all(getattr(a, name).tobytes() == getattr(b, name).tobytes() for name in names)


@given(gaussians())
@settings(max_examples=40, deadline=None)
def test_every_value_is_within_its_bit_depth_and_a_second_time_changes_nothing(
    splats: Splats,
) -> None:
    found = quantise_case(splats, "all")
    assert (error(found.means, splats.means) <= half_error(splats.means)).all()
    assert (error(found.log_scales, splats.log_scales) <= half_error(splats.log_scales)).all()
    assert (error(found.sh, splats.sh) <= half_error(splats.sh)).all()
    units = unit(splats.quats)
    turned = np.abs(found.quats - units)
    assert (turned <= np.where(units > 127.5 / 128, 1 / 128, 1 / 256) + 1e-12).all()
    # float32 rounds the opacities before and after.
    assert (error(found.opacities, splats.opacities) <= 1 / 510 + 3e-7).all()
    twice = quantise_case(found, "all")  # but for the lengths of quaternions
    assert same(found, twice, but="quats")
    assert (np.abs(unit(found.quats) - twice.quats) <= 1 / 128 + 1e-12).all()


@pytest.mark.parametrize(
    ("attribute", "what"), [("means", "position"), ("scale", "log-scale"), ("feat", "colour")]
)
@pytest.mark.parametrize("value", [65520.0, -7e4, 3e38])
def test_what_fp16_cannot_hold_is_refused_in_one_line(
    attribute: str, what: str, value: float
) -> None:
    splats = trained_like_splats(10)
    getattr(splats, FIELDS[attribute]).flat[7] = value
    with pytest.raises(InvalidError, match=rf"^paper: a {what} of .* does not fit fp16.*\)$"):
        quantise_attribute(splats, attribute)
    # The paper's streams do not change colours.
    if attribute == "feat":
        assert quantise_case(splats, "all but feat").sh.tobytes() == splats.sh.tobytes()


def test_the_largest_fp16_fits_and_extreme_opacities_stay_finite() -> None:
    splats = trained_like_splats(3)
    splats.logit_opacities[:] = (-1e30, 0, 1e30)
    for value in (65504.0, 65519.0, -65519.0):
        splats.means[1, 2] = value
        found = quantise_attribute(splats, "means").means
        assert found[1, 2] == np.copysign(np.float32(65504), np.float32(value))
    low, _, high = quantise_attribute(splats, "opacity").logit_opacities.tolist()
    assert (low, high) == (-MAX_LOGIT, MAX_LOGIT)
    # The standard deviation 1e-9 m would be 0 as a linear fp16.
    splats.log_scales[:] = np.log(1e-9)
    assert np.exp(quantise_attribute(splats, "scale").log_scales) == pytest.approx(1e-9, rel=0.01)


@pytest.mark.parametrize("attribute", ["means", "rotation", "scale", "feat", "opacity"])
def test_one_attribute_at_a_time(attribute: str) -> None:
    splats = trained_like_splats(200, sh_degree=2)
    kept = replace(splats, **{name: getattr(splats, name).copy() for name in FIELDS.values()})
    found = quantise_attribute(splats, attribute)
    assert same(found, splats, but=FIELDS[attribute])
    assert not same(found, splats)
    assert same(kept, splats)
    with pytest.raises(InvalidError, match="'colour' is not one of means, rotation, scale, feat"):
        quantise_attribute(splats, "colour")
