"""docs/FORMATS.md: its commands run as written, and its figures match measurements."""

from __future__ import annotations

import math
import os
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from codec.foreign.spz import SpzVersion
from codec.interop.formats import SplatFormat, decode_any, encode_splats, read_splats, write_splats
from codec.sequence.importing import facing_camera
from codec.sequence.survey import Survey
from codec.splats import SH_C0, Splats
from player.render.cpu import render_splats
from tests.support.commands import ROOT, run_ok
from tests.support.drawn import angles_rad
from tests.support.trained_like import trained_like_splats

FORMATS = (ROOT / "docs" / "FORMATS.md").read_text(encoding="utf-8")
PAGE = FORMATS.partition("\n## A sequence as a stream\n")[0]
COMMANDS = [line.strip() for line in re.findall(r"^ {4}swings-stream .*$", PAGE, re.M)]
FIGURE = (
    Path(os.environ.get("SWINGS_DATA", ROOT / ".." / "shared" / "data"))
    / "splats"
    / "biker.compressed.ply"
)
COUNT = 90_000
ERRORS, SIZES = "| format | position | ln size |", "| format | bytes, generated |"
WRITTEN = ["ply", "glb", "gltf", "sog", "spz 4", "spz 3", "spz 2", "splat"]
"""Formats, some with the version that is written."""
formats = pytest.mark.parametrize("name", WRITTEN)


def table(head: str) -> dict[str, list[str]]:
    """The rows of the table that begins with `head`, by their first cell."""
    lines = PAGE[PAGE.index(head) :].partition("\n\n")[0].splitlines()[2:]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return {row[0]: row[1:] for row in rows}


@cache
def generated() -> Splats:
    return trained_like_splats(COUNT, 1, 1)


@cache
def figure() -> Splats:
    whole = read_splats(FIGURE)
    return whole.take(np.sort(np.random.default_rng(1).permutation(len(whole))[:COUNT]))


@dataclass(frozen=True, slots=True)
class Kept:
    """Gaussians after a round trip through a format."""

    bytes_each: float
    back: Splats
    psnr_db: float


def kept(splats: Splats, name: str) -> Kept:
    format, _, version = name.partition(" ")
    data = encode_splats(splats, SplatFormat(format), SpzVersion(int(version)) if version else None)
    back = decode_any(data, f".{format}")
    survey = Survey()
    survey.take(Path(name), splats)
    camera = facing_camera(survey.lower, survey.upper)
    near_m = 0.005 * float(np.linalg.norm(survey.upper - survey.lower))
    pictures = [render_splats(s, camera, near_m).clip(0, 1) for s in (splats, back)]
    squared = float(np.mean((pictures[0] - pictures[1]) ** 2))
    return Kept(len(data) / len(splats), back, -10 * math.log10(squared) if squared else math.inf)


def in_order(found: Splats, wanted: Splats) -> Splats:
    """`found` in the order of `wanted`, matched by place, size and colour."""

    def features(splats: Splats) -> np.ndarray[tuple[int, int], np.dtype[np.float32]]:
        place = np.sign(splats.means) * np.log1p(np.abs(splats.means))
        return np.hstack([place, 0.02 * splats.log_scales.clip(-10, 5), 0.02 * splats.sh[:, 0]])

    nearest = cKDTree(features(found)).query(features(wanted))[1]
    assert len(set(nearest.tolist())) == len(wanted)
    return found.take(nearest)


def largest_errors(found: Splats, wanted: Splats, name: str) -> list[float]:
    """Largest errors of position, ln size, rotation, opacity, f_dc and harmonics, where nothing is
    clipped; NaN without harmonics."""
    away = np.abs(found.means - wanted.means) / (1 + np.abs(wanted.means))
    sizes, colours = wanted.log_scales, wanted.sh[:, 0]
    kept_sizes = (sizes >= -10) & (sizes <= 5.9) | (name[:3] != "spz")
    kept_colours = (np.abs(SH_C0 * colours) <= 0.5) | (name != "splat")
    harmonics = math.nan
    if found.sh.shape == wanted.sh.shape:
        harmonics = float(np.abs(found.sh[:, 1:] - wanted.sh[:, 1:]).max())
    return [
        float(away.max()),
        float(np.abs(found.log_scales - sizes)[kept_sizes].max()),
        float(angles_rad(found, wanted).max()),
        float(np.abs(found.opacities - wanted.opacities).max()),
        float(np.abs(found.sh[:, 0] - colours)[kept_colours].max()),
        harmonics,
    ]


def agrees(said: str, measured: float) -> bool:
    """Whether a cell matches the measured value: not less, and not much more."""
    if said in ("none", "exact"):
        return math.isnan(measured) or math.isinf(measured)
    return measured <= float(said) <= max(1.5 * measured, 1e-6)


def assert_size_and_picture(said: list[str], found: Kept) -> None:
    assert float(said[0]) == pytest.approx(found.bytes_each, rel=0.03), found
    if said[1].startswith("over "):
        assert found.psnr_db > float(said[1].removeprefix("over ")), found
    else:
        told_db = math.inf if said[1] == "exact" else float(said[1])
        assert found.psnr_db == pytest.approx(told_db, abs=1), found


@formats
def test_errors_sizes_and_pictures_are_what_is_measured(name: str) -> None:
    found = kept(generated(), name)
    assert_size_and_picture(table(SIZES)[name][:2], found)
    back = found.back
    if name in ("sog", "splat"):
        back = in_order(back, generated())
    measured = largest_errors(back, generated(), name)
    assert all(map(agrees, table(ERRORS)[name], measured)), f"| {name} | " + " | ".join(
        f"{value:.2g}" for value in measured
    )


@pytest.mark.deep
@pytest.mark.skipif(
    not FIGURE.exists(), reason=f"no {FIGURE.name} in {FIGURE.parent} (set SWINGS_DATA)"
)
@formats
def test_the_sizes_and_pictures_of_the_figure(name: str) -> None:
    assert_size_and_picture(table(SIZES)[name][2:], kept(figure(), name))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with model.sog and my-frames; each frame has another format."""
    root = tmp_path_factory.mktemp("page")
    (root / "my-frames").mkdir()
    write_splats(root / "model.sog", trained_like_splats(60), SplatFormat.SOG)
    for number, format in enumerate(SplatFormat):
        path = root / "my-frames" / f"frame_{number}.{format}"
        write_splats(path, trained_like_splats(60, number), format)
    return root


def test_the_commands_run_in_their_order(folder: Path) -> None:
    assert len(COMMANDS) == 6
    assert set(table(ERRORS)) == set(table(SIZES)) == set(WRITTEN)
    for line in COMMANDS:
        name, *words = line.split()
        run_ok(name, *words, folder=folder)
    assert len(read_splats(folder / "frame.ply")) == 60
    assert 0 < len(read_splats(folder / "frame.sog")) < 60
    names = sorted(path.name for path in (folder / "out").iterdir())
    assert names[:3] == [f"name_000{frame}.glb" for frame in range(3)]
    assert names[3:] == [f"old_000{frame}.spz" for frame in range(1, len(SplatFormat))]
