"""What a person reads about a calibrated rig."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trainer.capture.capture import Capture

from .offsets import Synchrony
from .verdicts import Verdict

REPORT_NAME = "calibration.txt"

LENS_TEXT = {
    "one": "one for all cameras of a kind",
    "like": "one for each camera, like those of its kind",
    "free": "one for each camera",
}


def report_lines(
    capture: Capture,
    synchrony: Synchrony,
    lens: str,
    verdicts: Sequence[Verdict],
    has_floor: bool,
    has_unit: bool,
) -> list[str]:
    """The report: of the rig, then of each camera. has_floor, has_unit: whether up comes from a
    floor, and the unit from a known distance."""
    wrong = [verdict for verdict in verdicts if verdict.wrong]
    right = [verdict for verdict in verdicts if not verdict.wrong]
    apart, turned, unseen = np.array([(v.apart, v.apart_deg, v.unseen_px) for v in right]).T
    rate = "" if synchrony.fps is None else f" at {synchrony.fps:g} per second"
    unit = "metres" if has_unit else "unknown: cameras are some 3 units from the middle (--metres)"
    lines = [
        f"capture     {capture.root}",
        f"cameras     {len(right)} of {len(verdicts)}",
        f"frames      {capture.num_frames}{rate}, synchronised {synchrony.how}",
        f"lenses      {LENS_TEXT[lens]}",
        f"halves      of the take place cameras {np.median(apart):.2%} of their distance to the "
        f"scene ({apart.max():.2%} at most) and {np.median(turned):.2f} degrees "
        f"({turned.max():.2f}) apart; the whole is better than its halves",
        f"unseen      moments are missed by {np.median(unseen):.2f} px ({unseen.max():.2f})",
        f"up          z, {'from the floor' if has_floor else 'as the cameras are held'}",
        f"unit        {unit}",
        *(f"note        {note}" for note in synchrony.notes),
        *(f"left out    {verdict.name} {verdict.wrong}" for verdict in wrong),
        "",
        f"{'camera':16} {'from origin':>11} {'focal px':>9} {'apart':>7} {'degrees':>7} {'px':>6}",
    ]
    cameras = {entry.camera.name: entry.camera for entry in capture.cameras}
    for v in right:
        camera = cameras[v.name]
        lines.append(
            f"{v.name:16} {np.linalg.norm(camera.position):11.2f} {camera.fx_px:9.1f} "
            f"{v.apart:7.2%} {v.apart_deg:7.2f} {v.unseen_px:6.2f}"
        )
    return lines
