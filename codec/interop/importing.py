"""A stream made of files of Gaussians: one still model, or a numbered sequence.

Every file becomes a slice that lives for one frame (swin_size 1), so that each frame stands by
itself; with the profile lattice only what changes from file to file is sent. A still model is a
stream of one frame. Nothing in that frame ever expires, so a player may hold or repeat it for as
long as it likes.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from codec.camera import Camera
from codec.errors import InvalidError
from codec.pose import Doubles
from codec.profiles.profile import Profile
from codec.slice import Slice
from codec.splats import Splats
from codec.stream.chunk import MAX_SPLATS_PER_CHUNK
from codec.stream.layers import RANKS, Rank
from codec.stream.manifest import Manifest, Point
from codec.stream.poster import POSTER_NAME, Draw, write_poster
from codec.stream.writer import StreamWriter

from .formats import READ, has_known_suffix, read_splats
from .importslots import SlotFiller

WIDTH_PX, HEIGHT_PX = 1280, 720
VERTICAL_FOV_RAD = math.radians(50)
CORE_SHARE = 0.98
"""Share of the centres, along each axis, that the bounds enclose: floaters lie far outside."""
NEAR_SHARE = 0.01
"""Nearest depth drawn, as a share of the bounds' half diagonal: one may walk into the model."""
LAYERS = (0.35, 0.15, 0.2, 0.3)
SEGMENT_FRAMES = 15


@dataclass(frozen=True, slots=True)
class ImportOptions:
    """How files become a stream."""

    fps: float = 30.0
    """Frames shown in a second."""
    profile: Profile = Profile.COMPACT
    """Precision: compact is small, raw keeps every float as it is in the file. lattice sends only
    what changes from file to file; all must have the same Gaussians in the same order."""
    rank: Rank = Rank.COVERAGE
    """Importance that orders Gaussians into layers: coverage, opacity, or given (as in the
    file)."""
    title: str | None = None
    """A name for people; by default the name of the file or folder."""


@dataclass(frozen=True, slots=True)
class Survey:
    """What the manifest must know of all files before the first slice is written."""

    num_gs: int
    sh_degree: int
    lower: Doubles  # (3,) metres
    upper: Doubles  # (3,) metres

    @staticmethod
    def of(splats: Splats) -> Survey:
        if not len(splats):
            return Survey(0, splats.sh_degree, np.full(3, np.inf), np.full(3, -np.inf))
        cut = (1 - CORE_SHARE) / 2
        # Axis by axis, for the quantile takes several float64 copies of what it is given.
        lower, upper = np.transpose(
            [np.quantile(axis.astype(np.float64), (cut, 1 - cut)) for axis in splats.means.T]
        )
        return Survey(len(splats), splats.sh_degree, lower, upper)

    def joined(self, other: Survey) -> Survey:
        return Survey(
            max(self.num_gs, other.num_gs),
            max(self.sh_degree, other.sh_degree),
            np.minimum(self.lower, other.lower),
            np.maximum(self.upper, other.upper),
        )


def find_files(source: Path) -> list[Path]:
    """The file `source`, or those of the folder `source` by the last number in their names.

    Numbers may begin anywhere and have gaps. Raises InvalidError for a folder without files of
    Gaussians, a name without a number, or two names with the same number.
    """
    if not source.is_dir():
        return [source]
    numbered: dict[int, Path] = {}
    for path in sorted(source.iterdir()):
        if path.name.startswith(".") or not has_known_suffix(path) or not path.is_file():
            continue
        digits = re.findall(r"[0-9]+", path.stem)
        if not digits:
            raise InvalidError(f"{path}: its name has no number to sort a sequence by")
        first = numbered.setdefault(int(digits[-1]), path)
        if first is not path:
            raise InvalidError(f"{source}: {first.name} and {path.name} have the same number")
    if not numbered:
        raise InvalidError(f"{source}: no file of Gaussians in this folder ({READ})")
    return [numbered[number] for number in sorted(numbered)]


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


def make_manifest(survey: Survey, options: ImportOptions, title: str) -> Manifest:
    """The manifest of a stream of independent frames of what `survey` found."""
    # A single point, or nothing at all, still needs a box to look at.
    middle = np.zeros(3) if not survey.num_gs else (survey.lower + survey.upper) / 2
    half = np.zeros(3) if not survey.num_gs else (survey.upper - survey.lower) / 2
    half = np.maximum(half, max(0.01 * float(half.max()), 1e-3))
    lower, upper = middle - half, middle + half
    camera = facing_camera(lower, upper)
    return Manifest(
        fps=options.fps,
        swin_size=1,
        num_gs=max(1, survey.num_gs),
        layers=LAYERS,
        segment_frames=SEGMENT_FRAMES,
        sh_degree=survey.sh_degree,
        profile=options.profile,
        antialias=False,
        near_m=NEAR_SHARE * float(np.linalg.norm(half)),
        bounds=(_point(lower), _point(upper)),
        cameras=(camera,),
        default_camera=camera.name,
        live=True,
        title=title,
    )


def _point(values: Doubles) -> Point:
    x, y, z = (float(value) for value in values)
    return x, y, z


def import_stream(
    source: Path, stream: Path, options: ImportOptions, draw: Draw | None = None
) -> Manifest:
    """Writes a finished stream at `stream` of the file or numbered folder `source`, with a poster
    if there is something to draw it with.

    Each file of a sequence is read twice: the manifest comes first and describes them all, and only
    one is in memory at a time. Raises a SwingsError that names the file at fault before anything is
    written.
    """
    files = find_files(source)
    has_slots = options.profile is Profile.LATTICE
    splats = read_splats(files[0], MAX_SPLATS_PER_CHUNK)
    if has_slots and not len(splats):
        raise InvalidError(f"{files[0]}: holds no Gaussian; profile lattice needs one")
    survey = Survey.of(splats)
    for file in files[1:]:
        other = Survey.of(read_splats(file, MAX_SPLATS_PER_CHUNK))
        if has_slots and other.num_gs != survey.num_gs:
            raise InvalidError(
                f"{file}: {other.num_gs} Gaussians where {files[0].name} has {survey.num_gs}; "
                "profile lattice needs the same ones in every file, use another"
            )
        survey = survey.joined(other)
    title = source.resolve().name if options.title is None else options.title
    splats = splats.with_degree(survey.sh_degree)
    filler = None
    if has_slots:
        filler = SlotFiller(splats, LAYERS, RANKS[options.rank])
        plain = make_manifest(survey, replace(options, profile=Profile.COMPACT), title)
        manifest = filler.manifest(plain)
    else:
        manifest = make_manifest(survey, options, title)
    if draw is not None:
        manifest = replace(manifest, poster=POSTER_NAME)
    with StreamWriter.create(stream, manifest, options.rank) as writer:
        for birth, file in enumerate(files):
            if birth:
                splats = read_splats(file, MAX_SPLATS_PER_CHUNK).with_degree(survey.sh_degree)
            if filler is None:
                writer.append(Slice(birth, splats, np.zeros(len(splats), np.uint8)))
            else:
                writer.append(filler.update(birth, splats))
    if draw is not None:
        write_poster(stream, draw)
    return writer.manifest
