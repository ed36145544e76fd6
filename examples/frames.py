"""Prints what each frame of a stream holds, from its numpy arrays.

python examples/frames.py demo/stream
"""

import sys

import numpy as np

import codec

with codec.open_stream(sys.argv[1]) as stream:
    print(f"{stream.num_frames} frames at {stream.fps:g} per second, {stream.num_layers} layers")
    for frame, splats in enumerate(stream):
        opaque = splats.opacities > 0.5
        middle = np.median(splats.means[opaque], axis=0) if opaque.any() else np.zeros(3)
        sizes = np.exp(splats.log_scales).max(axis=1)
        print(
            f"frame {frame}: {len(splats)} Gaussians, {opaque.sum()} of them opaque, "
            f"around {middle.round(2)}, median size {np.median(sizes):.3f}"
        )
