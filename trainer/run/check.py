"""Contents of a capture and doubts about it, in lines, before hours of training."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from rich.console import Console

from codec.framerange import FrameRange
from codec.progressline import waiting
from codec.rig import rig_centre
from codec.sequence.survey import FPS_NAME
from trainer.calibrate.lateness import late_doubts
from trainer.capture.capture import Capture, check_trainable
from trainer.capture.layout import open_capture
from trainer.capture.layouts import TITLES
from trainer.capture.points import read_points_file
from trainer.rig.doubts import (
    coverage_doubts,
    describe_coverage,
    picture_doubt,
    picture_doubts,
    rig_doubts,
    unseen_shares,
)
from trainer.rig.nearplane import FALLBACK_NEAR_M, Seen, look, near_doubts, near_plane, near_planes
from trainer.rig.rigdrawing import draw_capture
from trainer.seed.gaussians import STRAY_SHARE

from .config import TrainConfig

MAX_NAMED_PLANES = 6
"""Cameras whose own near plane is printed."""

SILENT = Console(quiet=True)


def check_capture(config: TrainConfig, console: Console = SILENT) -> list[str]:
    """Opens the capture, reads the first and the last frame of each camera with its mask, and the
    first frames to see whether all run in step, describes it, and draws it to the PNG of
    `config.check`, if there is one. What is doubtful about it comes last, a line each. console:
    where it says what it is waiting for.

    Raises SwingsError for what would stop training, other than a missing frame rate.
    """
    capture = open_capture(config.capture, config.choice)
    if config.points is not None:
        capture = replace(capture, points=read_points_file(config.points))
    if config.fps is not None:
        capture = replace(capture, fps=config.fps)
    with waiting(console, f"reading frames of {len(capture.cameras)} cameras"):
        doubted = _read_ends(capture)
        check_trainable(capture)
        frames = FrameRange.parse(config.frames).of(capture.num_frames, capture.root)
        seen = look(capture, frames)
        late = late_doubts(capture, frames)
    near, cut_doubts = _describe_near(capture, seen, config.near_m)
    unseen = unseen_shares(capture)
    lines = describe_capture(capture) + describe_coverage(capture, unseen) + near
    if config.check is not None:
        by_name = draw_capture(capture, config.check)
        lines.append(f"picture     {config.check}")
        if not by_name:
            numbers = ", ".join(f"{n} {c.camera.name}" for n, c in enumerate(capture.cameras))
            lines.append(
                "labels      numbers, as no font here has all letters of the names: " + numbers
            )
    doubts = [
        *rig_doubts(capture),
        *late,
        *cut_doubts,
        *coverage_doubts(unseen),
        *picture_doubts(doubted, len(capture.cameras)),
    ]
    if capture.fps is None:
        doubts.append(f"no file gives the frame rate: train with --fps, or write {FPS_NAME}")
    return lines + [f"warning     {doubt}" for doubt in doubts]


def _read_ends(capture: Capture) -> dict[str, str]:
    """Reads the first and the last frame of each camera; what is doubtful of them, by camera."""
    doubted = {}
    for index, entry in enumerate(capture.cameras):
        source = capture.open_images(index)
        try:
            for frame in sorted({0, capture.num_frames - 1}):
                picture = source.read(frame)
                mask = None if entry.masks is None else entry.masks.read(frame)
                doubt = picture_doubt(picture, mask)
                if doubt is not None:
                    doubted[entry.camera.name] = doubt
        finally:
            source.close()
    return doubted


def describe_capture(capture: Capture) -> list[str]:
    """Lines for people: layout, cameras, held-out cameras, sizes, masks, frames, depths, points.

    Lengths are in the capture's unit, which no layout names.
    """
    cameras = [c.camera for c in capture.cameras]
    sizes = Counter(f"{c.width_px}x{c.height_px}" for c in cameras)
    centre = rig_centre(cameras)
    if centre is not None:
        centre = np.where(np.abs(centre) < 1e-6 * np.abs(centre).max(), 0, centre)
    far = "unknown from the rig" if capture.far_m is None else f"{capture.far_m:.3g} units"
    if len(sizes) == 1:
        size = f"{next(iter(sizes))} px"
    else:
        size = ", ".join(f"{size} px ({count})" for size, count in sizes.most_common())
    if capture.fps is None:
        frames = f"{capture.num_frames}, no file gives the frame rate"
    else:
        seconds = capture.num_frames / capture.fps
        frames = f"{capture.num_frames} at {capture.fps:g} per second: {seconds:.1f} s"
    held_out = [cameras[i].name for i in capture.held_out]
    return [
        f"capture     {capture.root}",
        f"layout      {TITLES[capture.layout]}",
        f"cameras     {len(cameras)}, of which {len(capture.training)} to train on",
        f"held out    {', '.join(held_out) or 'none: nothing to score with'}",
        f"size        {size}",
        f"masks       {_describe_masks(capture)}",
        f"frames      {frames}",
        "rig         "
        + (
            "looks one way"
            if centre is None
            else f"looks at ({', '.join(f'{x:.3g}' for x in centre)}), in the capture's units"
        ),
        f"points      {len(capture.points) if capture.points is not None else 'none'}",
        f"far         {far}",
    ]


def _describe_near(
    capture: Capture, seen: Seen | None, near_m: float | None
) -> tuple[list[str], list[str]]:
    """Lines about where the near plane is and why, and what is doubtful about it."""
    planes: tuple[float, ...] = ()
    if near_m is None:
        near_m, reason = near_plane(capture, seen), "from the rig"
        planes = near_planes(capture, seen)
        if near_m is None:
            near_m, reason = FALLBACK_NEAR_M, "by default: unknown from the rig; give --near-m"
        elif capture.near_m is not None and near_m < capture.near_m:
            reason = f"from what the cameras see; the rig alone would give {capture.near_m:.3g}"
    else:
        reason = "as given"
    lines = [f"near        {near_m:.3g} units, {reason}"]
    lines += _own_planes(capture, planes, near_m)
    doubts = near_doubts(capture, seen, planes or near_m)
    if seen is not None and not doubts:
        lines.append(f"near cuts   at most {STRAY_SHARE:.1%} of what any camera sees")
    return lines, doubts


def _own_planes(capture: Capture, planes: Sequence[float], near_m: float) -> list[str]:
    """A line about the cameras with near planes of their own, if there are any."""
    if set(planes) <= {near_m}:
        return []
    nearer = sorted(
        (plane, entry.camera.name)
        for plane, entry in zip(planes, capture.cameras, strict=True)
        if plane < near_m
    )
    named = [f"{name} {plane:.3g}" for plane, name in nearer[:MAX_NAMED_PLANES]]
    if len(nearer) > MAX_NAMED_PLANES:
        named.append(f"{len(nearer) - MAX_NAMED_PLANES} more")
    return [f"near of     {', '.join(named)}, in their own views"]


def _describe_masks(capture: Capture) -> str:
    masks = [c.masks for c in capture.cameras if c.masks is not None and c.masks.has_files]
    if not masks:
        are_seen = all(c.masks is None for c in capture.cameras)
        return "none: every pixel counts" + " that its lens shows" * (not are_seen)
    still = sum(m.is_still for m in masks)
    return (
        f"{len(masks)} of {len(capture.cameras)} cameras have them, {still} one for all frames; "
        "black is ignored"
    )
