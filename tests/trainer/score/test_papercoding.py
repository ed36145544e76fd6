"""The paper's quantisation: within the precision of fp16 and bytes, without clamping."""

from __future__ import annotations

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
from trainer.score.papercoding import ATTRIBUTES, quantise_attribute

FIELDS = {
    "means": "means",
    "rotation": "quats",
    "scale": "log_scales",
    "feat": "sh",
    "opacity": "logit_opacities",
}


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
        numbers(count, 3),
        numbers(count, 3),
        quats.astype(np.float32),
        numbers(count),
        numbers(count, sh_count(degree), 3),
    )


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
@settings(max_examples=80, deadline=None)
def test_every_value_is_within_its_bit_depth(splats: Splats) -> None:
    found = quantise_case(splats, "all")
    assert (error(found.means, splats.means) <= half_error(splats.means)).all()
    assert (error(found.log_scales, splats.log_scales) <= half_error(splats.log_scales)).all()
    assert (error(found.sh, splats.sh) <= half_error(splats.sh)).all()
    units = unit(splats.quats)
    turned = np.abs(found.quats - units)
    assert (turned <= np.where(units > 127.5 / 128, 1 / 128, 1 / 256) + 1e-12).all()
    # float32 rounds the opacities before and after.
    assert (error(found.opacities, splats.opacities) <= 1 / 510 + 3e-7).all()


@given(gaussians())
@settings(max_examples=30, deadline=None)
def test_a_second_time_changes_nothing_but_lengths_of_quaternions(splats: Splats) -> None:
    once = quantise_case(splats, "all")
    twice = quantise_case(once, "all")
    assert same(once, twice, but="quats")
    assert (np.abs(unit(once.quats) - twice.quats) <= 1 / 128 + 1e-12).all()


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


@pytest.mark.parametrize("value", [65504.0, 65519.0, -65519.0])
def test_the_largest_fp16_fits(value: float) -> None:
    splats = trained_like_splats(3)
    splats.means[1, 2] = value
    found = quantise_attribute(splats, "means").means
    assert found[1, 2] == np.copysign(np.float32(65504), np.float32(value))


def test_scales_of_any_unit_keep_their_logarithm() -> None:
    # The standard deviation 1e-9 m would be 0 as a linear fp16.
    splats = trained_like_splats(3)
    splats.log_scales[:] = np.log(1e-9)
    found = quantise_attribute(splats, "scale").log_scales
    assert np.exp(found) == pytest.approx(1e-9, rel=0.01)


def test_extreme_opacities_stay_finite() -> None:
    splats = trained_like_splats(2)
    splats.logit_opacities[:] = (-1e30, 1e30)
    assert quantise_attribute(splats, "opacity").logit_opacities.tolist() == [-MAX_LOGIT, MAX_LOGIT]


@pytest.mark.parametrize("attribute", list(ATTRIBUTES))
@pytest.mark.parametrize("sh_degree", [0, 2])
def test_one_attribute_at_a_time(attribute: str, sh_degree: int) -> None:
    splats = trained_like_splats(200, sh_degree=sh_degree)
    kept = [getattr(splats, name).copy() for name in FIELDS.values()]
    found = quantise_attribute(splats, attribute)
    field = FIELDS[attribute]
    assert same(found, splats, but=field)
    assert (getattr(found, field) != getattr(splats, field)).any()
    for before, name in zip(kept, FIELDS.values(), strict=True):
        assert before.tobytes() == getattr(splats, name).tobytes()


def test_the_columns_are_those_of_table_6() -> None:
    assert list(ATTRIBUTES) == ["means", "rotation", "scale", "feat", "opacity"]
    with pytest.raises(InvalidError, match="'colour' is not one of means, rotation"):
        quantise_attribute(Splats.empty(), "colour")
