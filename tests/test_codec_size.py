"""What a Gaussian of profile `compact` takes, with DC colour and with SH degree 1."""

from __future__ import annotations

import numpy as np
import pytest

from codec.chunk import encode_chunk
from codec.layers import opacity_rank, split_layers
from codec.object import encode_frame
from codec.profile import Profile
from codec.quantize import layer_steps
from codec.slice import Slice
from tests.trained_like import trained_like_splats

COUNT = 40_000


@pytest.mark.parametrize("fractions", [(1.0,), (0.35, 0.15, 0.2, 0.3)])
@pytest.mark.parametrize(("sh_degree", "most_bytes"), [(0, 9.0), (1, 11.0)])
def test_a_trained_like_gaussian_fits(
    sh_degree: int, most_bytes: float, fractions: tuple[float, ...]
) -> None:
    whole = Slice(0, trained_like_splats(COUNT, sh_degree=sh_degree), np.zeros(COUNT, np.uint8))
    layers = split_layers(whole, fractions, opacity_rank)
    steps = layer_steps([layer.splats for layer in layers])
    size = sum(
        len(encode_frame(encode_chunk(layer, n, Profile.COMPACT, steps[n])))
        for n, layer in enumerate(layers)
    )
    assert size <= most_bytes * COUNT
