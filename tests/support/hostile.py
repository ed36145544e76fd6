"""The law of decoders, as a helper: any bytes give a value or a CodecError."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable

from codec.errors import CodecError


def survives(decode: Callable[[bytes], object], data: bytes) -> bool:
    """Whether `decode` gave a value; anything but a value or a CodecError rises."""
    with contextlib.suppress(CodecError):
        decode(data)
        return True
    return False


def truncations(data: bytes) -> Iterable[bytes]:
    """Every proper prefix of `data`."""
    return (data[:length] for length in range(len(data)))


def flips(data: bytes, every: int = 1) -> Iterable[bytes]:
    """`data` with one byte altered in each of three ways, at every `every`-th place."""
    for place in range(0, len(data), every):
        for value in (data[place] ^ 1, data[place] ^ 0x80, 255 - data[place]):
            yield data[:place] + bytes([value]) + data[place + 1 :]
