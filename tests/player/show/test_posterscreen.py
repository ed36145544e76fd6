"""The file of the poster never causes a failure; test_window.py shows one."""

from __future__ import annotations

import io

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from player.show.window import MAX_SIDE_PX, read_picture


def poster(mode: str = "RGB", size: tuple[int, int] = (64, 48), kind: str = "PNG") -> bytes:
    file = io.BytesIO()
    Image.new(mode, size, "red" if mode != "L" else 128).save(file, kind)
    return file.getvalue()


def test_pictures_of_the_formats_of_posters_are_read_in_any_mode() -> None:
    for mode in ("RGB", "L", "RGBA", "P"):
        picture = read_picture(poster(mode))
        assert picture is not None
        assert (picture.mode, picture.size) == ("RGBA", (64, 48))
    assert np.asarray(read_picture(poster()))[0, 0].tolist() == [255, 0, 0, 255]
    assert read_picture(poster(kind="JPEG")) is not None
    assert read_picture(poster("L", (MAX_SIDE_PX, 1))) is not None
    for wrong in (poster("L", (MAX_SIDE_PX + 1, 1)), poster(kind="GIF"), None):
        assert read_picture(wrong) is None


@given(st.binary(max_size=100), st.integers(0, 400), st.sampled_from(["PNG", "JPEG", "WEBP"]))
def test_any_bytes_are_a_picture_or_none(junk: bytes, at: int, kind: str) -> None:
    whole = poster(kind=kind)
    read_picture(whole[:at] + junk + whole[at + len(junk) :])
    read_picture(junk)
