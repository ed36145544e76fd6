"""Rotation and scales of a Gaussian, brought to the one of 24 equal forms that costs least to code.

A Gaussian stays the same when its axes are permuted together with its scales (6 ways) or turned
by 180 degrees (4 ways). The canonical form has falling scales and the largest quaternion component
in w: no permutation, no index of the largest component, 4.6 bits less a Gaussian.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Doubles = npt.NDArray[np.float64]

_H = 0.5
_R = 0.5**0.5

# Quaternion (wxyz) of the rotation whose columns are the unit vectors e_a, e_b, +-e_c; at 3 a + b.
_PERMUTATIONS = np.zeros((9, 4))
_PERMUTATIONS[[1, 5, 6, 3, 2, 7]] = (
    (1, 0, 0, 0),  # 0 1 2
    (_H, _H, _H, _H),  # 1 2 0
    (_H, -_H, -_H, -_H),  # 2 0 1
    (0, _R, _R, 0),  # 1 0 2
    (_R, _R, 0, 0),  # 0 2 1
    (_R, 0, -_R, 0),  # 2 1 0
)


def multiply(a: Doubles, b: Doubles) -> Doubles:
    """(N, 4) quaternion products a b, wxyz."""
    aw, ax, ay, az = a.T
    bw, bx, by, bz = b.T
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=1,
    )


def canonical(
    log_scales: npt.NDArray[np.float32], quats: npt.NDArray[np.float32]
) -> tuple[Doubles, Doubles]:
    """The same Gaussians with (N, 3) falling log-scales and (N, 4) unit quaternions, w largest."""
    # Over the largest component first, because the square of a tiny or a huge one is 0 or infinite.
    unit = quats.astype(np.float64)
    unit /= np.abs(unit).max(axis=1, keepdims=True)
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    order = np.argsort(-log_scales, axis=1, kind="stable")
    turned = multiply(unit, _PERMUTATIONS[3 * order[:, 0] + order[:, 1]])
    w, x, y, z = turned.T
    # turned times 1, i, j, k: half turns about the three axes, one of which moves the largest to w.
    forms = np.stack([w, x, y, z, -x, w, z, -y, -y, -z, w, x, -z, y, -x, w], axis=1)
    rows = np.arange(len(forms))
    best = np.argmax(np.abs(turned), axis=1)
    chosen = forms.reshape(-1, 4, 4)[rows, best]
    chosen = np.where(chosen[:, :1] < 0, -chosen, chosen)
    return np.take_along_axis(log_scales.astype(np.float64), order, axis=1), chosen
