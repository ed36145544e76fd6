"""The paper's quantisation, within the precision of fp16 and bytes; and its ablation, one
attribute at a time, on real files with exact floats."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.errors import InvalidError
from codec.lattice.lattice import Lattice
from codec.lattice.quantise import MAX_LOGIT
from codec.pose import Doubles
from codec.rig import rig_centre
from codec.slice import Slice
from codec.splats import Floats, Splats, sh_count
from codec.stream import StreamWriter
from tests.support.commands import run, run_ok
from tests.support.tiny_capture import seen_by, write_dynamic3dgs
from tests.support.tiny_stream import tiny_manifest
from tests.support.trained_like import trained_like_splats
from trainer.score.ablation import CASES, Ablation, ablate_quantisation, quantise_case
from trainer.score.evaluate import EvaluateConfig, evaluate_stream
from trainer.score.papercoding import quantise_attribute

FRAMES, SWIN, SLOTS = 3, 2, (30, 30)
SLICE_SIZE = sum(SLOTS)


def coarse_slice(birth: int, centre: np.ndarray, sh_degree: int) -> Slice:
    """Clearly visible Gaussians; only their colours fit fp16 without loss."""
    rng = np.random.default_rng(birth + 9)
    splats = Splats(
        (centre + rng.normal(0, 0.7, (SLICE_SIZE, 3))).astype(np.float32),
        rng.normal(-1.5, 0.4, (SLICE_SIZE, 3)).astype(np.float32),
        rng.normal(size=(SLICE_SIZE, 4)).astype(np.float32),
        rng.normal(0, 1, SLICE_SIZE).astype(np.float32),
        (rng.integers(-9, 9, (SLICE_SIZE, sh_count(sh_degree), 3)) / 8).astype(np.float32),
    )
    return Slice(birth, splats, np.zeros(SLICE_SIZE, np.uint8))


@dataclass(frozen=True)
class Made:
    """A capture, and streams of the same Gaussians: exact ones, of which one is quantised as in the
    paper and one has colours of degree 1, and one on a lattice."""

    capture: Path
    raw: Path
    paper: Path
    quantised: Path
    raw_sh1: Path


def write_stream(
    path: Path, capture: Path, case: str = "none", sh_degree: int = 0, exact: bool = True
) -> Path:
    """Writes a stream of Gaussians with the quantisation `case`."""
    manifest = seen_by(tiny_manifest(SWIN, segment_frames=2), capture)
    centre = rig_centre(manifest.cameras)
    assert centre is not None
    lattice = Lattice.suiting(coarse_slice(0, centre, sh_degree).splats)
    manifest = replace(
        manifest, slots=SLOTS, lattice=(lattice,) * 2, sh_degree=sh_degree, near_m=0.2
    )
    with StreamWriter.create(path, manifest, exact=exact) as writer:
        for birth in range(1 - SWIN, FRAMES):
            part = coarse_slice(birth, centre, sh_degree)
            writer.append(replace(part, splats=quantise_case(part.splats, case)))
    return path


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    root = tmp_path_factory.mktemp("ablation")
    capture = root / "capture"
    write_dynamic3dgs(capture, num_cameras=4, num_frames=FRAMES)
    return Made(
        capture,
        write_stream(root / "raw", capture),
        write_stream(root / "paper", capture, "all but feat"),
        write_stream(root / "quantised", capture, exact=False),
        write_stream(root / "sh1", capture, sh_degree=1),
    )


@pytest.fixture(scope="module")
def ablation(made: Made) -> Ablation:
    return ablate_quantisation(EvaluateConfig(made.raw, made.capture))


def test_none_and_the_papers_choice_are_what_the_streams_score(
    ablation: Ablation, made: Made
) -> None:
    rows = {row.case: row for row in ablation.rows}
    for case, stream in (("none", made.raw), ("all but feat", made.paper)):
        whole = evaluate_stream(EvaluateConfig(stream, made.capture)).layers[-1]
        # A stream cut into layers may be sorted differently, so that sums round differently.
        assert rows[case].psnr_db == pytest.approx(whole.psnr_db, abs=1e-4)
        assert rows[case].ssim == pytest.approx(whole.ssim, abs=1e-5)
    assert rows["none"].psnr_db != rows["all but feat"].psnr_db


def test_each_row_quantises_what_it_says(ablation: Ablation) -> None:
    rows = {row.case: row for row in ablation.rows}
    assert list(rows) == list(CASES)
    none = rows["none"].psnr_db
    for row in ablation.rows:
        assert row.difference_db == pytest.approx(row.psnr_db - none)
        assert abs(row.difference_db) < 0.5
        # fp16 holds the colours of this stream exactly.
        changes = row.case not in ("none", "feat")
        assert (row.difference_db != 0) == changes, row
    assert rows["all"].psnr_db == rows["all but feat"].psnr_db
    assert len({row.psnr_db for row in ablation.rows}) == len(CASES) - 2


def test_the_bytes_are_those_of_section_5_6_2(ablation: Ablation, made: Made) -> None:
    sizes = {row.case: (row.raw_bytes, row.bytes) for row in ablation.rows}
    assert sizes == {
        "none": (56, 56),
        "means": (12, 6),
        "rotation": (16, 4),
        "scale": (12, 6),
        "feat": (12, 6),
        "opacity": (4, 1),
        "all but feat": (44, 17),
        "all": (56, 23),
    }
    rows = ablate_quantisation(EvaluateConfig(made.raw_sh1, made.capture, every=3)).rows
    assert [(r.raw_bytes, r.bytes) for r in rows if r.case in ("feat", "none")] == [
        (92, 92),
        (48, 24),
    ]


def test_the_command_prints_a_table_and_json(ablation: Ablation, made: Made) -> None:
    arguments = (made.raw, made.capture, "--ablate-quantisation")
    found = json.loads(run_ok("swings-eval", *arguments, "--json"))
    assert found["frames"] == FRAMES
    assert found["cameras"] == ablation.cameras
    assert [row["case"] for row in found["rows"]] == list(CASES)
    for row, expected in zip(found["rows"], ablation.rows, strict=True):
        assert row["psnr_db"] == pytest.approx(expected.psnr_db, abs=1e-4)
    table = run_ok("swings-eval", *arguments, "--every", 3)
    assert "1 frames" in table
    assert all(case in table for case in CASES)


def test_what_cannot_be_ablated_is_one_line(made: Made) -> None:
    done = run("swings-eval", made.quantised, made.capture, "--ablate-quantisation")
    assert done.returncode == 1
    (line,) = done.stderr.strip().splitlines()
    assert line.startswith("swings-eval: ")
    assert f"{made.quantised} is quantised already" in line
    assert "--raw-stream" in line
    for score in (evaluate_stream, ablate_quantisation):
        with pytest.raises(InvalidError, match="every 0: choose 1 or more"):
            score(EvaluateConfig(made.raw, made.capture, every=0))


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
