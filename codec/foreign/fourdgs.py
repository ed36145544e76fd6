"""Sequences in the .4dgs container (avala-ai/4dgs), model `keyframe-delta`: one frame for each
state, or several where a state lasts for several.

At time t a Gaussian shows if win_lo <= t < win_hi and its fading, exp(-((t - mu) / sigma)^2 / 2),
is not below the cutoff. It lies at position + motion (t - mu); its opacity is its own times the
fading. Colours are 0..1 as they are shown, (0.5 + SH_C0 f_dc). The axes are those of the source:
those of the PLY, RDF, where the file was made of one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from codec.errors import CorruptError, UnsupportedError
from codec.pose import Doubles
from codec.splats import SH_C0, Splats, sh_count

from . import fourdgsrecords as records
from .fourdgsrecords import read_contents
from .fourdgsstate import FIRST_BAND, State, read_delta, read_keyframe
from .levels import restore_largest
from .limits import MAX_GAUSSIANS, Decoded, check_frames

NEVER_FADES = 1
SPACING_SLACK = 0.01
"""How far from a whole number of frames a state may last, as a share of a frame."""
XYZW_TO_WXYZ = (3, 0, 1, 2)


@dataclass(frozen=True, slots=True)
class _Grid:
    """Units of the integers of a state."""

    origin: Doubles
    steps: tuple[float, ...]
    windows: Doubles  # (W, 2) seconds
    cutoff: float
    sh_degree: int

    def splats(self, state: State, time_s: float) -> Splats:
        """The Gaussians of `state` that show at `time_s`."""
        position, size, rotation, colour, opacity, motion, time, log_sigma = self.steps
        columns = state.columns
        windows = columns[records.WINDOW][:, 0]
        if len(windows) and not 0 <= windows.min() <= windows.max() < len(self.windows):
            raise CorruptError(f".4dgs: a window of {len(self.windows)} that is not there")
        lasts = columns[records.FLAGS][:, 0] & NEVER_FADES != 0
        lows, highs = self.windows[windows].T
        with np.errstate(all="ignore"):  # infinities and NaN are refused by `checked`
            sigma = np.exp(columns[records.SIGMA][:, 0] * log_sigma)
            support = math.sqrt(-2 * math.log(self.cutoff))
            half = np.clip(np.where(lasts, highs - lows, support * sigma), 0.02, 2)
            classes = np.clip(np.ceil(np.log2(half / 0.5)), -4, 2)
            motions = columns[records.MOTION] * (motion * 2.0**-classes)[:, None]
            wanted = np.where(lasts, time, np.minimum(time, 0.05 * sigma))
            times = time * 2.0 ** np.clip(np.floor(np.log2(wanted / time)), -10, 0)
            since_s = time_s - columns[records.TIME][:, 0] * times
            fading = np.where(lasts, 1, np.exp(-0.5 * (since_s / sigma) ** 2))
            is_seen = fading >= self.cutoff
        shown = np.flatnonzero((lows <= time_s) & (time_s < highs) & is_seen)
        made = Decoded.empty(len(shown), self.sh_degree)
        for block in made.blocks():
            rows = shown[block]
            with np.errstate(all="ignore"):
                made.means[block] = (
                    self.origin
                    + columns[records.POSITION][rows] * position
                    + motions[rows] * since_s[rows, None]
                )
                made.log_scales[block] = columns[records.SIZE][rows] * size
                three = np.clip(columns[records.ROTATION][rows] * rotation, -1, 1)
                largest = columns[records.LARGEST][rows, 0]
                if len(largest) and not 0 <= largest.min() <= largest.max() <= 3:
                    raise CorruptError(".4dgs: a rotation without a component of 4")
                made.quats[block] = restore_largest(three, largest)[:, XYZW_TO_WXYZ]
                green, red, blue = columns[records.COLOUR][rows].astype(np.int64).T
                levels = np.stack([red + green, green, blue + green], axis=1) * colour
                made.sh[block, 0] = (np.clip(levels, 0, 1) - 0.5) / SH_C0
                # 0 and 1 have no finite logit: a quarter of a step inwards.
                opaque = columns[records.OPACITY][rows, 0] * opacity
                inside = np.clip(opaque * fading[rows], opacity / 4, 1 - opacity / 4)
                made.logit_opacities[block] = np.log(inside / (1 - inside))
            for band in range(1, self.sh_degree + 1):
                codes = columns[FIRST_BAND + band][rows].reshape(len(rows), 3, 2 * band + 1)
                first = sh_count(band - 1)
                made.sh[block, first : sh_count(band)] = codes.swapaxes(1, 2) * (8 / 255) - 4
        return made.checked(".4dgs")


class FourdgsReader:
    """Frames of the .4dgs file at `path`; cheapest in rising order."""

    def __init__(self, path: Path) -> None:
        """Raises CorruptError, or UnsupportedError."""
        self._path = path
        contents = read_contents(path)
        self._states = contents.states
        frame_s = min(state.t1_s - state.t0_s for state in self._states)
        counts = [(state.t1_s - state.t0_s) / frame_s for state in self._states]
        check_frames(".4dgs", sum(counts), path.stat().st_size)
        if any(abs(count - round(count)) > SPACING_SLACK for count in counts):
            raise UnsupportedError(".4dgs: its states are not a whole number of frames apart")
        self._frames = [
            (number, state.t0_s + frame * frame_s)
            for number, (state, count) in enumerate(zip(self._states, counts, strict=True))
            for frame in range(round(count))
        ]
        self.fps = float(f"{1 / frame_s:.9g}")
        """Frames in a second."""
        self._grid = _Grid(
            np.array(contents.origin),
            contents.steps,
            np.array(contents.windows or [(0.0, 0.0)]),
            contents.cutoff,
            contents.sh_degree,
        )
        self._key: tuple[int, State] | None = None
        self._last: tuple[int, State] | None = None

    @property
    def num_frames(self) -> int:
        return len(self._frames)

    def read(self, frame: int, max_gaussians: int = MAX_GAUSSIANS) -> Splats:
        """The Gaussians that show at `frame`, 0 to num_frames - 1. Raises CorruptError, or
        UnsupportedError, also for more than `max_gaussians`."""
        number, time_s = self._frames[frame]
        return self._grid.splats(self._state(number, max_gaussians), time_s)

    def _state(self, wanted: int, max_gaussians: int) -> State:
        key = wanted
        while self._states[key].reference is not None:
            key -= 1
            if key < 0:
                raise CorruptError(".4dgs: begins with a delta")
        can_go_on = self._last is not None and key <= self._last[0] <= wanted
        if not can_go_on:
            self._last = self._key = None  # let go of them before the next is read
            record, degree = self._states[key], self._grid.sh_degree
            self._key = self._last = key, read_keyframe(self._path, record, degree, max_gaussians)
        assert self._last is not None
        for number in range(self._last[0] + 1, wanted + 1):
            self._last = number, self._next(number, max_gaussians)
        return self._last[1]

    def _next(self, number: int, max_gaussians: int) -> State:
        record = self._states[number]
        for held in (self._last, self._key):
            assert held is not None
            if self._states[held[0]].offset == record.reference:
                degree = self._grid.sh_degree
                return read_delta(self._path, record, held[1], degree, max_gaussians)
        raise CorruptError(
            f".4dgs: the delta at {record.offset} follows neither on the state before nor on its "
            "keyframe"
        )
