"""When each camera began: by a file, sound or timecode, or else by where things move."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from codec.arrays import Doubles
from trainer.capture.camerachoice import named
from trainer.errors import CaptureError

from .geometry import geometric_lags
from .lags import series_lags
from .signals import SOUND_RATE, movement_px, onsets, timecode_s
from .solution import Rig
from .takes import NOMINAL_FPS, Take

MOST_S = 60.0
"""How much of each take is compared: bounds the time that takes."""

SOUND_GUARD_S, MOVEMENT_GUARD_S = 0.02, 0.1
"""Lags so near to each other are the same."""

SOUND_SCORE, MOVEMENT_SCORE, SHARPER = 0.25, 0.08, 1.25
"""Least scores of lags, and least ratio to scores at other lags."""

DRIFT_S = 0.02
"""What a clock runs off over the take before it is reported."""


@dataclass(frozen=True, slots=True)
class Synchrony:
    """The common time of all takes."""

    starts_s: tuple[float, ...]
    """The time in each take at which the common time begins."""
    duration_s: float
    num_frames: int
    """Frames of the common time."""
    fps: float | None
    """Frames per second of the capture; None where no file gives it."""
    how: str
    """What the offsets are from."""
    notes: tuple[str, ...] = ()
    """What to know about them, a line each."""
    moving_px: tuple[Doubles, ...] = ()
    """Where something moves in each take, if only that tells the offsets. It takes a rig to see
    how: until then the takes are compared as they begin, which still shows what stands still."""


def synchronise(
    takes: Sequence[Take], offsets: Path | None, advance: Callable[[float], None]
) -> Synchrony:
    """By a file of offsets, else by sound or timecode, the first that all takes have; else see
    `confirmed`. Raises CaptureError where the takes have no time in common."""
    if offsets is not None:
        return _common_time(takes, _read_offsets(offsets, takes), f"as {offsets.name} says")
    notes = []
    if all(take.is_video for take in takes):
        sounds = [onsets(take.files[0], MOST_S) for take in takes]
        heard = [sound for sound in sounds if sound is not None]
        if len(heard) == len(takes):
            found, spread, drift = series_lags(heard, round(SOUND_GUARD_S * SOUND_RATE))
            clear = (found.score >= SOUND_SCORE) & (found.score >= SHARPER * found.rest)
            if clear.all():
                notes = _quality(takes, spread / SOUND_RATE, drift)
                return _common_time(takes, found.lags / SOUND_RATE, "by sound", notes)
            odd = [take.name for take, is_clear in zip(takes, clear, strict=True) if not is_clear]
            notes.append(f"not by sound: that of {named(odd)} is unlike that of the others")
        codes = [timecode_s(take.files[0], take.fps or NOMINAL_FPS) for take in takes]
        told = [-code for code in codes if code is not None]
        if len(told) == len(takes):
            return _common_time(takes, told, "by timecode, to a frame", notes)
    rate = _usual_fps(takes) or NOMINAL_FPS
    moving = []
    for take in takes:
        moving.append(movement_px(take, rate, MOST_S))
        advance(len(moving) / len(takes))
    guess = _common_time(takes, [0.0] * len(takes), "as the takes begin", notes)
    return replace(guess, moving_px=tuple(moving))


def confirmed(takes: Sequence[Take], guess: Synchrony, rig: Rig, right: Sequence[int]) -> Synchrony:
    """The synchrony of the takes that are right, if need be by where in them something moves.
    Raises CaptureError for takes of which nothing tells when they began."""
    chosen = [takes[i] for i in right]
    if not guess.moving_px:
        return _common_time(chosen, [guess.starts_s[i] for i in right], guess.how, guess.notes)
    rate = _usual_fps(takes) or NOMINAL_FPS
    found = geometric_lags(rig, guess.moving_px, round(MOVEMENT_GUARD_S * rate))
    lags, score, rest = (each[list(right)] for each in (found.lags, found.score, found.rest))
    clear = (score >= MOVEMENT_SCORE) & (score >= SHARPER * rest)
    names, notes = [take.name for take in chosen], list(guess.notes)
    unknown = [name for name, is_clear in zip(names, clear, strict=True) if not is_clear]
    equal = np.ptp([take.times_s[-1] for take in chosen]) < 1.5 / rate
    if not unknown:
        whole = np.rint(lags - np.median(lags))
        late = [f"{name} by {n:+.0f} frames" for name, n in zip(names, whole, strict=True) if n]
        if equal and late:
            notes.append(f"out of step as filmed, and corrected: {named(late)}")
        return _common_time(chosen, whole / rate, "by where things move, to a frame", notes)
    if equal:
        notes.append(
            f"nothing tells when {named(unknown)} began; as all takes are equally long, they are "
            "taken to begin at once. Give --offsets if they do not"
        )
        return _common_time(chosen, [0.0] * len(chosen), guess.how, notes)
    raise CaptureError(
        f"nothing tells when {named(unknown)} began: no sound or timecode that all have, and too "
        "little that moves where others see it; clap once where all cameras hear it, give "
        "--offsets, or leave the camera out (--without-cameras)"
    )


def _common_time(
    takes: Sequence[Take], starts_s: Sequence[float] | Doubles, how: str, notes: Sequence[str] = ()
) -> Synchrony:
    """The time that all takes have in common, of the time in each at one moment. Raises
    CaptureError."""
    starts = np.array(starts_s) - min(starts_s)
    duration_s = min(t.times_s[-1] - start for t, start in zip(takes, starts, strict=True))
    if duration_s <= 0:
        raise CaptureError(
            f"the takes have no time in common: {how}, they begin up to {starts.max():.2f} s apart"
        )
    fps = _usual_fps(takes)
    num_frames = int(duration_s * (fps or NOMINAL_FPS) + 0.5) + 1
    return Synchrony(tuple(starts), float(duration_s), num_frames, fps, how, tuple(notes))


def _usual_fps(takes: Sequence[Take]) -> float | None:
    rates = Counter(round(take.fps, 3) for take in takes if take.fps is not None)
    return rates.most_common(1)[0][0] if rates else None


def _quality(takes: Sequence[Take], spread_s: Doubles, drift: Doubles) -> list[str]:
    """What lags by sound are worth."""
    if np.isnan(spread_s).any():
        return ["the common time is too short to tell how exact the offsets are"]
    notes = [
        f"offsets vary by {1000 * np.median(spread_s):.1f} ms over the take "
        f"({1000 * spread_s.max():.1f} at most); sound takes 2.9 ms a metre"
    ]
    shortest_s = min(take.times_s[-1] for take in takes)
    return notes + [
        f"the clock of {take.name} runs {'fast' if each > 0 else 'slow'} by "
        f"{60000 * abs(each):.0f} ms a minute"
        for take, each, spread in zip(takes, drift, spread_s, strict=True)
        if abs(each) * shortest_s > max(DRIFT_S, 4 * spread)
    ]


def _read_offsets(path: Path, takes: Sequence[Take]) -> list[float]:
    """The offsets of the takes in a file of lines with a name and seconds. Raises CaptureError."""
    found: dict[str, float] = {}
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        name, _, text = line.strip().rpartition(" ")
        try:
            if line.strip():
                found[name.strip()] = float(text)
        except ValueError:
            raise CaptureError(f"{path}: line {number} is not a camera and seconds") from None
    missing = [take.name for take in takes if not np.isfinite(found.get(take.name, np.nan))]
    if missing:
        raise CaptureError(f"{path}: lacks the offset of {named(missing)}")
    return [found[take.name] for take in takes]
