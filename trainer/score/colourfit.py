"""A picture in the colours of the camera that it is compared with.

The cameras of a rig differ in exposure and white balance, and those of a camera that training never
saw are not known: a stream in the rig's mean colours loses decibels there that no viewer misses. So
a picture is also scored with a gain and a bias for each channel, fitted to what the camera saw."""

from __future__ import annotations

import numpy as np

from codec.arrays import Floats
from trainer.capture.capture import Mask

LEAST_VARIANCE = 1e-8
"""Smallest variance of a channel that has a gain; with less, only a bias can be fitted."""


def colour_fitted(shown: Floats, truth: Floats, mask: Mask | None = None) -> Floats:
    """`shown`, (H, W, 3) in 0..1, with each channel's gain and bias of least squares to `truth`
    over the pixels that count; not clipped. Unchanged where none counts."""
    counts = np.ones(shown.shape[:2], bool) if mask is None else mask > 0
    if not counts.any():
        return shown
    seen, wanted = shown[counts].astype(np.float64), truth[counts].astype(np.float64)
    seen_mean, wanted_mean = seen.mean(axis=0), wanted.mean(axis=0)
    variance = ((seen - seen_mean) ** 2).mean(axis=0)
    covariance = ((seen - seen_mean) * (wanted - wanted_mean)).mean(axis=0)
    gain = np.where(variance > LEAST_VARIANCE, covariance / np.maximum(variance, LEAST_VARIANCE), 1)
    fitted: Floats = (gain * (shown - seen_mean) + wanted_mean).astype(np.float32)
    return fitted
