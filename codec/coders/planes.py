"""Byte planes of a change as a bit string (codec/FORMAT.md, section 10.5): which bytes of a
Gaussian are not 0 as one Huffman code for several planes, and the values by the prefix codes that
suit each plane best.

There are no tables but 3 bits for each pattern, because a change is small and decoded by itself.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import numpy.typing as npt

from codec.arrays import Bytes, Longs
from codec.kernel import kernel

NUM_CODES = 32
"""Prefix codes of values, one of which each plane names."""

MOST_ONES = 12
"""Ones that begin a value at most."""

MOST_LOW_BITS = 8
"""Bits behind the ones at most, and behind the most of them."""

LENGTH_BITS, MOST_LENGTH = 3, 7
"""Bits of the length of a pattern's code, and the longest one."""

CODE_BITS, CENTRE_BITS = 5, 8
"""Bits in front of the values of a plane: of its code, and where Gaussians are new its centre."""

FIRST_LOOK_BITS = 8
"""Bits of a value that a decoder looks up at once."""

Words = npt.NDArray[np.uint32]


@cache
def groups(num_planes: int) -> Longs:
    """(G, 4) the planes that share a pattern; -1 where there are three only."""
    k = (num_planes - 10) // 3
    rows = [[0, 1, 2, num_planes - 1], [3, 4, 5, -1], [6, 7, 8, -1]]
    rows += [[9 + n, 9 + k + n, 9 + 2 * k + n, -1] for n in range(k)]
    return np.array(rows, np.int64)


def _codes() -> tuple[Longs, Longs]:
    """(32, 13) for each code and number of ones, the low bits that follow and the least value."""
    ones = np.arange(MOST_ONES + 1)
    code = np.arange(NUM_CODES)[:, None]
    widths = np.minimum((code >> 2) + (ones >> (code & 3)), MOST_LOW_BITS)
    widths[:, MOST_ONES] = MOST_LOW_BITS
    ends = np.cumsum(1 << widths, axis=1)
    return widths, ends - (1 << widths)


WIDTHS, LEAST = _codes()


def _value_ones() -> Longs:
    """(32, 256) how many ones begin a value."""
    found = [np.searchsorted(least, np.arange(256), "right") - 1 for least in LEAST]
    return np.array(found)


ONES = _value_ones()

LENGTHS: Longs = np.minimum(ONES + 1, MOST_ONES) + np.take_along_axis(WIDTHS, ONES, 1)
"""(32, 256) bits of a value."""


def _first_looks() -> npt.NDArray[np.uint16]:
    """(32, 256) for the next bits the value, and its length from bit 8 on; 0 where it is longer."""
    table = np.zeros((NUM_CODES, 1 << FIRST_LOOK_BITS), np.uint16)
    for length in range(1, FIRST_LOOK_BITS + 1):
        code, value = np.nonzero(np.equal(LENGTHS, length))
        ones = ONES[code, value]
        bits = (1 << ones) - 1 | (value - LEAST[code, ones]) << (ones + 1)
        behind = np.arange(1 << (FIRST_LOOK_BITS - length)) << length
        table[code[:, None], bits[:, None] + behind] = (value | length << 8)[:, None]
    return table


FIRST_LOOKS = _first_looks()


def encode_planes(numbers: tuple[int, ...], predicted: Bytes, new: Bytes) -> bytes:
    """`numbers`, then (planes, P) and (planes, N) bytes, as a bit string."""
    num_bits = sum(CODE_BITS + number.bit_length() for number in numbers)
    most = (num_bits >> 3) + 64 * len(predicted) + 4 * (predicted.size + new.size)
    out = np.zeros(most, np.uint8)
    at = 0
    for number in numbers:
        at = append_bits(out, at, number.bit_length(), CODE_BITS)
        at = append_bits(out, at, number, number.bit_length())
    rows = groups(len(predicted))
    at = _encode(out, at, predicted, new, rows, WIDTHS, LEAST, ONES, LENGTHS)
    return out[: (at + 7) >> 3].tobytes()


def read_numbers(data: bytes | memoryview, count: int) -> tuple[list[int], int]:
    """The `count` numbers at the start of a bit string, and the place of the bit behind them. What
    is behind its end counts as zeros."""
    bits, at, found = int.from_bytes(data[: 5 * count], "little"), 0, []
    for _ in range(count):
        length = bits >> at & (1 << CODE_BITS) - 1
        at += CODE_BITS
        found.append(bits >> at & (1 << length) - 1)
        at += length
    return found, at


def decode_planes(
    data: bytes | memoryview, at: int, predicted: Bytes, new: Bytes
) -> tuple[int, int, int]:
    """Fills (planes, P) and (planes, N) bytes from bit `at` on. Gives the place of the bit behind
    them, which may lie behind the end, or -1 if they are no planes; how many bytes of the predicted
    x, y, z are 255; and the sum of those of the new above 1, less 1 each."""
    words = np.frombuffer(b"".join((data, bytes(-len(data) & 3))), "<u4")
    rows = groups(len(predicted))
    end, num_most, num_low_bits = _decode(
        words, at, rows, WIDTHS, LEAST, FIRST_LOOKS, predicted, new
    )
    return int(end), int(num_most), int(num_low_bits)


@kernel(nogil=True)
def append_bits(out, at, value, count):  # type: ignore[no-untyped-def]
    """The place behind `count` bits of `value`, lowest first."""
    while count > 0:
        taken = min(8 - (at & 7), count)
        out[at >> 3] |= (value & ((1 << taken) - 1)) << (at & 7)
        value >>= taken
        count -= taken
        at += taken
    return at


@kernel(nogil=True)
def _append_values(out, at, values, code, widths, least, ones):  # type: ignore[no-untyped-def]
    for value in values:
        count = ones[code, value]
        at = append_bits(out, at, (1 << count) - 1, min(count + 1, MOST_ONES))
        at = append_bits(out, at, value - least[code, count], widths[code, count])
    return at


@kernel(nogil=True)
def _cheapest(values, lengths):  # type: ignore[no-untyped-def]
    """The code for `values`, and their bits in it."""
    counts = np.zeros(256, np.int64)
    for value in values:
        counts[value] += 1
    best, least = 0, np.int64(1) << 60
    for code in range(NUM_CODES):
        bits = (counts * lengths[code]).sum()
        if bits < least:
            best, least = code, bits
    return best, least


@kernel(nogil=True)
def _pattern_lengths(counts, lengths):  # type: ignore[no-untyped-def]
    """Fills lengths with those of a Huffman code, none over MOST_LENGTH. A single pattern has 1."""
    size = counts.shape[0]
    weights = counts.copy()
    while True:
        lengths[:] = 0
        tree = weights.copy()
        root = np.arange(size)
        while True:
            a, b = -1, -1
            for s in range(size):
                if tree[s] > 0:
                    if a < 0 or tree[s] < tree[a]:
                        a, b = s, a
                    elif b < 0 or tree[s] < tree[b]:
                        b = s
            if b < 0:
                lengths[a] = max(lengths[a], 1)
                break
            tree[a] += tree[b]
            tree[b] = 0
            for s in range(size):
                if root[s] == b:
                    root[s] = a
                if root[s] == a and weights[s] > 0:
                    lengths[s] += 1
        if lengths.max() <= MOST_LENGTH:
            return
        weights = (weights + 1) >> 1


@kernel(nogil=True)
def _pattern_codes(lengths, codes):  # type: ignore[no-untyped-def]
    """Fills codes, their first bit lowest: shorter ones first, then in the order of the patterns.
    Gives whether the lengths are those of a whole code."""
    code = 0
    for length in range(1, MOST_LENGTH + 1):
        code <<= 1
        for s in range(lengths.shape[0]):
            if lengths[s] == length:
                codes[s] = 0
                for bit in range(length):
                    codes[s] |= ((code >> bit) & 1) << (length - 1 - bit)
                code += 1
    return code == 1 << MOST_LENGTH


@kernel(nogil=True)
def _encode(out, at, predicted, new, rows, widths, least, ones, lengths):  # type: ignore[no-untyped-def]
    """The place behind the planes."""
    count = predicted.shape[1]
    patterns = np.empty(count, np.int64)
    for g in range(rows.shape[0] if count else 0):
        num_planes = 4 if rows[g, 3] >= 0 else 3
        size = 1 << num_planes
        counts, code_lengths, codes = np.zeros((3, size), np.int64)
        for i in range(count):
            patterns[i] = 0
            for n in range(num_planes):
                patterns[i] |= (1 if predicted[rows[g, n], i] else 0) << n
            counts[patterns[i]] += 1
        _pattern_lengths(counts, code_lengths)
        for s in range(size):
            at = append_bits(out, at, code_lengths[s], LENGTH_BITS)
        if _pattern_codes(code_lengths, codes):
            for pattern in patterns:
                at = append_bits(out, at, codes[pattern], code_lengths[pattern])
        for n in range(num_planes):
            plane = predicted[rows[g, n]]
            values = plane[plane > 0].astype(np.int64) - 1
            if values.shape[0] == 0:
                continue
            code, _ = _cheapest(values, lengths)
            at = append_bits(out, at, code, CODE_BITS)
            at = _append_values(out, at, values, code, widths, least, ones)
    for p in range(new.shape[0] if new.shape[1] else 0):
        plane = new[p].astype(np.int64)
        order = np.sort(plane)
        best, chosen, values = np.int64(1) << 60, 0, np.zeros(0, np.int64)
        centre = np.int64(0)
        for place in (0, new.shape[1] // 2):
            middle = order[place]
            steps = ((plane - middle + 128) & 255) - 128
            zigzags = np.where(steps >= 0, 2 * steps, -2 * steps - 1)
            code, bits = _cheapest(zigzags, lengths)
            if bits < best:
                best, chosen, values, centre = bits, code, zigzags, middle
        at = append_bits(out, at, centre, CENTRE_BITS)
        at = append_bits(out, at, chosen, CODE_BITS)
        at = _append_values(out, at, values, chosen, widths, least, ones)
    return at


@kernel(nogil=True)
def _refilled(words, held, left, word):  # type: ignore[no-untyped-def]
    """At least 32 bits held, of which `left` are there; what is behind the end is zeros."""
    if left < 32:
        if word < words.shape[0]:
            held |= np.int64(words[word]) << left
        word += 1
        left += 32
    return held, left, word


@kernel(nogil=True)
def _decode_values(words, held, left, word, looks, widths, least, values):  # type: ignore[no-untyped-def]
    """Fills values by a code; gives the largest, and what is held behind them."""
    largest = np.int64(0)
    for i in range(values.shape[0]):
        if left < 32:  # `_refilled`, which is too slow to call for every value
            if word < words.shape[0]:
                held |= np.int64(words[word]) << left
            word += 1
            left += 32
        found = np.int64(looks[held & ((1 << FIRST_LOOK_BITS) - 1)])
        if found:
            values[i] = found & 255
            held >>= found >> 8
            left -= found >> 8
        else:
            ones = 0
            while ones < MOST_ONES and (held >> ones) & 1:
                ones += 1
            taken = min(ones + 1, MOST_ONES)
            values[i] = least[ones] + ((held >> taken) & ((1 << widths[ones]) - 1))
            held >>= taken + widths[ones]
            left -= taken + widths[ones]
        largest = max(largest, values[i])
    return largest, held, left, word


@kernel(nogil=True)
def _decode_patterns(words, held, left, word, lengths, patterns):  # type: ignore[no-untyped-def]
    """Fills patterns; gives the planes that they may set, -1 if their code is not whole, and what
    is held behind them."""
    codes = np.zeros(lengths.shape[0], np.int64)
    used = np.flatnonzero(lengths)
    if used.shape[0] == 1:
        patterns[:] = used[0]
        return used[0], held, left, word
    if not _pattern_codes(lengths, codes):
        return -1, held, left, word
    changing = np.int64(0)
    table = np.empty(1 << MOST_LENGTH, np.int64)
    for s in used:
        changing |= s
        table[codes[s] :: 1 << lengths[s]] = s | lengths[s] << 8
    for i in range(patterns.shape[0]):
        if left < 32:
            held, left, word = _refilled(words, held, left, word)
        found = table[held & ((1 << MOST_LENGTH) - 1)]
        patterns[i] = found & 255
        held >>= found >> 8
        left -= found >> 8
    return changing, held, left, word


@kernel(nogil=True)
def _decode(words, at, rows, widths, least, looks, predicted, new):  # type: ignore[no-untyped-def]
    """See `decode_planes`."""
    count, word, num_most, num_low_bits = predicted.shape[1], at >> 5, 0, 0
    held, left, word = _refilled(words, np.int64(0), np.int64(0), word)
    held >>= at & 31
    left -= at & 31
    patterns = np.zeros(count, np.uint8)
    places = np.empty(count + 1, np.int64)
    values = np.empty(max(count, new.shape[1]), np.int64)
    for g in range(rows.shape[0] if count else 0):
        num_planes = 4 if rows[g, 3] >= 0 else 3
        lengths = np.zeros(1 << num_planes, np.int64)
        for s in range(lengths.shape[0]):
            held, left, word = _refilled(words, held, left, word)
            lengths[s] = held & MOST_LENGTH
            held >>= LENGTH_BITS
            left -= LENGTH_BITS
        changing, held, left, word = _decode_patterns(words, held, left, word, lengths, patterns)
        if changing < 0:
            return -1, 0, 0
        for n in range(num_planes):
            plane = predicted[rows[g, n]]
            plane[:] = 0
            if (changing >> n) & 1 == 0:
                continue
            held, left, word = _refilled(words, held, left, word)
            code = held & (NUM_CODES - 1)
            held >>= CODE_BITS
            left -= CODE_BITS
            num_places = 0
            for i in range(count):  # without a branch, which would often be mispredicted
                places[num_places] = i
                num_places += (patterns[i] >> n) & 1
            largest, held, left, word = _decode_values(
                words, held, left, word, looks[code], widths[code], least[code], values[:num_places]
            )
            if largest > 254:
                return -1, 0, 0
            for i in range(num_places):
                plane[places[i]] = values[i] + 1
            if g == 0 and n < 3 and largest == 254:
                num_most += (values[:num_places] == 254).sum()
    for p in range(new.shape[0] if new.shape[1] else 0):
        held, left, word = _refilled(words, held, left, word)
        centre, code = held & 255, held >> CENTRE_BITS & (NUM_CODES - 1)
        held >>= CENTRE_BITS + CODE_BITS
        left -= CENTRE_BITS + CODE_BITS
        largest, held, left, word = _decode_values(
            words, held, left, word, looks[code], widths[code], least[code], values[: new.shape[1]]
        )
        if largest > 255:
            return -1, 0, 0
        for i in range(new.shape[1]):
            byte = (centre + ((values[i] >> 1) ^ -(values[i] & 1))) & 255
            new[p, i] = byte
            num_low_bits += max(byte - 1, 0) if p < 3 else 0
    return 32 * word - left, num_most, num_low_bits
