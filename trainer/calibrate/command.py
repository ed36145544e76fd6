"""swings-capture calibrate: videos of cameras that stand still become a capture."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from rich.console import Console

from codec.errors import InvalidError
from codec.files import making_folder
from codec.progressline import counted
from trainer.capture.layout import open_capture
from trainer.errors import CaptureError
from trainer.rig.rigdrawing import draw_capture

from .capturecommand import Calibrate
from .mapping import LENSES, RESULT_NAME, Job
from .moments import UNCHANGED, write_moments
from .offsets import Synchrony, confirmed, equally_long, stepped, synchronise
from .solution import Solution, metres_of_unit, read_solution, world_of
from .takes import Take, find_takes
from .verdicts import judge, require_enough
from .writing import REPORT_NAME, calibrated, coloured_points, report_lines, write_capture

PICTURE_NAME = "rig.png"

LEAST_MOMENTS = 6
"""Fewer moments cannot be cut into halves that each give a rig."""

PICTURES, FEW_MOMENTS, MANY_MOMENTS = 640, 16, 60
"""Pictures of all cameras together that the moments should have, and least and most moments, where
--moments does not tell: a rig of few cameras has few features, and is solved in little time."""

FIRST_MOMENTS = 10
"""Moments of the first rigs, that tell when takes without sound began."""


def calibrate(config: Calibrate, console: Console | None = None) -> str:
    """Writes the capture, and gives its report. Raises CaptureError for a rig that cannot be found,
    or that is found and is wrong; then nothing is written."""
    if len(config.videos) < 2:
        raise InvalidError("name the videos, or their folder, and last the folder to make")
    if config.moments is not None and config.moments < LEAST_MOMENTS:
        raise InvalidError(f"moments {config.moments}: must be at least {LEAST_MOMENTS}")
    if find_spec("pycolmap") is None:
        raise CaptureError("pycolmap is not installed; pip install '.[calibrate]'")
    *given, target = config.videos
    takes = find_takes(given, config.without_cameras)
    for name in config.metres[:2] if config.metres else ():
        if name not in [take.name for take in takes]:
            raise InvalidError(f"--metres: there is no camera {name!r}")
    with (
        making_folder(target) as folder,
        tempfile.TemporaryDirectory(prefix="swings-calibrate-") as temporary,
        counted("calibrating", console) as show,
    ):
        work = Path(temporary)

        def advance(share: float) -> None:
            show(round(100 * share), 100)

        synchrony = synchronise(takes, config.offsets, lambda share: advance(0.1 * share))
        done = 0.1
        if synchrony.moving_px and not equally_long(takes):
            synchrony = _in_step(
                config, takes, synchrony, work, lambda share: advance(0.1 + 0.2 * share)
            )
            done = 0.3
        moments = config.moments or _default_moments(len(takes), synchrony.num_frames)
        if synchrony.num_frames < moments:
            raise CaptureError(
                f"{given[0]}: frames that all cameras show: {synchrony.num_frames}, where "
                f"{moments} moments are needed (--moments): a rig of few cannot be told "
                "from a wrong one; film longer"
            )
        sizes, changes = write_moments(
            takes, synchrony, moments, config.longest_px, work,
            lambda share: advance(done + 0.1 * share),
        )  # fmt: skip
        if float(np.median(changes.max(axis=0))) < UNCHANGED:
            raise CaptureError(
                f"{given[0]}: all {moments} moments look the same, and a rig made of one "
                "moment cannot be told from a wrong one: film while something moves"
            )
        job = _job(config, takes, sizes, moments, in_step=True)
        solution = _solve(job, work, lambda share: advance(done + 0.1 + (0.9 - done) * share))
        return _write(config, takes, sizes, synchrony, solution, work, folder)


def _default_moments(num_cameras: int, num_frames: int) -> int:
    """The number of moments for a take of so many frames, which may be too short for them."""
    wanted = min(max(PICTURES // num_cameras, FEW_MOMENTS), MANY_MOMENTS)
    return min(wanted, max(num_frames, FEW_MOMENTS))


def _in_step(
    config: Calibrate,
    takes: Sequence[Take],
    guess: Synchrony,
    folder: Path,
    advance: Callable[[float], None],
) -> Synchrony:
    """The synchrony of takes of which only movement tells when they began: by a rig of what stands
    still, and by one of moments that are nearly in step."""
    for turn, in_step in enumerate((False, True)):

        def advance_turn(share: float, turn: int = turn) -> None:
            advance((turn + share) / 2)

        work = folder / f"first{turn}"
        work.mkdir()
        sizes, _ = write_moments(
            takes, guess, FIRST_MOMENTS, config.longest_px, work, lambda share: None
        )
        job = _job(config, takes, sizes, FIRST_MOMENTS, in_step)
        rig = _solve(job, work, advance_turn).rigs.get(("whole", LENSES[0]))
        guess = guess if rig is None else stepped(takes, guess, rig)
    return guess


def _job(
    config: Calibrate,
    takes: Sequence[Take],
    sizes: Sequence[tuple[int, int]],
    num_moments: int,
    in_step: bool,
) -> Job:
    shapes = [(take.width_px, take.height_px) for take in takes]
    kinds = [shapes.index(shape) for shape in shapes]
    half = num_moments // 2
    halves = list(range(half)), list(range(half, num_moments))
    return Job(sizes, kinds, halves, in_step, config.features, config.threads)


def _solve(job: Job, work: Path, advance: Callable[[float], None]) -> Solution:
    """Runs pycolmap in a process of its own and gives what it found."""
    job.write(work)
    log = work / "log.txt"
    command = [sys.executable, "-m", "trainer.calibrate.mapping", str(work)]
    with (
        log.open("wb") as errors,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True) as process,
    ):
        try:
            for line in process.stdout or ():
                if line.startswith("progress "):
                    advance(float(line.split()[1]))
        except BaseException:
            process.kill()
            raise
    if process.returncode != 0:
        last = log.read_text(errors="replace").strip().splitlines()[-1:]
        raise CaptureError(f"pycolmap ended with {process.returncode}: {' '.join(last)[:300]}")
    return read_solution(work / RESULT_NAME, len(job.sizes_px))


def _write(
    config: Calibrate,
    takes: Sequence[Take],
    sizes: Sequence[tuple[int, int]],
    synchrony: Synchrony,
    solution: Solution,
    work: Path,
    folder: Path,
) -> str:
    names = [take.name for take in takes]
    halves, wrong = judge(solution, names, [size[0] for size in sizes])
    rig = solution.rigs["whole", halves.lens]
    right = [i for i in range(len(names)) if i not in wrong]
    synchrony, lost = confirmed(takes, synchrony, rig, right)
    wrong |= lost
    require_enough(names, wrong)
    right = [i for i in range(len(names)) if i not in wrong]
    for i, reason in wrong.items():
        if config.metres is not None and names[i] in config.metres:
            raise CaptureError(f"--metres: {names[i]} {reason}")
    cameras = calibrated(rig, takes, sizes, right)
    plain = [each.camera for each in cameras]
    scale = None if config.metres is None else metres_of_unit(plain, *config.metres)
    world, has_floor = world_of(plain, rig.points, scale)
    poses = world.poses(np.array([camera.w2c[:3] for camera in plain]))
    placed = [
        replace(each, camera=replace(each.camera, w2c=np.vstack([pose, [0, 0, 0, 1]])))
        for each, pose in zip(cameras, poses, strict=True)
    ]
    points = coloured_points(rig, solution, world, right, work)
    write_capture(folder, placed, [takes[i] for i in right], synchrony, points)
    capture = replace(open_capture(folder), root=config.videos[-1])
    draw_capture(capture, folder / PICTURE_NAME)
    has_unit = config.metres is not None
    lines = report_lines(capture, synchrony, halves, names, wrong, has_floor, has_unit)
    (folder / REPORT_NAME).write_text("\n".join(lines) + "\n", encoding="utf-8")
    return "\n".join(lines)
