"""A profile is one object: the same verbs for each, and what an encoder says of its own bytes."""

from __future__ import annotations

import numpy as np
import pytest

from codec.profiles.profile import CHUNK_PROFILES, PROFILE_OF_CODE, Profile
from codec.stream.chunk import encode_chunk, encoded_elsewhere, read_header
from codec.stream.object import encode_packet
from tests.support.drawn import same
from tests.support.trained_like import trained_like_slice, trained_like_splats


def test_the_numbers_of_the_format() -> None:
    assert PROFILE_OF_CODE == {0: Profile.RAW, 1: Profile.PAPER, 2: Profile.COMPACT}
    for code, profile in PROFILE_OF_CODE.items():
        data = encode_chunk(trained_like_slice(0, 2), 0, profile).data
        assert (data[6], read_header(data).profile) == (code, profile)


@pytest.mark.parametrize("profile", CHUNK_PROFILES)
@pytest.mark.parametrize("count", [0, 1, 300])
@pytest.mark.parametrize("sh_degree", [0, 2])
def test_a_body_is_what_its_coding_says_of_it(profile: Profile, count: int, sh_degree: int) -> None:
    splats = trained_like_splats(count, sh_degree=sh_degree)
    (steps,) = profile.coding.layer_steps([splats])
    body = profile.coding.encode(splats, steps)
    view = memoryview(body.data)
    assert list(body.edges) == profile.coding.edges(view, count, sh_degree)
    assert list(body.edges) == sorted(body.edges)
    assert not body.edges or (body.edges[0], body.edges[-1]) == (0, len(body.data))
    decoded = profile.coding.decode(view, count, sh_degree)
    if profile is Profile.RAW:
        assert same(decoded, splats)
    if body.order is not None:
        assert sorted(body.order.tolist()) == list(range(count))
        splats = splats.take(body.order)
    assert np.allclose(decoded.means, splats.means, atol=0.05)


@pytest.mark.parametrize("profile", CHUNK_PROFILES)
def test_a_chunk_made_elsewhere_is_compressed_to_the_same_bytes(profile: Profile) -> None:
    for count in (0, 9, 500):
        ours = encode_chunk(trained_like_slice(-3, count, sh_degree=1), 2, profile)
        theirs = encoded_elsewhere(ours.data)
        assert (theirs.birth, theirs.data, list(theirs.edges)) == (-3, ours.data, list(ours.edges))
        assert encode_packet(theirs) == encode_packet(ours)
