"""Hostile skip maps, changes and keyframes for a decoder that continues with those it accepts.
Every run is the same."""

from __future__ import annotations

import random
import struct

from codec.errors import CodecError
from codec.slots.decoder import SlotDecoder
from codec.slots.encoder import EncodedSlice, SlotEncoder
from tests.support.slots.updates import patternless_updates, small_layout

BYTES = (0, 1, 3, 24, 25, 26, 127, 128, 160, 161, 254, 255)
NUM_FRAMES = 13


def altered(data: bytes, rng: random.Random) -> bytes:
    """`data`, mostly with a few bytes or counts changed, or truncated or extended."""
    made = bytearray(data)
    kind = rng.randrange(6)
    if kind == 1 and len(made) >= 32:
        count = rng.choice((0, 1, 2, 5, 200, 1 << 20, 1 << 31))
        struct.pack_into("<I", made, 12 + 4 * rng.randrange(5), count)
    elif kind == 2:
        made = made[: rng.randrange(len(made) + 1)]
    elif kind == 3:
        made += bytes(rng.choice(BYTES) for _ in range(rng.randrange(1, 9)))
    elif kind > 3 and len(made) > 12:
        for _ in range(rng.randrange(1, 4)):
            made[rng.randrange(12, len(made))] = rng.choice(BYTES)
    return bytes(made)


def hostile_slots(count: int) -> int:
    """Passes at least `count` altered chunks to decoders; returns the number of accepted ones.
    Raises every error except CodecError."""
    rng = random.Random(1)
    taken = tried = 0
    while tried < count:
        layout = small_layout(rng.choice((1, 2, 3)), (7, 4), rng.randrange(2), 4)
        encoder, decoder = SlotEncoder(layout), SlotDecoder(layout)
        missed: list[tuple[int, int, bytes]] = []
        for update in patternless_updates(layout, NUM_FRAMES, rng.randrange(1000), True):
            encoded = encoder.append(update)
            if encoded is None:
                continue
            keyframes = encoder.keyframes() if update.birth % 4 == 0 else ()
            if update.birth:
                taken += _applied(decoder, encoded, missed, rng)
                tried += 1
            for chunk in keyframes:
                try:
                    decoder.load(altered(chunk.data, rng), frame=update.birth)
                    taken += 1
                except CodecError:
                    decoder.load(chunk.data)
                tried += 1
            for late in missed[-2:]:
                try:
                    decoder.late(*late)
                except CodecError:
                    continue
            decoder.window(update.birth)
    return taken


def _applied(
    decoder: SlotDecoder,
    encoded: EncodedSlice,
    missed: list[tuple[int, int, bytes]],
    rng: random.Random,
) -> bool:
    """Whether the decoder accepted an altered slice; else applies the correct one, or nothing."""
    birth, changes = encoded.birth, [change.data for change in encoded.changes]
    which, wrong = rng.randrange(3), list(changes)
    skip_map = encoded.skip_map.data
    if which < 2:
        wrong[which] = altered(changes[which], rng)
    else:
        skip_map = altered(skip_map, rng)
    try:
        decoder.apply(birth, skip_map, wrong)
        return True
    except CodecError:
        pass
    layer = rng.randrange(2)
    missed.append((birth, layer, changes[layer]))
    partly = [None if n == layer else change for n, change in enumerate(changes)]
    try:
        decoder.apply(birth, encoded.skip_map.data, partly)
    except CodecError:  # it accepted an altered chunk before
        decoder.apply(birth, None, [])
    return False
