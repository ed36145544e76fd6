"""A stream made of files of Gaussians, one still model or a numbered sequence, and how it looks
beside these files.

A slice sends only what changes from file to file. A still model is a stream of one frame; nothing
in it ever expires, so a player may hold or repeat it for as long as it likes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from codec.arrays import Doubles
from codec.camera import Camera, rotation_about
from codec.errors import InvalidError
from codec.files import making_folder
from codec.foreign.notes import Notes, notes, one_import
from codec.framerange import FRAMES, FrameRange
from codec.interop.formats import ContainedFrame
from codec.lattice.forms import layer_coarseness
from codec.lattice.lattice import Lattice
from codec.slice import Slice
from codec.slots.slotlayout import MAX_LAYERS, MAX_SEGMENT_SLOTS, MAX_SLOTS
from codec.splats import MAX_SH_DEGREE, Splats
from codec.stream.finishing import finish_pictures
from codec.stream.manifest import MAX_FPS, MIN_FPS, Manifest, Point
from codec.stream.pictures import Draw
from codec.stream.poster import POSTER_NAME, STORYBOARD_NAME
from codec.stream.reader import StreamReader
from codec.stream.views import Orbit
from codec.stream.wholeslice import RANKS, Rank, split_counts, split_layers, whole_update
from codec.stream.writer import StreamWriter

from .slotfiller import HOLD, KINDS, SLACK, ErrorBound, SlotFiller, SlotPlan, spread_of, steps_of
from .survey import FPS_NAME, FramePlace, Survey, find_frames, read_frame

NUM_VIEWS = 3
"""Cameras on a circle about the model, the default camera first."""

SCORE_HEIGHT_PX = 270

SAME_DB = 100.0
"""PSNR of pictures that are the same, or more alike than that."""


def cameras_around(front: Camera, centre: Doubles) -> list[Camera]:
    """NUM_VIEWS small cameras like `front` about the vertical axis through `centre`."""
    small = front.scaled(min(1.0, SCORE_HEIGHT_PX / front.height_px))
    cameras = []
    for number in range(NUM_VIEWS):
        turn = np.eye(4)
        turn[:3, :3] = rotation_about(np.array([0.0, 1.0, 0.0]), 2 * math.pi * number / NUM_VIEWS)
        turn[:3, 3] = centre - turn[:3, :3] @ centre
        w2c = small.w2c @ turn
        cameras.append(
            Camera(
                f"{small.name}{number}",
                small.width_px,
                small.height_px,
                small.fx_px,
                small.fy_px,
                small.cx_px,
                small.cy_px,
                w2c,
            )
        )
    return cameras


class ImportScore:
    """A Quality (codec.stream.writer) that compares with the files: the caller hands over that of
    each frame before it appends the frame.

    Both are drawn with harmonics of every degree that they have: degrees that the stream leaves out
    count as an error.
    """

    def __init__(self, draw: Draw, cameras: Sequence[Camera], near_m: float, every: int) -> None:
        """every: frames from a scored one to the next."""
        self._draw, self._cameras, self._near_m, self._every = draw, cameras, near_m, every
        self._sources: dict[int, Splats] = {}
        self.scores_db: list[tuple[float, ...]] = []
        """PSNR in dB of each scored frame with 1, 2, ... layers."""

    def expect(self, birth: int, source: Splats) -> None:
        """Hands over the file of a frame that is to be appended."""
        if birth % self._every == 0:
            self._sources[birth] = source

    def __call__(self, birth: int, slices: Sequence[Slice]) -> Sequence[float] | None:
        source = self._sources.pop(birth, None)
        if source is None:
            return None
        errors = np.zeros(len(slices))
        for camera in self._cameras:
            wanted = self._drawn(source, camera)
            for n, part in enumerate(slices):
                shown = part.splats.take(np.flatnonzero(part.active(birth, 1)))
                errors[n] += np.mean((self._drawn(shown, camera) - wanted) ** 2)
        least = 10 ** (-SAME_DB / 10)
        mean = np.maximum(errors / len(self._cameras), least)
        self.scores_db.append(tuple((-10 * np.log10(mean)).tolist()))
        return self.scores_db[-1]

    def _drawn(self, splats: Splats, camera: Camera) -> Doubles:
        return np.clip(self._draw(splats, camera, self._near_m), 0, 1).astype(np.float64)


WIDTH_PX, HEIGHT_PX = 1280, 720
VERTICAL_FOV_RAD = math.radians(50)
VIEW_TURN_RAD, VIEW_TILT_RAD = math.radians(35), math.radians(15)
"""Turn about the vertical and height from which a model is seen at first: at three quarters, since
many are flat from the front."""
NEAR_SHARE = 0.01
"""Nearest depth drawn, as a share of the bounds' half diagonal: one may walk into the model."""
SHARES = (0.35, 0.15, 0.2, 0.3)
"""Shares of four layers; another number of layers has equal shares."""
ROOM = 1.03
"""Slots of a sequence whose errors differ by layer, as a multiple of its most Gaussians."""
SEGMENT_FRAMES = 15
LONGEST_SEGMENT_S = 10.0
STILL_FPS = 30.0
"""Frame rate of a single file, in which nothing moves."""

WRITE_STEPS = 4
"""Steps that writing a frame counts for, where looking at it first counts for one: it takes about
so much longer."""

Progress = Callable[[int, int, str], None]
"""Called after each step with the number of steps done, their total, and what was done; steps take
about equally long."""


@dataclass(frozen=True, slots=True)
class ImportOptions:
    """Settings of an import."""

    fps: float | None = None
    """Frames per second. A folder needs it, either here or as a number in its fps.txt; a .tsog
    file has its own."""
    frames: Annotated[FrameRange, FRAMES] = field(default_factory=FrameRange)
    """Range of files A:B, A included, B not, counted from 0."""
    layers: int = 4
    """Number of layers in each frame; players on slow links fetch only the first ones."""
    rank: Rank = Rank.COVERAGE
    """Importance that orders Gaussians into layers: coverage, opacity, or given (the order in the
    file)."""
    exact: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Keep every float of the files; every frame is then sent whole."""
    error: ErrorBound = field(default_factory=ErrorBound)
    """Largest errors against the files."""
    by_paint: bool | None = None
    """Scale the errors of each layer: larger where Gaussians paint little, smaller where they paint
    much, with finer harmonics. By default with SH degrees 2 and 3."""
    sh_degree: int | None = None
    """Highest degree of spherical harmonics to keep, 0 to 3; files of lower degree stay as they
    are. By default all degrees are kept."""
    title: str | None = None
    """Title of the stream; by default the name of the file or folder."""

    def __post_init__(self) -> None:
        if self.sh_degree is not None and not 0 <= self.sh_degree <= MAX_SH_DEGREE:
            raise InvalidError(f"sh-degree {self.sh_degree}: choose 0 to {MAX_SH_DEGREE}")
        if not 1 <= self.layers <= MAX_LAYERS:
            raise InvalidError(f"layers {self.layers}: choose 1 to {MAX_LAYERS}")

    @property
    def shares(self) -> tuple[float, ...]:
        """Share of the Gaussians in each layer."""
        return SHARES if self.layers == len(SHARES) else (1 / self.layers,) * self.layers

    def kept(self, splats: Splats) -> Splats:
        """`splats` without the harmonics above `sh_degree`."""
        if self.sh_degree is None or splats.sh_degree <= self.sh_degree:
            return splats
        return splats.with_degree(self.sh_degree)


@dataclass(frozen=True, slots=True)
class Imported:
    """The stream that `import_stream` wrote, in numbers."""

    manifest: Manifest
    num_frames: int
    num_bytes: int
    """Size of all objects."""
    played_bytes: int
    """Size of the objects that a player from frame 0 on fetches."""
    first_bytes: int
    """Size of the part that comes before anything shows: the keyframes of frame 0."""
    errors: dict[str, float]
    """The most that each of KINDS was off; of positions in metres."""
    num_escaped: int
    """Gaussians that were sent at full precision, so that the errors held."""
    statuses: tuple[int, ...]
    """How many slots were kept, ended, predicted, new after the first frame."""
    scores_db: tuple[tuple[float, ...], ...]
    """PSNR of some frames with 1, 2, ... layers, against the files, if there was something to draw
    with, each drawn with all its harmonics."""
    source_sh_degree: int
    """Highest degree of harmonics in the files."""
    notes: Notes
    """What was left out of the files, and what to try if the model looks wrong."""


def facing_camera(lower: Doubles, upper: Doubles) -> Camera:
    """A camera in front of a box that sees all of it. It looks along +z with y down, as is the
    convention in a PLY."""
    radius = float(np.linalg.norm(upper - lower)) / 2
    centre = (lower + upper) / 2
    focal_px = HEIGHT_PX / 2 / math.tan(VERTICAL_FOV_RAD / 2)
    w2c = np.eye(4)
    w2c[:3, 3] = -centre
    w2c[2, 3] += radius / math.sin(VERTICAL_FOV_RAD / 2)
    return Camera(
        "front", WIDTH_PX, HEIGHT_PX, focal_px, focal_px, WIDTH_PX / 2, HEIGHT_PX / 2, w2c
    )


def _title_of(source: Path) -> str:
    """The name of a file or folder, a file's without suffixes such as `.compressed.ply`."""
    path = source.resolve()
    return path.name if path.is_dir() else path.stem.removesuffix(".compressed")


def make_manifest(
    survey: Survey,
    options: ImportOptions,
    title: str,
    slots: tuple[int, ...],
    lattices: tuple[Lattice, ...],
) -> Manifest:
    """The manifest of a stream of what `survey` found."""
    lower, upper = survey.box
    camera = facing_camera(lower, upper)
    up = -camera.down
    aside = Orbit((lower + upper) / 2, up, VIEW_TURN_RAD, -VIEW_TILT_RAD)
    fps = STILL_FPS if options.fps is None else options.fps
    return Manifest(
        fps=fps,
        swin_size=1,
        slots=slots,
        lattice=lattices,
        segment_frames=_segment_frames(survey, fps),
        sh_degree=survey.sh_degree,
        antialias=False,
        near_m=NEAR_SHARE * float(np.linalg.norm(upper - lower)) / 2,
        bounds=(_point(lower), _point(upper)),
        cameras=(camera,),
        default_camera=camera.name,
        view=replace(aside.applied(camera), name="view"),
        live=True,
        title=title,
        capture_frame=options.frames.first,
    )


def _point(values: Doubles) -> Point:
    x, y, z = (float(value) for value in values)
    return x, y, z


def _segment_frames(survey: Survey, fps: float) -> int:
    """Frames in a segment such that its changes are about as large as its keyframe, which a joining
    player fetches, too: the less moves, the longer."""
    most = max(SEGMENT_FRAMES, round(LONGEST_SEGMENT_S * fps))
    fitting = min(most, MAX_SEGMENT_SLOTS // max(1, survey.num_gs))
    return int(np.clip(round(1 / max(survey.moved_share, 1e-6)), SEGMENT_FRAMES, fitting))


def make_plan(survey: Survey, options: ImportOptions, example: Splats) -> SlotPlan:
    """How the slots of a stream of what `survey` found are laid out. example: a frame of it, by
    which the layers are weighed."""
    size_m = survey.size_m if survey.num_gs else 1.0
    by_paint = options.by_paint if options.by_paint is not None else survey.sh_degree > 1
    # With room in each layer what is born finds a place where its errors suit it.
    num_slots = survey.num_gs
    if by_paint and survey.num_files > 1:
        num_slots = min(math.ceil(ROOM * num_slots), MAX_SLOTS)
    slots = split_counts(max(1, num_slots), options.shares)
    if not min(slots):  # no layer is empty
        slots = (sum(slots),)
    errors = (options.error,) * len(slots)
    lattices = (_lattice(options.error, survey),) * len(slots)
    if by_paint and survey.num_gs:
        layers = split_layers(example, slots, RANKS[options.rank])
        spread = spread_of(size_m, survey.lowest, survey.highest)
        errors = tuple(
            options.error.in_layer(coarseness, survey.sh_degree, survey.reach, spread)
            for coarseness in layer_coarseness([example.take(rows) for rows in layers])
        )
        lattices = tuple(_lattice(error, survey) for error in errors)
    bounds = np.array([[error.of(kind) for kind in KINDS] for error in errors])
    bounds[:, 0] *= size_m
    shares = options.shares if len(slots) == options.layers else (1.0,)
    return SlotPlan(slots, shares, survey.sh_degree, lattices, bounds, *survey.box)


def _lattice(error: ErrorBound, survey: Survey) -> Lattice:
    size_m = survey.size_m if survey.num_gs else 1.0
    return error.lattice(size_m, survey.lowest, survey.highest)


def still_lattices(
    splats: Splats, plan: SlotPlan, options: ImportOptions, survey: Survey
) -> tuple[Lattice, ...] | None:
    """The lattice of each layer of a single file: the less its Gaussians paint, the coarser, as far
    as the bounds allow. Such a value is rounded, so half a step off, where one of a sequence may be
    held HOLD steps off. None where that is more than a bound, so that some would have to escape."""
    lattices = plan.lattices
    if set(lattices) == {_lattice(options.error, survey)}:  # or they differ by layer already
        layers = [
            splats.take(rows) for rows in split_layers(splats, plan.slots, RANKS[options.rank])
        ]
        lattices = tuple(
            _lattice(options.error.coarser(min(factor, HOLD / 0.5)), survey)
            for factor in layer_coarseness(layers)
        )
    most = np.array([steps_of(lattice) for lattice in lattices]) / 2
    return lattices if (most <= plan.bounds * (1 + SLACK)).all() else None


def fps_of(source: Path, options: ImportOptions, known: float | None = None) -> float:
    """Frames in a second, from the options, or `known`, or a file in the folder `source`. Raises
    InvalidError."""
    fps = known if options.fps is None else options.fps
    if fps is None:
        path = source / FPS_NAME
        if not path.is_file():
            raise InvalidError(
                f"{source}: no file gives the frame rate; add --fps, for example --fps 30"
            )
        try:
            fps = float(path.read_text(encoding="utf-8"))
        except ValueError as error:
            raise InvalidError(
                f"{path}: does not hold exactly one number, the frames per second"
            ) from error
    if not MIN_FPS <= fps <= MAX_FPS:
        raise InvalidError(f"fps {fps:g}: choose {MIN_FPS:g} to {MAX_FPS:g}")
    return fps


def _known_fps(frames: list[FramePlace]) -> float | None:
    """Frames in a second of a container or of a still model."""
    first = frames[0]
    if len(frames) == 1:
        return STILL_FPS
    return first.reader.fps if isinstance(first, ContainedFrame) else None


def _nothing(done: int, total: int, what: str) -> None:
    pass


@one_import()
def import_stream(
    source: Path,
    stream: Path,
    options: ImportOptions,
    draw: Draw | None = None,
    progress: Progress = _nothing,
) -> Imported:
    """Writes a finished stream at `stream`, absent or an empty folder, of the file, numbered folder
    or container `source`; with PSNR, a poster and a storyboard if there is something to draw them
    with.

    Each frame of a sequence is read twice: the manifest comes first and describes them all, and two
    at most are in memory at a time. The stream appears whole or not at all. Raises a SwingsError
    that names the file at fault.
    """
    all_files = find_frames(source)
    files = [all_files[n] for n in options.frames.of(len(all_files), source)]
    options = replace(options, fps=fps_of(source, options, _known_fps(files)))
    with making_folder(stream) as folder:
        num_steps = (1 + WRITE_STEPS) * len(files)
        survey, source_sh_degree, num_escaped = Survey(), 0, 0
        for number, file in enumerate(files):
            splats = read_frame(file)
            source_sh_degree = max(source_sh_degree, splats.sh_degree)
            survey.take(file, options.kept(splats))
            progress(number + 1, num_steps, f"looked at file {number + 1} of {len(files)}")
        survey.warn_of_odd_files()
        title = _title_of(source) if options.title is None else options.title
        rank = RANKS[_known(options.rank)]
        plan = make_plan(survey, options, options.kept(read_frame(files[0])))
        filler, lattices = SlotFiller(plan, rank), plan.lattices
        is_still = len(files) == 1
        if is_still and not options.exact:
            rounded = still_lattices(options.kept(splats), plan, options, survey)
            is_still, lattices = rounded is not None, rounded or lattices
        manifest = make_manifest(survey, options, title, plan.slots, lattices)
        score = None
        if draw is not None:
            manifest = replace(manifest, poster=POSTER_NAME, storyboard=STORYBOARD_NAME)
            lower, upper = survey.box
            cameras = cameras_around(manifest.cameras[0], (lower + upper) / 2)
            score = ImportScore(draw, cameras, manifest.near_m, SEGMENT_FRAMES)
        with StreamWriter.create(folder, manifest, quality=score) as writer:
            for birth, file in enumerate(files):
                splats = read_frame(file)
                if score is not None:
                    score.expect(birth, splats)
                kept = _unchanged(file, options.kept(splats), survey)
                if is_still or options.exact:
                    whole = Slice(birth, kept, np.zeros(len(kept), np.uint8))
                    update = whole_update(whole, manifest.slot_layout, rank, options.exact)
                else:
                    update = filler.update(birth, kept)
                num_escaped += int(np.count_nonzero(update.escaped))
                writer.append(update)
                num_done = len(files) + WRITE_STEPS * (birth + 1)
                progress(num_done, num_steps, f"wrote frame {birth + 1} of {len(files)}")
        first_bytes = sum(StreamReader(folder, max_gaussians=None).records[0].side_bytes[1:])
        manifest = writer.manifest if draw is None else finish_pictures(folder, draw)
    errors = filler.errors
    if is_still and survey.num_gs and not options.exact:
        errors = np.max([steps_of(lattice) for lattice in lattices], axis=0) / 2
    return Imported(
        manifest,
        len(files),
        writer.bytes_written,
        writer.played_bytes,
        first_bytes,
        dict(zip(KINDS, errors.tolist(), strict=True)),
        num_escaped,
        tuple(filler.statuses.tolist()),
        () if score is None else tuple(score.scores_db),
        source_sh_degree,
        notes(),
    )


def _known(rank: Rank) -> Rank:
    if rank not in RANKS:  # callers without a type checker pass any string
        raise InvalidError(f"no rank is called {rank!r}; there are {', '.join(RANKS)}")
    return rank


def _unchanged(file: FramePlace, splats: Splats, survey: Survey) -> Splats:
    """`splats`, read of `file` again. Raises InvalidError if `survey` saw others."""
    if splats.sh_degree != survey.sh_degree or len(splats) > survey.num_gs:
        raise InvalidError(f"{file}: changed while it was imported")
    return splats
