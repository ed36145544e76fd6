"""When each camera began: by a file, by sound, timecode or a flash, or else by what moves.

The lags of all takes are those at which each two of them are most alike. Where something moves is
compared by geometry: at the right lags, it lies on the epipolar lines of what moves in the other
pictures. Steps of a walk repeat themselves; places do not.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import av
import numpy as np
from PIL import Image
from scipy.fft import irfft, next_fast_len, rfft
from scipy.ndimage import uniform_filter
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

from codec.arrays import Doubles, Flags, Longs
from codec.errors import SwingsError
from codec.stream.sound import SAMPLE_RATE
from codec.tracks.soundfile import read_samples
from trainer.capture.capture import named
from trainer.errors import CaptureError

from .solution import Rig, centres
from .takes import NOMINAL_FPS, Take

Curve = tuple[Longs, Doubles]
"""Shifts, and how alike two takes are if the second lags by so much."""

LEAST_OVERLAP = 0.3
"""Share of the shorter series that two must have in common."""

ROUNDS = 5
"""How often takes are compared with all others at their lags: that is better than any one."""

WINDOWS = 6
"""Parts of the common time whose lags are found on their own, for spread and drift."""


@dataclass(frozen=True, slots=True, eq=False)
class Lags:
    """Of each take, in samples; NaN for those that are compared with no other."""

    lags: Doubles  # (C,) the sample of each that shows a moment of all
    score: Doubles  # (C,) how alike it is to the others, in the mean
    rest: Doubles  # (C,) the largest score at other lags


def lags_of(curves: Mapping[tuple[int, int], Curve], count: int, guard: int) -> Lags:
    """The lags of `count` takes; guard: lags so near to the best one are the same peak."""
    cost = np.zeros((count, count))
    for (i, j), (shifts, alike) in curves.items():
        best = int(np.argmax(alike))
        far = alike[np.abs(shifts - shifts[best]) > guard]
        cost[i, j] = 3.0 - min(alike[best] - far.max(initial=-1.0), 2.0)
    lags, score, rest = (np.full(count, np.nan) for _ in range(3))
    if not curves:
        return Lags(lags, score, rest)
    # First along the pairs that are clearest.
    tree = minimum_spanning_tree(cost)
    order, before = breadth_first_order(tree, min(min(curves)), directed=False)
    both = {(j, i): (-shifts[::-1], alike[::-1]) for (i, j), (shifts, alike) in curves.items()}
    both |= curves
    whole = {int(order[0]): 0}
    for i in map(int, order[1:]):
        shifts, alike = both[int(before[i]), i]
        whole[i] = whole[int(before[i])] + int(shifts[np.argmax(alike)])
    groups = [*_branches(order, before), *({i} for i in whole)]
    for _ in range(ROUNDS):
        start = dict(whole)
        for group in groups:
            shifts, total = _joined(both, group, whole)
            shift = int(shifts[np.argmax(total)])
            whole |= {i: whole[i] + shift for i in group}
        if whole == start:
            break
    for i in whole:
        shifts, total = _joined(both, {i}, whole)
        best = int(np.argmax(total))
        lags[i], score[i] = whole[i] + shifts[best] + _peak(total, best), total[best]
        rest[i] = total[np.abs(shifts - shifts[best]) > guard].max(initial=0.0)
    return Lags(lags, score, rest)


def _branches(order: Longs, before: Longs) -> list[set[int]]:
    """Takes of a tree with those beyond them, if any, but for the root: some that agree on a wrong
    lag cannot leave it one by one."""
    beyond = {int(i): {int(i)} for i in order}
    for i in map(int, order[:0:-1]):
        beyond[int(before[i])] |= beyond[i]
    return [beyond[int(i)] for i in order[1:] if len(beyond[int(i)]) > 1]


def _joined(
    curves: Mapping[tuple[int, int], Curve], group: set[int], lags: Mapping[int, int]
) -> Curve:
    """How alike the takes of a group are to all others, by how much more the group lags."""
    parts = [
        (shifts + lags[i] - lags[j], alike)
        for (i, j), (shifts, alike) in curves.items()
        if j in group and i in lags and i not in group
    ]
    first, last = min(s[0] for s, _ in parts), max(s[-1] for s, _ in parts)
    total = np.zeros(last - first + 1)
    for shifts, alike in parts:
        total[shifts - first] += alike / len(parts)  # no shift is there twice
    return np.arange(first, last + 1), total


def _peak(alike: Doubles, best: int) -> float:
    """Where between samples the peak of a parabola through three of them is."""
    if not 0 < best < len(alike) - 1:
        return 0.0
    left, middle, right = alike[best - 1 : best + 2]
    bend = left - 2 * middle + right
    return float(np.clip((left - right) / (2 * bend), -0.5, 0.5)) if bend < 0 else 0.0


def series_lags(series: Sequence[Doubles], guard: int) -> tuple[Lags, Doubles, Doubles]:
    """The lags of series (T,), each of its own length; their spread, in samples, and drift, in
    samples a sample, over parts of the common time: (C,), NaN if that is too short."""
    count = len(series)
    pairs = [(i, j) for i in range(count) for j in range(i + 1, count)]
    whole = lags_of({(i, j): correlate(series[i], series[j]) for i, j in pairs}, count, guard)
    starts = np.rint(whole.lags).astype(int)
    first = int((-starts).max())
    last = min(len(each) - start for each, start in zip(series, starts, strict=True))
    edges = np.linspace(first, last, WINDOWS + 1).astype(int)
    if edges[1] - edges[0] < 8 * guard:
        return whole, np.full(count, np.nan), np.full(count, np.nan)
    found = []
    for a, b in pairwise(edges):
        parts = [each[a + start : b + start] for each, start in zip(series, starts, strict=True)]
        curves = {}
        for i, j in pairs:
            shifts, alike = correlate(parts[i], parts[j])
            near = np.abs(shifts) <= guard
            curves[i, j] = shifts[near], alike[near]
        lags = lags_of(curves, count, guard).lags
        found.append(lags - np.median(lags))
    slopes = np.polyfit((edges[:-1] + edges[1:]) / 2, np.array(found), 1)[0]
    return whole, np.std(found, axis=0), slopes


def correlate(one: Doubles, other: Doubles) -> Curve:
    """Correlations of other[t + shift] with one[t], where they overlap enough. By chance, what
    overlaps little is often alike: the less they do, the less it counts."""
    one, other = (each - each.mean() for each in (one, other))
    size = next_fast_len(len(one) + len(other), real=True)

    def against(a: Doubles, b: Doubles) -> Doubles:
        sums = irfft(np.conj(rfft(a, size)) * rfft(b, size), size)
        return np.concatenate([sums[size - len(one) + 1 :], sums[: len(other)]])

    overlap = against(np.ones(len(one)), np.ones(len(other)))
    share = np.minimum(overlap / min(len(one), len(other)), 1)
    enough = share >= LEAST_OVERLAP
    # Each part that overlaps is judged by its own size: a loud end must not win by itself.
    energies = against(one**2, np.ones(len(other))) * against(np.ones(len(one)), other**2)
    alike = against(one, other)[enough] / np.sqrt(np.maximum(energies[enough], 1e-12))
    shifts = np.arange(1 - len(one), len(other))[enough]
    return shifts, alike * np.sqrt(share[enough])


SOUND_RATE = 1000
"""Loudnesses a second: a millisecond, in which sound travels 34 cm."""

QUIET = 20.0
"""Root mean square, of 32768, below which a take has no sound to speak of."""

SMALL_PX, REACH, MOVING = 192, 14, 3.0
"""Side of the small pictures in which movement is looked for, samples of them around its middle
that belong to it, and their mean change, of 255, from which on something moves there."""

FLASH, BRIGHTER, FLASH_S = 6.0, 4.0, 0.5
"""Least rise of a picture's mean, of 255, from one frame to the next that is a flash, or a lamp
that is switched on; how many times as large it is as rises at other times; and how long the rises
of one flash may take."""

_TIMECODE = re.compile(r"(\d\d):(\d\d):(\d\d)[:;.](\d\d)")


def onsets(file: Path, most_s: float) -> Doubles | None:
    """(T,) how the loudness of a take rises, SOUND_RATE times a second from its first picture on;
    None for one without sound. Onsets are alike at all microphones, where the wave itself is not.
    """
    blocks: list[Doubles] = []
    count, step = 0, SAMPLE_RATE // SOUND_RATE
    try:
        for piece in read_samples(file, 1):
            blocks.append(piece[:, 0].astype(np.float64))
            count += len(piece)
            if count > most_s * SAMPLE_RATE:
                break
    except (SwingsError, av.FFmpegError):
        return None
    if count < SAMPLE_RATE:
        return None
    whole = np.concatenate(blocks)[: count // step * step].reshape(-1, step)
    power = ((whole - whole.mean()) ** 2).mean(axis=1)
    if np.sqrt(power.mean()) < QUIET:
        return None
    smooth = np.convolve(power, np.hanning(7) / np.hanning(7).sum(), "same")
    rise: Doubles = np.diff(np.log(smooth + 0.01 * smooth.mean() + 1.0))
    return np.maximum(rise, 0)


def timecode_s(file: Path, fps: float) -> float | None:
    """The time of day, seconds, at which a video says that it begins; None if it does not."""
    try:
        with av.open(f"file:{file}", options={"protocol_whitelist": "file"}) as container:
            told = [container.metadata, *(stream.metadata for stream in container.streams)]
    except av.FFmpegError:
        return None
    for text in (metadata.get("timecode", "") for metadata in told):
        found = _TIMECODE.fullmatch(text.strip())
        if found:
            hours, minutes, seconds, frames = map(int, found.groups())
            return 3600 * hours + 60 * minutes + seconds + frames / round(fps)
    return None


def movement(take: Take, rate: float, most_s: float) -> tuple[Doubles, Doubles]:
    """(T, 2) where most moves in a take, `rate` times a second, pixels; NaN where nothing does; and
    (T,) the mean of its picture, of 255."""
    count = int(min(most_s, take.times_s[-1]) * rate) + 1
    found, means = np.full((count, 2), np.nan), np.zeros(count)
    before, last = None, -1
    with closing(take.open()) as source:
        for sample in range(count):
            frame = take.nearest_frame(sample / rate)
            if frame == last:  # a video of a lower rate shows some twice
                means[sample] = means[sample - 1]
                continue
            last, image = frame, Image.fromarray(source.read(frame)).convert("L")
            grey = np.asarray(image.resize((SMALL_PX, SMALL_PX), Image.Resampling.BOX), np.float64)
            means[sample] = grey.mean()
            if before is not None:
                found[sample] = _place_of(np.abs(grey - before))
            before = grey
    return found / SMALL_PX * (take.width_px, take.height_px), means


def flash_s(means: Doubles, rate: float) -> float | None:
    """The time, seconds, at which a light goes on in pictures of such means (T,), `rate` a second;
    None unless there is one such moment."""
    rises = np.diff(means, prepend=means[:1])
    first = int(np.argmax(rises))
    away = np.abs(np.arange(len(rises)) - first) > FLASH_S * rate
    if rises[first] < max(FLASH, BRIGHTER * rises[away].max(initial=0.0)):
        return None
    return first / rate


def _place_of(difference: Doubles) -> Doubles:
    """(2,) x and y of the middle of what changes most, in samples of the difference."""
    smooth = uniform_filter(difference, REACH, mode="constant")
    peak = int(np.argmax(smooth))
    if smooth.flat[peak] < MOVING:
        return np.full(2, np.nan)
    row, column = divmod(peak, difference.shape[1])
    top, left = max(0, row - REACH), max(0, column - REACH)
    weights = difference[top : row + REACH + 1, left : column + REACH + 1] ** 2
    y, x = np.indices(weights.shape) + 0.5
    middle = np.array([(x * weights).sum(), (y * weights).sum()]) / weights.sum()
    place: Doubles = middle + np.array([left, top])
    return place


PARTNERS, LEAST_ANGLE_DEG, MOST_ANGLE_DEG = 6, 12.0, 110.0
"""Number of cameras that each is compared with, and angles between their views."""

FAR_RAD = np.radians(6)
"""Distances from an epipolar plane count up to this one: farther is something else that moves."""

LEAST_SHARE, LEAST_SAMPLES = 0.25, 20
"""Overlap of two takes that must show movement."""


def geometric_lags(rig: Rig, places_px: Sequence[Doubles], guard: int) -> Lags:
    """The lags of the takes of a rig. places_px: (T, 2) where something moves in each sample, NaN
    where nothing does; guard: as in `lags_of`."""
    rays = [rig.rays(camera, places) for camera, places in enumerate(places_px)]
    known = [i for i, r in enumerate(rays) if np.isfinite(r[:, 0]).sum() >= LEAST_SAMPLES]
    pairs = set()
    for i in known:
        cosines = rig.poses[:, 2, :3] @ rig.poses[i, 2, :3]
        angles = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
        fit = [j for j in known if LEAST_ANGLE_DEG <= angles[j] <= MOST_ANGLE_DEG]
        nearest = sorted(fit, key=lambda j: abs(angles[j] - 45))[:PARTNERS]
        pairs |= {(min(i, j), max(i, j)) for j in nearest}
    places = centres(rig.poses)
    curves = {(i, j): _curve(places[j] - places[i], rays[i], rays[j]) for i, j in sorted(pairs)}
    found = {pair: curve for pair, curve in curves.items() if curve is not None}
    return lags_of(found, len(rays), guard)


def _curve(base: Doubles, one: Doubles, other: Doubles) -> Curve | None:
    """How much nearer than usual what moves in the other camera lies to the epipolar planes of what
    moves in one, by lag; None if too little moves. base: from one to the other."""
    normals = np.cross(base, one)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    away = np.minimum(np.abs(np.arcsin(np.clip(normals @ other.T, -1, 1))), FAR_RAD)
    shifts = np.arange(1 - len(one), len(other))
    found = [np.diagonal(away, int(shift)) for shift in shifts]
    counts = np.array([np.isfinite(each).sum() for each in found])
    enough = (counts >= LEAST_SAMPLES) & (counts >= LEAST_SHARE * counts.max())
    if enough.sum() < 3:
        return None
    costs = np.array([np.nanmean(found[n]) for n in np.flatnonzero(enough)])
    nearer = (np.median(costs) - costs) / FAR_RAD
    return shifts[enough], nearer * np.sqrt(counts[enough] / counts.max())


MOST_S = 60.0
"""How much of each take is compared: bounds the time that takes."""

SOUND_GUARD_S, MOVEMENT_GUARD_S = 0.02, 0.1
"""Lags so near to each other are the same."""

SOUND_SCORE, MOVEMENT_SCORE = 0.25, 0.08
SOUND_SHARPER, MOVEMENT_SHARPER = 1.25, 1.15
"""Least scores of lags, and least ratio to scores at other lags. By movement, with a rig that is
right, the one wrong lag of 52 takes has a ratio of 1.09, the right ones have 1.16 and more."""

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
    how: until then the takes are compared as they begin."""


def synchronise(
    takes: Sequence[Take], offsets: Path | None, advance: Callable[[float], None]
) -> Synchrony:
    """By a file of offsets, else by sound, timecode or a flash, the first that all takes have; else
    see `confirmed`. Raises CaptureError where the takes have no time in common."""
    if offsets is not None:
        return _common_time(takes, _read_offsets(offsets, takes), f"as {offsets.name} says")
    notes = []
    if all(take.is_video for take in takes):
        sounds = [onsets(take.files[0], MOST_S) for take in takes]
        heard = [sound for sound in sounds if sound is not None]
        if len(heard) == len(takes):
            found, spread, drift = series_lags(heard, round(SOUND_GUARD_S * SOUND_RATE))
            clear = (found.score >= SOUND_SCORE) & (found.score >= SOUND_SHARPER * found.rest)
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
    moving, flashes = [], []
    for take in takes:
        places_px, means = movement(take, rate, MOST_S)
        moving.append(places_px)
        flashes.append(flash_s(means, rate))
        advance(len(moving) / len(takes))
    seen = [flash for flash in flashes if flash is not None]
    if len(seen) == len(takes):
        return _common_time(takes, seen, "by a flash, to a frame", notes)
    guess = _common_time(takes, [0.0] * len(takes), "as the takes begin", notes)
    return replace(guess, moving_px=tuple(moving))


def equally_long(takes: Sequence[Take]) -> bool:
    """Whether the takes may have begun at once."""
    rate = _usual_fps(takes) or NOMINAL_FPS
    return bool(np.ptp([take.times_s[-1] for take in takes]) < 1.5 / rate)


def stepped(takes: Sequence[Take], guess: Synchrony, rig: Rig) -> Synchrony:
    """The synchrony by where in the takes something moves, as far as a first rig tells; to be
    `confirmed` with a better one. Takes of which nothing tells when they began are in the middle of
    the others."""
    rate = _usual_fps(takes) or NOMINAL_FPS
    lags, clear = _movement_lags(rig, guess.moving_px, rate)
    if clear.sum() < 2:
        return guess
    starts_s = whole_frames(np.where(clear, lags, np.median(lags[clear]))) / rate
    found = _common_time(takes, starts_s, "by where things move", guess.notes)
    return replace(found, moving_px=guess.moving_px)


def _movement_lags(
    rig: Rig, moving_px: Sequence[Doubles], rate: float, told: Doubles | None = None
) -> tuple[Doubles, Flags]:
    """(C,) the lags of takes, in samples, and which of them are clear: no others are as good, or
    they are what was `told` before (C,)."""
    found = geometric_lags(rig, moving_px, round(MOVEMENT_GUARD_S * rate))
    clear = found.score >= MOVEMENT_SHARPER * found.rest
    if told is not None and np.isfinite(found.lags).any():
        away = found.lags - told
        clear |= np.abs(away - np.nanmedian(away)) <= 1
    return found.lags, clear & (found.score >= MOVEMENT_SCORE)


def whole_frames(lags: Doubles) -> Doubles:
    """Lags to the frame, over the middle one. What they are counted from has an error of its own,
    which all of them have: they must not be rounded before it is taken away."""
    moved = lags - np.linspace(0, 1, 100, endpoint=False)[:, None]
    best = moved[np.argmin(np.abs(moved - np.rint(moved)).sum(axis=1))]
    whole: Doubles = np.rint(best) - np.rint(np.sort(best)[len(best) // 2])
    return whole


def confirmed(
    takes: Sequence[Take], guess: Synchrony, rig: Rig, right: Sequence[int]
) -> tuple[Synchrony, dict[int, str]]:
    """The synchrony of the takes that are right, if need be by where in them something moves; and
    of each of which nothing tells when it began, reason and remedy: these are not in it."""
    if not guess.moving_px:
        chosen = [takes[i] for i in right]
        starts_s = [guess.starts_s[i] for i in right]
        return _common_time(chosen, starts_s, guess.how, guess.notes), {}
    rate = _usual_fps(takes) or NOMINAL_FPS
    lags, clear = _movement_lags(rig, guess.moving_px, rate, rate * np.array(guess.starts_s))
    known = [i for i in right if clear[i]]
    notes = list(guess.notes)
    equal = equally_long([takes[i] for i in right])
    if equal and len(known) < len(right):
        unknown = named([takes[i].name for i in right if not clear[i]])
        notes.append(
            f"nothing tells when {unknown} began; as all takes are equally long, they are "
            "taken to begin at once. Give --offsets if they do not"
        )
        return _common_time([takes[i] for i in right], [0.0] * len(right), guess.how, notes), {}
    lost = {
        i: "began at a time that nothing tells: no sound, timecode or flash that all have, and "
        "too little that moves where others see it; clap once where all cameras hear it, or give "
        "--offsets"
        for i in right
        if not clear[i]
    }
    if len(known) < 2:
        return guess, lost
    whole = whole_frames(lags[known])
    names = [takes[i].name for i in known]
    late = [f"{name} by {n:+.0f} frames" for name, n in zip(names, whole, strict=True) if n]
    if equal and late:
        notes.append(f"out of step as filmed, and corrected: {named(late)}")
    how = "by where things move, to a frame"
    return _common_time([takes[i] for i in known], whole / rate, how, notes), lost


def _common_time(
    takes: Sequence[Take], starts_s: Sequence[float] | Doubles, how: str, notes: Sequence[str] = ()
) -> Synchrony:
    """The time that all takes have in common, of the time in each at one moment. Raises
    CaptureError."""
    starts = np.array(starts_s) - min(starts_s)
    duration_s = min(t.times_s[-1] - start for t, start in zip(takes, starts, strict=True))
    if duration_s < 0:
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
