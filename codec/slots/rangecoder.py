"""The adaptive binary arithmetic coder of masks (codec/FORMAT.md, section 15).

Rule: what the encoder writes is, byte for byte, what the decoder reads, so that the end of a body
is known. All numbers are int64, in which nothing here can overflow.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from codec.kernel import kernel

WHOLE = (1 << 32) - 1
"""The range at the start."""

LEAST = 1 << 24
"""A range below this one is scaled up by a byte."""

FIRST_PROBABILITY = 1 << 15
"""Of a 0, in 65536ths, before anything was coded."""

MOST_COUNTED = 127
"""Bits of a context that are counted. A probability moves by half of the way the first time, and by
less and less, until the count stays here."""

SHIFTS = np.floor(np.log2(np.arange(2, MOST_COUNTED + 2))).astype(np.int64)
"""(MOST_COUNTED,) after 1, 2, ... bits a probability moves by 2**-SHIFTS[...] of the way."""

CODE_BYTES = 4
"""Bytes that are read before the first bit."""

MAX_BYTES_PER_BIT = 4 / 3
"""What a bit costs at most: a probability stays within 63 .. 65472."""


def new_probabilities(contexts: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """(contexts,) the probabilities and the counts at the start of a body."""
    return np.full(contexts, FIRST_PROBABILITY, np.int64), np.zeros(contexts, np.int64)


@kernel(nogil=True)
def _bound(range_, probability):  # type: ignore[no-untyped-def]
    return (range_ >> 12) * (probability >> 4)


@kernel(nogil=True)
def _adapt(probabilities, counts, context, bit):  # type: ignore[no-untyped-def]
    count = min(counts[context] + 1, MOST_COUNTED)
    counts[context] = count
    shift = SHIFTS[count - 1]
    probability = probabilities[context]
    if bit:
        probabilities[context] = probability - (probability >> shift)
    else:
        probabilities[context] = probability + ((65535 - probability) >> shift)


@kernel(nogil=True)
def start_decoding(data):  # type: ignore[no-untyped-def]
    """The code and how many bytes were read; what is behind the end counts as zeros."""
    code = np.int64(0)
    for at in range(CODE_BYTES):
        code = code << 8
        if at < data.shape[0]:
            code |= np.int64(data[at])
    return code, CODE_BYTES


@kernel(nogil=True)
def decode_bit(data, probabilities, counts, context, range_, code, at):  # type: ignore[no-untyped-def]
    """The next bit, and range, code and place behind it. code must be below range_."""
    bound = _bound(range_, probabilities[context])
    bit = 0
    if code < bound:
        range_ = bound
    else:
        bit = 1
        code -= bound
        range_ -= bound
    while range_ < LEAST:
        range_ <<= 8
        code <<= 8
        if at < data.shape[0]:
            code |= np.int64(data[at])
        at += 1
    _adapt(probabilities, counts, context, bit)
    return bit, range_, code, at


@kernel(nogil=True)
def encode_bit(out, probabilities, counts, context, bit, range_, low, at):  # type: ignore[no-untyped-def]
    """Range, lower end and place behind `bit`. out must have room, see MAX_BYTES_PER_BIT."""
    bound = _bound(range_, probabilities[context])
    if bit:
        low += bound
        range_ -= bound
        if low > WHOLE:
            low -= WHOLE + 1
            carried = at - 1
            while out[carried] == 255:
                out[carried] = 0
                carried -= 1
            out[carried] += 1
    else:
        range_ = bound
    while range_ < LEAST:
        out[at] = low >> 24
        at += 1
        low = (low << 8) & WHOLE
        range_ <<= 8
    _adapt(probabilities, counts, context, bit)
    return range_, low, at


@kernel(nogil=True)
def finish_encoding(out, low, at):  # type: ignore[no-untyped-def]
    """The place behind the last byte."""
    for shift in range(24, -8, -8):
        out[at] = (low >> shift) & 255
        at += 1
    return at
