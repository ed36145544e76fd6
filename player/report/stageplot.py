"""A profile of stages as a picture: what each frame's time went into."""

from __future__ import annotations

import io
from pathlib import Path

import matplotlib.backends.backend_agg
import matplotlib.figure
import numpy as np

from codec.files import write_atomic

from .playplot import MAX_TITLE_CHARS
from .stages import STAGES, StageProfile

COLOURS = ("#33307a", "#2a78b5", "#2fa58a", "#f0b84a", "#d8452e")


def write_stage_plot(path: Path, profile: StageProfile) -> None:
    """Draws the profile into a PNG; the file is whole or absent."""
    figure = matplotlib.figure.Figure(figsize=(10, 4.2), dpi=120, layout="constrained")
    axes = figure.subplots()
    frames = [one.frame for one in profile.frames]
    times = np.array([one.stages_ms for one in profile.frames]).T
    axes.stackplot(frames, times, labels=STAGES, colors=COLOURS)
    axes.axhline(1000 / profile.fps, color="black", lw=0.8, ls="--", label="frame duration")
    # The first frame brings a whole window, and may still compile something.
    top_ms = max(np.percentile(times.sum(axis=0), 98), 1000 / profile.fps)
    axes.set_ylim(0, 1.2 * top_ms)
    axes.set_xlim(frames[0], max(frames[-1], frames[0] + 1))
    axes.set_xlabel("frame")
    axes.set_ylabel("ms")
    name = profile.source
    name = name if len(name) <= MAX_TITLE_CHARS else f"...{name[-MAX_TITLE_CHARS:]}"
    axes.set_title(
        f"{name}, {profile.size}, {profile.renderer}",
        fontsize=10,
        parse_math=False,  # a name is anybody's text
    )
    axes.legend(ncols=6, loc="upper right", fontsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    picture = io.BytesIO()
    matplotlib.backends.backend_agg.FigureCanvasAgg(figure)
    figure.savefig(picture, format="png")
    write_atomic(path, picture.getvalue())
