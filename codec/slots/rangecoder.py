"""The adaptive binary arithmetic coder of skip maps (codec/FORMAT.md, section 9).

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
"""Probability of a 0, in 65536ths, before anything was coded."""

MOST_COUNTED = 127
"""Bits of a context that count: a probability moves by half of the way after the first, and by a
128th of it in the end."""

CODE_BYTES = 4
"""Bytes that are read before the first bit."""

Model = npt.NDArray[np.int64]
"""(contexts, 3) of each context the probability, the count, and floor(log2(count + 1))."""


def new_model(contexts: int) -> Model:
    """A model of bits as it stands at the start of a body."""
    model = np.zeros((contexts, 3), np.int64)
    model[:, 0] = FIRST_PROBABILITY
    return model


@kernel(nogil=True)
def _bound(range_, probability):  # type: ignore[no-untyped-def]
    return (range_ >> 12) * (probability >> 4)


@kernel(nogil=True)
def _adapt(model, context, bit):  # type: ignore[no-untyped-def]
    count = model[context, 1]
    if count < MOST_COUNTED:
        count += 1
        model[context, 1] = count
        if count & (count + 1) == 0:
            model[context, 2] += 1
    probability, shift = model[context, 0], model[context, 2]
    if bit:
        model[context, 0] = probability - (probability >> shift)
    else:
        model[context, 0] = probability + ((65535 - probability) >> shift)


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
def decode_bit(data, model, context, range_, code, at):  # type: ignore[no-untyped-def]
    """The next bit, and range, code and place behind it. code must be below range_."""
    bound = _bound(range_, model[context, 0])
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
    _adapt(model, context, bit)
    return bit, range_, code, at


@kernel(nogil=True)
def encode_bit(out, model, context, bit, range_, low, at):  # type: ignore[no-untyped-def]
    """Range, lower end and place behind `bit`. out must have room."""
    bound = _bound(range_, model[context, 0])
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
    _adapt(model, context, bit)
    return range_, low, at


@kernel(nogil=True)
def finish_encoding(out, low, at):  # type: ignore[no-untyped-def]
    """The place behind the last byte."""
    for shift in range(24, -8, -8):
        out[at] = (low >> shift) & 255
        at += 1
    return at
