"""Whether a rig is right, and not merely complete: what two halves of the take, and moments that a
rig has not seen, say of it, camera by camera.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from codec.pose import Doubles
from trainer.capture.camerachoice import named
from trainer.errors import CaptureError

from .alignment import align, angles_deg, centres
from .mapping import LEAST_SHARED
from .solution import UNSEEN_PX, Rig, Solution, choose_lens, unseen_errors

LEAST_CAMERAS, LEAST_SHARE = 4, 0.75
"""Number and share of the cameras that must be right for a rig to be written."""

MOVED_PX = 1.5
"""Offset of the still part of a picture, at 640 pixels of width, from which on a camera moved."""

APART, APART_DEG = 0.05, 3.0
"""By how much the two halves may place a camera apart, over its distance to the scene, and turn it;
half of that in the median."""

LEAST_UNSEEN = 12
"""Points of unseen moments by which a camera is judged."""

TWIN_SHARE = 0.003
"""Distance of two cameras, over that to the scene, below which they are one."""

FEW_FEATURES = 60
"""Features in a picture, below which it is blank or out of focus."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """What was found out about one camera."""

    name: str
    wrong: str
    """Reason and remedy; empty for a camera that is right."""
    unseen_px: float
    """Median error of points of unseen moments, placed by the other cameras."""
    apart: float
    """Distance between the places that the two halves give it, over its distance to the scene."""
    apart_deg: float
    """Angle between their views."""


def judge(
    solution: Solution, names: Sequence[str], widths_px: Sequence[int]
) -> tuple[str, list[Verdict]]:
    """The kind of lens, of mapping.LENSES, with which the rig is best, and what is to be said of
    each camera. Raises CaptureError for a rig that is wrong."""
    lens = choose_lens(solution, widths_px)
    wrong = {i: text for i, text in enumerate(moved(solution.moved_px, widths_px)) if text}
    rigs = [solution.rigs.get((name, lens)) for name in ("first", "second", "whole")]
    found = [rig for rig in rigs if rig is not None]
    placed = np.zeros(len(names), bool)
    if len(found) == len(rigs):
        placed = np.all([rig.has for rig in found], axis=0)
    for i in map(int, np.flatnonzero(~placed)):
        wrong.setdefault(i, _why_unplaced(solution, names, i))
    if placed.sum() < LEAST_CAMERAS:
        raise CaptureError(
            "no rig was found that both halves of the take agree on: cameras must overlap "
            f"(neighbours at most some 20 degrees apart) and see texture{_listed(names, wrong)}"
        )
    apart, apart_deg, twins = _compared(found, placed)
    errors = unseen_errors(solution, lens, widths_px)
    unseen = [float(np.median(e)) if len(e) >= LEAST_UNSEEN else np.nan for e in errors]
    for i in map(int, np.flatnonzero(placed)):
        reason = ""
        if i in twins:
            reason = f"stands where {names[twins[i]]} does: the same video twice? Leave one out"
        elif apart[i] > APART or apart_deg[i] > APART_DEG:
            reason = (
                f"is placed {apart[i]:.0%} of its distance to the scene and {apart_deg[i]:.1f} "
                "degrees apart by the two halves of the take: it moved, or shares too little with "
                "the others; film with neighbours at most 20 degrees apart"
            )
        elif np.isnan(unseen[i]):
            reason = (
                f"shares too few points with two others at once ({len(errors[i])}) for its place "
                "to be checked; film with neighbours nearer to it"
            )
        elif unseen[i] > UNSEEN_PX * max(1.0, widths_px[i] / 640):
            reason = (
                f"misses points of unseen moments by {unseen[i]:.1f} px: out of step with the "
                "others (--offsets), or a lens that is not like theirs"
            )
        if reason:
            wrong.setdefault(i, reason)
    typical, typical_deg = float(np.nanmedian(apart)), float(np.nanmedian(apart_deg))
    if typical > APART / 2 or typical_deg > APART_DEG / 2:
        raise CaptureError(
            f"the rig is not certain: two halves of the take give rigs whose cameras lie "
            f"{typical:.0%} of their distance to the scene and {typical_deg:.1f} degrees apart; "
            f"film with more cameras, texture or time{_listed(names, wrong)}"
        )
    right = len(names) - len(wrong)
    if right < max(LEAST_CAMERAS, LEAST_SHARE * len(names)):
        raise CaptureError(f"{right} of {len(names)} cameras are right{_listed(names, wrong)}")
    each = zip(names, unseen, apart, apart_deg, strict=True)
    return lens, [
        Verdict(name, wrong.get(i, ""), px, float(away), float(deg))
        for i, (name, px, away, deg) in enumerate(each)
    ]


def _compared(
    rigs: Sequence[Rig], placed: npt.NDArray[np.bool_]
) -> tuple[Doubles, Doubles, dict[int, int]]:
    """Of each camera how far the halves place it apart, over its distance to the scene, and turn
    it, degrees; and of each camera that stands where an earlier one does, which that is."""
    one, other, whole = (rig.poses[placed] for rig in rigs)
    one, other = (align(half, whole).poses(half) for half in (one, other))
    places, index = centres(whole), np.flatnonzero(placed)
    distances = np.linalg.norm(places - np.median(rigs[2].points, axis=0), axis=1)
    apart, apart_deg = np.full(len(placed), np.nan), np.full(len(placed), np.nan)
    apart[placed] = np.linalg.norm(centres(one) - centres(other), axis=1) / distances
    apart_deg[placed] = angles_deg(one[:, :, :3], other[:, :, :3])
    between = np.linalg.norm(places[:, None] - places[None], axis=2)
    pairs = np.argwhere(np.triu(between < TWIN_SHARE * np.median(distances), 1))
    return apart, apart_deg, {int(index[j]): int(index[i]) for i, j in pairs}


def moved(moved_px: Doubles, widths_px: Sequence[int]) -> list[str]:
    """For each camera why it does not stand still; empty where it does. moved_px: (C, M)."""
    found = []
    for row, width_px in zip(moved_px, widths_px, strict=True):
        known = row[np.isfinite(row)]
        away = known > MOVED_PX * max(1.0, width_px / 640)
        text = ""
        if away.sum() >= 2:
            text = (
                f"is not still (up to {known.max():.0f} px from moment to moment): hand-held "
                "cameras cannot be calibrated; use a tripod and switch stabilisation off"
            )
            once = np.abs(np.diff(away.astype(int))).sum() == 1
            if once and np.ptp(known[away]) < 0.5 * np.median(known[away]):
                after = int(np.argmax(away != away[0])) / len(known)
                text = (
                    f"moved during the take, after {after:.0%} of it, by "
                    f"{np.median(known[away]):.0f} px; cut the take there, or leave the camera out"
                )
        found.append(text)
    return found


def _why_unplaced(solution: Solution, names: Sequence[str], camera: int) -> str:
    moments = solution.keypoints[camera][:, 2].astype(int)
    features = float(np.median(np.bincount(moments))) if len(moments) else 0.0
    if features < FEW_FEATURES:
        return f"shows nothing to recognise ({features:.0f} features): blank or out of focus"
    shared: Counter[int] = Counter()
    for matches in solution.matches.values():
        for (a, b), found in matches.items():
            if camera in (a, b):
                shared[b if a == camera else a] += len(found)
    best, most = shared.most_common(1)[0] if shared else (0, 0)
    if most < 2 * LEAST_SHARED:
        return (
            "shows nothing that another camera shows: another room, out of focus, or more than "
            "some 25 degrees from its neighbours"
        )
    return (
        f"shares too few points with the others (most with {names[best]}: {most}) to be placed by "
        "each half of the take; film with neighbours at most 20 degrees apart"
    )


def _listed(names: Sequence[str], wrong: dict[int, str]) -> str:
    return ". " * bool(wrong) + named([f"{names[i]} {wrong[i]}" for i in sorted(wrong)])
