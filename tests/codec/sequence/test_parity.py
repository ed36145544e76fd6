"""Files imported within the stated errors, and the page."""

from __future__ import annotations

import re
import tempfile
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import maximum_bipartite_matching
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from codec.arrays import Doubles, Flags, Floats
from codec.interop.formats import SplatFormat, read_splats, write_splats
from codec.sequence.importing import ImportOptions, import_stream
from codec.sequence.slotfiller import ErrorBound
from codec.splats import SH_C0, Splats, sh_count
from codec.stream import StreamReader
from codec.tools.audit import verify_stream
from tests.support.alike import axis_turns
from tests.support.commands import ENTRY, ROOT, run_ok
from tests.support.drawn import same_splats
from tests.support.slots.rotating import figure, turned
from tests.support.slots.slot_streams import gaussians
from tests.support.trained_like import trained_like_splats

FORMATS = (ROOT / "docs" / "FORMATS.md").read_text(encoding="utf-8")
PAGE = FORMATS.partition("\n## A sequence as a stream\n")[2]
COMMANDS = re.findall(r"^ {4}(swings-.*)$", PAGE, re.MULTILINE)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder after all commands of the page, in order."""
    root = tmp_path_factory.mktemp("page")
    (root / "my-splats").mkdir()
    splats = figure(100)
    for number in range(4):
        path = root / "my-splats" / f"frame_{number:04d}.ply"
        write_splats(path, turned(splats, 0.02 * number), SplatFormat.PLY)
    for line in COMMANDS:
        name, *words = line.split()
        run_ok(name, *words, folder=root)
    return root


def test_the_commands_run(folder: Path) -> None:
    assert len(COMMANDS) == 7
    assert {line.split()[0] for line in COMMANDS} <= set(ENTRY)


def test_they_do_what_the_page_says(folder: Path) -> None:
    sizes, streams = {}, {}
    for name in ("my-stream", "finer-stream", "exact-stream", "two-layers"):
        streams[name] = StreamReader(folder / name)
        sizes[name] = sum(sum(record.part_bytes) for record in streams[name].records)
        assert streams[name].num_frames == 4
    assert sizes["my-stream"] < sizes["finer-stream"]
    for frame in range(4):
        file = read_splats(folder / "my-splats" / f"frame_{frame:04d}.ply")
        assert gaussians(streams["exact-stream"].active_splats(frame, 4)) == gaussians(file)
    assert streams["two-layers"].manifest.num_layers == 2


SLACK = 1e-5
"""Tolerance for the rounding of f32, as a share."""


def vectors(turns: Doubles) -> Doubles:
    """(N, 3) x, y, z of the rotations' quaternions, with w >= 0."""
    return np.asarray(Rotation.from_matrix(turns).as_quat(canonical=True)[:, :3])


def lowest_of(reader: StreamReader, frame: int) -> Doubles:
    """(M,) minimum log-scale on the lattice of the layer of each Gaussian in a frame."""
    lowest = np.zeros(0)
    before = reader.active_splats(frame, 1).take(slice(0))
    for layer, lattice in enumerate(reader.manifest.lattice):
        splats = reader.active_splats(frame, layer + 1)
        assert same_splats(splats.take(slice(len(before))), before)  # lower layers first
        least = lattice.log_scale_base - 128 * lattice.log_scale
        lowest = np.append(lowest, np.full(len(splats) - len(before), least))
        before = splats
    return lowest


def usual_size_m(splats: Splats) -> float:
    scales = np.sort(splats.log_scales.astype(np.float64), axis=1)[:, 1:].mean(axis=1)
    opacities = 1 / (1 + np.exp(-splats.logit_opacities.astype(np.float64)))
    weights = opacities + 1e-6
    return float(np.exp((weights * scales).sum() / weights.sum()))


def within(
    source: Splats, found: Splats, error: ErrorBound, size_m: float, lowest: Doubles
) -> Flags:
    """(N, M) whether Gaussian j of `found` is within the errors of i of `source`. lowest: see
    `lowest_of`."""

    def apart(a: Floats, b: Floats) -> Doubles:
        return np.asarray(abs(a[:, None].astype(np.float64) - b[None]))

    slack = SLACK * (1 + abs(source.means[:, None].astype(np.float64)))
    fits = (apart(source.means, found.means) <= error.of("position") * size_m + slack).all(2)
    opacities = apart(source.opacities, found.opacities)
    fits &= opacities <= error.of("opacity") + SLACK

    def luma(splats: Splats, darkest: float = -np.inf) -> Doubles:
        rgb = np.maximum(splats.sh.astype(np.float64), darkest)
        red, green, blue = np.moveaxis(rgb, 2, 0)
        y, co = (red + 2 * green + blue) / 4, (red - blue) / 2
        return np.stack([y, co, (2 * green - red - blue) / 4], axis=2).reshape(len(rgb), -1)

    # Without harmonics, colours below black are drawn black.
    darkest = -0.5 / SH_C0 if source.sh_degree == 0 else -np.inf
    colours = abs(luma(source, darkest)[:, None] - luma(found)[None])
    fits &= (colours <= error.of("colour") + SLACK).all(axis=2)
    form = np.zeros_like(fits)
    turned_by = [
        Rotation.from_quat(one.quats[:, [1, 2, 3, 0]]).as_matrix() for one in (source, found)
    ]
    have = vectors(turned_by[1])
    scales = source.log_scales.astype(np.float64)
    for turn in axis_turns():
        wanted = np.maximum((scales @ abs(turn))[:, None], lowest[:, None])
        sizes = abs(wanted - found.log_scales[None].astype(np.float64))
        turns = abs(vectors(turned_by[0] @ turn)[:, None] - have[None])
        form |= (sizes <= error.of("size") + SLACK).all(2) & (
            turns <= error.of("turn") + 10 * SLACK
        ).all(2)
    return fits & form


def exact(source: Splats, found: Splats) -> Flags:
    """(N, M) whether the Gaussians have the same bits."""
    fits = np.ones((len(source), len(found)), np.bool_)
    for a, b in zip(source.arrays, found.arrays, strict=True):
        a, b = a.reshape(len(a), -1), b.reshape(len(b), -1)
        fits &= (a[:, None] == b[None]).all(axis=2)
    return fits


def drawn(rng: np.random.Generator, count: int, degree: int, wide: float) -> Splats:
    quats = rng.normal(size=(count, 4)) * 10 ** rng.uniform(-2, 2, (count, 1))
    return Splats(
        (wide * rng.uniform(-1, 1, (count, 3))).astype(np.float32),
        rng.uniform(-7, 1, (count, 3)).astype(np.float32),
        quats.astype(np.float32),
        rng.uniform(-9, 9, count).astype(np.float32),
        rng.uniform(-3, 3, (count, sh_count(degree), 3)).astype(np.float32),
    )


def later(rng: np.random.Generator, splats: Splats, moves: float) -> Splats:
    """`splats` a frame later: some moved, some gone, some born, perhaps in another order."""
    alters = rng.random(len(splats)) < rng.choice([0, 0.5, 1])
    arrays = []
    for array in splats.arrays:
        noise = moves * rng.normal(size=array.shape) * abs(array)
        shaped = alters.reshape(-1, *[1] * (array.ndim - 1))
        arrays.append(np.where(shaped, array + noise, array).astype(np.float32))
    stays = rng.random(len(splats)) < rng.choice([0.7, 1, 1])
    born = drawn(rng, int(rng.choice([0, 0, 3])), splats.sh_degree, 3)
    parts = [Splats(*arrays).take(np.flatnonzero(stays)), born]
    together = Splats.concatenate(parts)
    orders = np.arange(len(together)), rng.permutation(len(together))
    return together.take(orders[int(rng.random() < 0.4)])


ERRORS = [ErrorBound(**a) for a in ({}, {"finer": 3}, {"position": 0.5, "turn": 0.1})]
ERRORS.append(ErrorBound(size=0.009))


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 1 << 32),
    count=st.integers(0, 16),
    degree=st.integers(0, 1),
    moves=st.sampled_from([0.001, 0.02, 0.3]),
    wide=st.sampled_from([1.0, 1e5]),
    error=st.sampled_from(ERRORS),
    layers=st.integers(1, 4),
    num_files=st.sampled_from([1, 6, 6]),
)
def test_every_frame_is_within_the_stated_errors(
    seed: int,
    count: int,
    degree: int,
    moves: float,
    wide: float,
    error: ErrorBound,
    layers: int,
    num_files: int,
) -> None:
    rng = np.random.default_rng(seed)
    frames = [drawn(rng, count, degree, wide)]
    while len(frames) < num_files:
        frames.append(later(rng, frames[-1], moves))
    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        (root / "seq").mkdir()
        for number, splats in enumerate(frames):
            write_splats(root / "seq" / f"{number}.ply", splats, SplatFormat.PLY)
        options = ImportOptions(fps=30, error=error, layers=layers)
        made = import_stream(root / "seq", root / "s", options)
        assert verify_stream(root / "s").num_frames == len(frames)
        reader = StreamReader(root / "s")
        sizes_m = [usual_size_m(splats) for splats in frames if len(splats)]
        size_m = min(sizes_m, default=1.0)
        for number, splats in enumerate(frames):
            found = reader.active_splats(number, reader.manifest.num_layers)
            assert len(found) == len(splats)
            if not len(splats):
                continue
            lowest = lowest_of(reader, number)
            fits = within(splats, found, error, size_m, lowest) | exact(splats, found)
            pairs = maximum_bipartite_matching(csr_matrix(fits), perm_type="column")
            assert (pairs >= 0).all()
        for kind, value in made.errors.items():
            most = error.of(kind) * (size_m if kind == "position" else 1)
            assert value <= most * (1 + SLACK)
        # The less exact form is not much larger, for any files.
        whole = sum(4 * (11 + 3 * sh_count(degree)) * len(splats) for splats in frames)
        assert made.num_bytes <= 1.5 * whole + 3000


@pytest.mark.parametrize(
    ("degree", "finer", "log_factor"), [(3, 1, 0), (3, 2, 0), (0, 4, 0), (0, 1, -7), (0, 10, 0)]
)
def test_sizes_that_show_fit(degree: int, finer: float, log_factor: float, tmp_path: Path) -> None:
    splats = trained_like_splats(1500, 0, degree)
    splats = splats.take(np.flatnonzero(np.abs(splats.means).max(axis=1) < 4))
    splats.means[:] *= np.exp(log_factor)
    splats.log_scales[:] = np.maximum(splats.log_scales + log_factor, -15)
    write_splats(tmp_path / "m.ply", splats, SplatFormat.PLY)
    error = ErrorBound(finer=finer, opacity=max(0.02, 0.003 * finer))
    options = ImportOptions(fps=30, error=error)
    made = import_stream(tmp_path / "m.ply", tmp_path / "s", options)
    found = StreamReader(tmp_path / "s").active_splats(0, made.manifest.num_layers)
    wanted = splats.take(cKDTree(splats.means).query(found.means)[1])
    sizes, given = np.sort(found.log_scales), np.sort(wanted.log_scales)
    usual = np.median(given[:, 1:].mean(axis=1))
    # Half the steps of the last layer, which alone keep the bound below degree 2.
    most = 0.25 if degree == 3 else error.of("size") * (1 + SLACK)
    assert np.abs(sizes - given)[given > usual - 2].max() < most


def test_the_page_has_the_defaults() -> None:
    told = dict(re.findall(r"\| `--error\.(\w+)` \| .* \| ([0-9.]+) \|", PAGE))
    bound = ErrorBound()
    assert told.keys() == {field.name for field in fields(bound)}
    for name, value in told.items():
        assert float(value) == pytest.approx(getattr(bound, name), rel=0.01)
