"""TSOG, sequences in and out: "TSOG Playback Profile 1", 1.0.1 (OpsiClear-4DGS/ftgs-player,
TSOG-SPEC.md), which is the base encoding 4 of xiaomi-research/tsog and defaults for playing.

A ZIP of meta.json and pictures, as a SOG (codebooks may be shorter than 256), and

    timeline  type 0, discrete: N frames; the red bytes of two pictures, low and high, are
              frame * floor(65536 / N) and a little more: each Gaussian shows in one frame
              type 1, continuous: center (red) and sigma (green), in 16 bits between mins and maxs,
              of a clip from 0 to 1: opacity exp(-((t - center) / sigma)^2 / 2)
    temporal  means: velocity (red, green, blue) a clip, in 8 or 16 bits between mins and maxs; the
              position of the other pictures is that at the center
    playback  duration in seconds, fps

The axes are right, up, back: half a turn about x from ours. Sound in it is not read. What is
written is discrete: each Gaussian of each frame as it is in the stream.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from codec.arrays import Doubles
from codec.errors import CorruptError, InvalidError, UnsupportedError
from codec.files import read_bounded
from codec.similarity import half_turned
from codec.splats import Splats

from .bounds import MAX_GAUSSIANS, check_count, check_frames, check_ratio, whole_rows
from .jsonfields import Fields
from .modelfolder import MAX_FILE_BYTES
from .notes import notes
from .sog import (
    LEVELS,
    META,
    PIXEL_BYTES,
    Bundle,
    Pictures,
    Sheet,
    decode_attributes,
    encode_attributes,
    encode_bundle,
    json_bytes,
    low_and_high,
)

VERSION = 4
PROFILE = {"id": "org.opsiclear.tsog-playback", "version": 1}
DISCRETE, CONTINUOUS = 0, 1
CODES = 1 << 16
DEFAULT_FPS, DEFAULT_FRAMES = 30.0, 300
LEAST_OPACITY = 1 / 255
"""What is fainter is not drawn anywhere."""


class TsogReader:
    """Frames of the .tsog file at `path`, whose Gaussians are all held in memory."""

    def __init__(self, path: Path) -> None:
        """Raises CorruptError, or UnsupportedError."""
        files = Bundle(read_bounded(path, MAX_FILE_BYTES), "TSOG")
        meta = Fields.parse(files.read(META), f"TSOG: {META}")
        _check_versions(meta)
        count = check_count("TSOG", meta.integer("count", most=1 << 53))
        check_ratio("TSOG", count * PIXEL_BYTES, files.num_bytes)
        pictures = Pictures(files, count, "TSOG")
        self._all = decode_attributes(meta, pictures, count, least_book=1)
        self._frame_of: npt.NDArray[np.intp] | None = None
        """(N,) the frame of each Gaussian in a discrete timeline."""
        self._spans: Doubles | None = None
        """(N, 2) center and sigma in a continuous one."""
        self._velocities: Doubles | float = 0.0  # (N, 3) a clip
        kind = None
        if "timeline" in meta:
            timeline = meta.fields("timeline")
            kind = timeline.integer("type", most=1 << 16)
            codes = pictures.shorts(timeline.texts("files", 2))
            if kind == DISCRETE:
                self._frame_of = _frames_of(timeline, codes[:, 0])
            elif kind == CONTINUOUS:
                lower, upper = (np.array(timeline.numbers(key, 2)) for key in ("mins", "maxs"))
                if not lower[1] >= np.finfo(np.float32).tiny or (lower > upper).any():
                    raise CorruptError(f"{timeline.where}: a sigma is not above 0, or mins not low")
                self._spans = _between(lower, upper, codes[:, :2] / LEVELS)
            else:
                raise UnsupportedError(f"{timeline.where}: type {kind}; this program reads 0 and 1")
        if "temporal" in meta:
            if kind is None:
                raise CorruptError("TSOG: moves without a timeline")
            self._velocities = _velocities(meta.fields("temporal"), pictures)
        self.num_frames, fps = _timing(meta, kind)
        check_frames("TSOG", self.num_frames, files.num_bytes)
        self.fps = float(f"{fps:.9g}")
        """Frames in a second."""
        if "audio" in meta:
            name = meta.fields("audio").text("file")
            notes().say(
                f"its sound {name[:80]!r} is left out: unpack it, the file is a ZIP archive, and "
                "use `swings-stream audio add`"
            )

    def read(self, frame: int, max_gaussians: int = MAX_GAUSSIANS) -> Splats:
        """The Gaussians that show at `frame`, 0 to num_frames - 1. Raises CorruptError, or
        UnsupportedError, also for more than `max_gaussians`."""
        made = self._all
        means, logits = made.means, made.logit_opacities
        rows = np.arange(len(means))
        if self._frame_of is not None:
            rows = np.flatnonzero(self._frame_of == frame)
        elif self._spans is not None:
            center, sigma = self._spans.T
            since = frame / (self.num_frames - 1) - center
            with np.errstate(all="ignore"):  # what is not finite is left out below
                opacities = made.opacities * np.exp(-0.5 * (since / sigma) ** 2)
                logits = (np.log(opacities) - np.log1p(-opacities)).astype(np.float32)
                means = (means + self._velocities * since[:, None]).astype(np.float32)
            rows = np.flatnonzero(opacities >= LEAST_OPACITY)
        check_count("TSOG", len(rows), max_gaussians)
        parts = (means, made.log_scales, made.quats, logits, made.sh)
        return half_turned(whole_rows("TSOG", *(part[rows] for part in parts)), "x")


def _check_versions(meta: Fields) -> None:
    version = meta.integer("version", 1, most=1 << 32)
    if version != VERSION:
        raise UnsupportedError(f"TSOG: version {version}; this program reads {VERSION}")
    if "profile" in meta:
        profile = meta.fields("profile")
        found = {"id": profile.text("id"), "version": profile.integer("version", most=1 << 32)}
        if found != PROFILE:
            raise UnsupportedError(
                f"TSOG: profile {found['id']!r:.60} {found['version']}; this program reads "
                f"{PROFILE['id']} {PROFILE['version']}"
            )


def _frames_of(timeline: Fields, codes: npt.NDArray[np.uint16]) -> npt.NDArray[np.intp]:
    num_frames = timeline.integer("N", most=CODES)
    if not num_frames or timeline.integer("delta", most=CODES) != CODES // num_frames:
        raise CorruptError(f"{timeline.where}: delta is not 65536 over N")
    frames: npt.NDArray[np.intp] = np.minimum(codes // (CODES // num_frames), num_frames - 1)
    return frames.astype(np.intp)


def _between(lower: Doubles, upper: Doubles, shares: Doubles) -> Doubles:
    with np.errstate(all="ignore"):  # what is not finite is left out with its Gaussians
        between: Doubles = lower + (upper - lower) * shares
    return between


def _velocities(temporal: Fields, pictures: Pictures) -> Doubles:
    """(N, 3) velocities a clip."""
    strange = [name for name in temporal.values if name != "means"]
    if strange:
        raise UnsupportedError(f"{temporal.where}: moves {strange[0][:40]!r}, which is not read")
    means = temporal.fields("means")
    ends = []
    for key in ("mins", "maxs"):
        rows = means.values.get(key)
        if type(rows) is not list or len(rows) != 1:
            raise UnsupportedError(f"{means.where}.{key}: is not one row; others are not read")
        ends.append(np.array(Fields({key: rows[0]}, means.where).numbers(key, 3)))
    names = means.texts("files")
    if len(names) == 1:
        shares = pictures.rows(names[0])[:, :3] / 255
    elif len(names) == 2:
        shares = pictures.shorts(names)[:, :3] / LEVELS
    else:
        raise CorruptError(f"{means.where}.files: {len(names)} names, not 1 or 2")
    return _between(ends[0], ends[1], shares)


def _timing(meta: Fields, kind: int | None) -> tuple[int, float]:
    """The number of frames, and frames in a second."""
    playback = meta.fields("playback") if "playback" in meta else Fields({}, f"{meta.where}")
    fps = next((part.number("fps") for part in (playback, meta) if "fps" in part), DEFAULT_FPS)
    duration_s = playback.number("duration") if "duration" in playback else None
    if not fps > 0 or (duration_s is not None and not duration_s > 0):
        raise CorruptError(f"{playback.where}: duration and fps are not above 0")
    if kind is None:
        return 1, fps
    if kind == DISCRETE:
        num_frames = meta.fields("timeline").integer("N", most=CODES)
        return num_frames, fps if duration_s is None else num_frames / duration_s
    if duration_s is None:
        return DEFAULT_FRAMES, fps
    if not duration_s * fps < 1 << 53:
        raise CorruptError(f"{playback.where}: {duration_s:g} s at {fps:g} frames a second")
    num_frames = max(2, math.floor(duration_s * fps + 0.5) + 1)
    return num_frames, (num_frames - 1) / duration_s


def encode_tsog(frames: Sequence[Splats], fps: float) -> bytes:
    """The .tsog file of `frames`, which have one SH degree, as a discrete timeline. Raises
    InvalidError for more frames or Gaussians than it can hold, or for none."""
    num_frames, count = len(frames), sum(map(len, frames))
    if not 0 < num_frames <= CODES or not 0 < count <= MAX_GAUSSIANS:
        raise InvalidError(
            f"TSOG: {num_frames} frames with {count} Gaussians together; it has 1 to {CODES} and "
            f"1 to {MAX_GAUSSIANS}: choose some by --frames A:B"
        )
    splats = half_turned(Splats.concatenate(frames), "x")
    attributes, files, order = encode_attributes(splats)
    delta = CODES // num_frames
    numbers = np.repeat(np.arange(num_frames), [len(frame) for frame in frames])[order]
    low, high = low_and_high((numbers * delta + delta // 2)[:, None])
    sheet = Sheet(count)
    for name, codes in (("time_l.webp", low), ("time_u.webp", high)):
        files[name] = sheet.picture(codes, np.zeros((count, 2), np.uint8))
    meta: dict[str, Any] = {"version": VERSION, "profile": PROFILE, "count": count, **attributes}
    meta["timeline"] = {
        **{"type": DISCRETE, "N": num_frames, "delta": delta},
        "files": ["time_l.webp", "time_u.webp"],
    }
    meta["playback"] = {"duration": num_frames / fps, "fps": fps}
    return encode_bundle({META: json_bytes(meta)} | files)
