"""A stream as one .4dgs file, written by the package of its authors, `fourdgs`."""

from __future__ import annotations

from typing import Any

import numpy as np

from codec.errors import InvalidError
from codec.foreign.levels import unit_quats
from codec.splats import SH_C0, Splats

from .sequences import INSTALL, Precision
from .tracks import Tracks

GROUP_FRAMES = 30
"""Frames from one keyframe to the next."""
ENDLESS_S = 1e9
"""Temporal deviation of Gaussians that do not fade; the package writes no other kind of them."""
MAX_ROWS = 1 << 23
"""Gaussians of all frames together: the package holds them all, about 600 bytes each."""
WXYZ_TO_XYZW = (1, 2, 3, 0)


def encode_fourdgs(tracks: Tracks, precision: Precision) -> bytes:
    """The .4dgs file (model keyframe-delta) of `tracks`, without harmonics.

    A Gaussian keeps its identity from frame to frame as long as it shows. Raises InvalidError
    without the package, or for a sequence that it cannot take; or a CodecError of the stream.
    """
    try:
        from fourdgs import GaussianSet
        from fourdgs.exceptions import FourdgsError
        from fourdgs.keyframe_delta_file import write_sequence
        from fourdgs.keyframe_delta_writer import KeyframeDeltaOptions, Sample
    except ImportError as error:
        raise InvalidError(f"4dgs is written by the package fourdgs: {INSTALL}") from error
    duration_s = tracks.num_frames / tracks.fps
    ids = np.zeros(tracks.num_slots, np.int64)
    next_id, num_rows = 0, 0
    shown: Any = np.zeros(len(ids), np.bool_)
    samples = []
    for number, frame in enumerate(tracks):
        num_rows += len(frame.slots)
        if num_rows > MAX_ROWS:
            raise InvalidError(
                f"4dgs: over {MAX_ROWS} Gaussians in {number + 1} frames, more than fourdgs takes "
                "at once; export fewer --frames"
            )
        fresh = frame.slots[~shown[frame.slots]]
        ids[fresh] = np.arange(next_id, next_id + len(fresh))
        next_id += len(fresh)
        shown[:] = False
        shown[frame.slots] = True
        gaussians = GaussianSet(**_values(frame.splats, duration_s))
        samples.append(Sample(number / tracks.fps, ids[frame.slots].copy(), gaussians))
    try:
        data: bytes = write_sequence(
            samples,
            duration_s,
            kd=KeyframeDeltaOptions(keyframe_every=GROUP_FRAMES),
            profile=str(precision),
            library="swings",
        )
    except (FourdgsError, ValueError) as error:
        raise InvalidError(f"4dgs: fourdgs cannot write this sequence: {error}") from error
    return data


def _values(splats: Splats, duration_s: float) -> dict[str, Any]:
    """The fields of a GaussianSet of `splats`."""
    count = len(splats)
    rgb = np.clip(0.5 + SH_C0 * splats.sh[:, 0].astype(np.float64), 0, 1)
    return {
        "positions": splats.means,
        "scales": np.exp(splats.log_scales.astype(np.float64)),
        "rotations": unit_quats(splats.quats)[:, WXYZ_TO_XYZW],
        "colors": np.concatenate([rgb, splats.opacities[:, None]], axis=1),
        "motions": np.zeros((count, 3), np.float32),
        "mu_t": np.zeros(count, np.float32),
        "sigma_t": np.full(count, ENDLESS_S, np.float32),
        "win_lo": np.zeros(count, np.float32),
        "win_hi": np.full(count, duration_s),
    }
