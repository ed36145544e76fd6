"""What a Gaussian of profile `compact` takes, with DC colour and with SH degree 1."""

from __future__ import annotations

import numpy as np
import pytest

from codec.profiles.profile import Profile
from codec.profiles.quantise import layer_steps
from codec.slice import Slice
from codec.stream.chunk import encode_chunk
from codec.stream.layers import opacity_rank, split_layers
from codec.stream.object import encode_packet
from tests.support.trained_like import trained_like_splats

COUNT = 40_000


@pytest.mark.parametrize("shares", [(1.0,), (0.35, 0.15, 0.2, 0.3)])
@pytest.mark.parametrize(("sh_degree", "most_bytes"), [(0, 9.0), (1, 11.0)])
def test_a_trained_like_gaussian_fits(
    sh_degree: int, most_bytes: float, shares: tuple[float, ...]
) -> None:
    whole = Slice(0, trained_like_splats(COUNT, sh_degree=sh_degree), np.zeros(COUNT, np.uint8))
    layers = split_layers(whole, shares, opacity_rank)
    steps = layer_steps([layer.splats for layer in layers])
    size = sum(
        len(encode_packet(encode_chunk(layer, n, Profile.COMPACT, steps[n])))
        for n, layer in enumerate(layers)
    )
    assert size <= most_bytes * COUNT
