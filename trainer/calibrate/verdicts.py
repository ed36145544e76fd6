"""Whether a rig is right, and not merely complete: what two halves of the take, and moments that a
rig has not seen, say of it, camera by camera."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from codec.arrays import Doubles, Flags
from trainer.errors import CaptureError

from .mapping import LEAST_SHARED, LENSES
from .solution import UNSEEN_PX, Solution, align, angles_deg, centres, unseen_errors

LEAST_CAMERAS, LEAST_SHARE = 4, 0.75
"""Number and share of the cameras that must be right for a rig to be written."""

MOVED_PX = 1.5
"""Offset of the still part of a picture, at 640 pixels of width, from which on a camera moved."""

APART, APART_DEG = 0.1, 5.0
"""By how much the two halves may place a camera apart, over its distance to the scene, and turn it.
Of basketball's 31 cameras the one with the longest lens has 6 %, and is 2 cm off in the whole."""

TYPICAL, TYPICAL_DEG = 0.025, 1.5
"""The same in the median over the cameras: above, the rig is refused."""

LEAST_UNSEEN = 12
"""Points of unseen moments by which a camera is judged."""

TWIN_SHARE = 0.003
"""Distance of two cameras, over that to the scene, below which they are one."""

MAX_LISTED = 12
"""Cameras that a refusal names."""

FEW_FEATURES = 60
"""Features in a picture, below which it is blank or out of focus."""


def judge(
    solution: Solution, names: Sequence[str], widths_px: Sequence[int]
) -> tuple[Halves, dict[int, str]]:
    """The halves with the kind of lens with which the rig is best; and of each camera that is
    wrong, reason and remedy. Raises CaptureError for a rig that is wrong."""
    wrong = {i: text for i, text in enumerate(moved(solution.moved_px, widths_px)) if text}
    complete = [
        lens
        for lens in LENSES
        if all((name, lens) in solution.rigs for name in ("first", "second", "whole"))
    ]
    each = [_compared(solution, lens, widths_px) for lens in complete]
    # Neither would do alone: an arc that bends fits unseen moments, too, and one lens for unlike
    # cameras bends both halves alike.
    best = min(each, key=lambda c: c.error_px * c.typical, default=None)
    placed = np.zeros(len(names), bool) if best is None else best.placed
    for i in map(int, np.flatnonzero(~placed)):
        wrong.setdefault(i, _why_unplaced(solution, names, i))
    if best is None or placed.sum() < LEAST_CAMERAS:
        raise CaptureError(
            "no rig was found that both halves of the take agree on: cameras must overlap "
            f"(neighbours at most some 20 degrees apart) and see texture{_listed(names, wrong)}"
        )
    apart, apart_deg, twins, unseen = best.apart, best.apart_deg, best.twins, best.unseen_px
    typical_deg = float(np.nanmedian(apart_deg))
    if best.typical > TYPICAL or typical_deg > TYPICAL_DEG:
        raise CaptureError(
            f"the rig is not certain: two halves of the take give rigs whose cameras lie "
            f"{best.typical:.1%} of their distance to the scene and {typical_deg:.1f} degrees "
            f"apart; film with more cameras, texture or time{_listed(names, wrong)}"
        )
    for i in map(int, np.flatnonzero(placed)):
        reason = ""
        if i in twins:
            reason = f"stands where {names[twins[i]]} does: the same video twice? Leave one out"
        elif apart[i] > APART or apart_deg[i] > APART_DEG:
            reason = (
                f"is placed {apart[i]:.0%} of its distance to the scene and {apart_deg[i]:.1f} "
                "degrees apart by the two halves of the take: it is out of step (--offsets), or "
                "shares too little with the others; film with neighbours at most 20 degrees apart"
            )
        elif np.isnan(unseen[i]):
            reason = (
                "shares too few points with two others at once for its place "
                "to be checked; film with neighbours nearer to it"
            )
        elif unseen[i] > UNSEEN_PX * max(1.0, widths_px[i] / 640):
            reason = (
                f"misses points of unseen moments by {unseen[i]:.1f} px: out of focus, out of step "
                "with the others (--offsets), or a lens that is not like theirs"
            )
        if reason:
            wrong.setdefault(i, reason)
    require_enough(names, wrong)
    return best, wrong


def require_enough(names: Sequence[str], wrong: Mapping[int, str]) -> None:
    """Raises CaptureError, with the reasons of those that are wrong, unless enough cameras are
    right."""
    right = len(names) - len(wrong)
    if right < max(LEAST_CAMERAS, LEAST_SHARE * len(names)):
        raise CaptureError(f"{right} of {len(names)} cameras are right{_listed(names, wrong)}")


@dataclass(frozen=True, slots=True, eq=False)
class Halves:
    """How well the halves of a take agree with each other, with one kind of lens."""

    lens: str
    """One of mapping.LENSES."""
    placed: Flags
    """(C,) whether all three rigs have the camera."""
    apart: Doubles
    """(C,) distance between the places that the halves give a camera, over that to the scene."""
    apart_deg: Doubles
    """(C,) angle between its views."""
    unseen_px: Doubles
    """(C,) median error of points of unseen moments, placed by the other cameras; NaN where too
    few points tell it."""
    twins: dict[int, int]
    """Of each camera that stands where an earlier one does, which that is."""

    @property
    def typical(self) -> float:
        """Median of `apart`."""
        known = self.apart[np.isfinite(self.apart)]
        return float(np.median(known)) if len(known) else np.inf

    @property
    def error_px(self) -> float:
        """Mean of `unseen_px`."""
        known = self.unseen_px[np.isfinite(self.unseen_px)]
        return float(known.mean()) if len(known) else np.inf


def _compared(solution: Solution, lens: str, widths_px: Sequence[int]) -> Halves:
    rigs = [solution.rigs[name, lens] for name in ("first", "second", "whole")]
    placed = np.all([rig.has for rig in rigs], axis=0)
    apart, apart_deg = np.full(len(placed), np.nan), np.full(len(placed), np.nan)
    errors = unseen_errors(solution, lens, widths_px)
    unseen = np.array([np.median(e) if len(e) >= LEAST_UNSEEN else np.nan for e in errors])
    if placed.sum() < 2:
        return Halves(lens, placed, apart, apart_deg, unseen, {})
    one, other, whole = (rig.poses[placed] for rig in rigs)
    one, other = (align(half, whole).poses(half) for half in (one, other))
    places, index = centres(whole), np.flatnonzero(placed)
    distances = np.linalg.norm(places - np.median(rigs[2].points, axis=0), axis=1)
    apart[placed] = np.linalg.norm(centres(one) - centres(other), axis=1) / distances
    apart_deg[placed] = angles_deg(one[:, :, :3], other[:, :, :3])
    between = np.linalg.norm(places[:, None] - places[None], axis=2)
    pairs = np.argwhere(np.triu(between < TWIN_SHARE * np.median(distances), 1))
    twins = {int(index[j]): int(index[i]) for i, j in pairs}
    return Halves(lens, placed, apart, apart_deg, unseen, twins)


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
            usual = np.median(known[away])
            if once and np.median(np.abs(known[away] - usual)) < 0.2 * usual:
                after = int(np.argmax(away != away[0])) / len(known)
                text = (
                    f"moved during the take, after {after:.0%} of it, by "
                    f"{usual:.0f} px; cut the take there, or leave the camera out"
                )
        found.append(text)
    return found


def _why_unplaced(solution: Solution, names: Sequence[str], camera: int) -> str:
    moments = solution.keypoints[camera][:, 2].astype(int)
    features = np.bincount(moments, minlength=1).max()
    if features < FEW_FEATURES:
        return f"shows nothing to recognise ({features} features): blank or out of focus"
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


def _listed(names: Sequence[str], wrong: Mapping[int, str]) -> str:
    return "".join(f". {names[i]} {wrong[i]}" for i in sorted(wrong)[:MAX_LISTED])
