"""A plain encoder of chunks, written from codec/FORMAT.md alone, and streams of noise."""

from __future__ import annotations

import random
import struct
from collections.abc import Sequence

from tests.goldens.decoder import (
    CHANGE,
    ENDED,
    KEPT,
    MASK,
    NEW,
    PREDICTED,
    SNAPSHOT,
    Floats,
    Gaussian,
    Hole,
    Shape,
    Slot,
    Statuses,
    f32,
)
from tests.goldens.folder import Lanes


class BitEncoder:
    """A range coder of 32 bits with carry: `low` and the bytes before it are one number."""

    def __init__(self) -> None:
        self.out = bytearray()
        self.low = 0
        self.range = 2**32 - 1
        self.p = [32768] * 37
        self.c = [0] * 37

    def put(self, context: int, bit: int) -> None:
        p = self.p[context]
        bound = (self.range >> 12) * (p >> 4)
        if bit:
            self.low += bound
            self.range -= bound
        else:
            self.range = bound
        if self.low >> 32:
            self.low -= 2**32
            last = len(self.out) - 1
            while self.out[last] == 255:
                self.out[last] = 0
                last -= 1
            self.out[last] += 1
        while self.range < 2**24:
            self.out.append(self.low >> 24)
            self.low = self.low << 8 & 0xFFFFFFFF
            self.range <<= 8
        self.c[context] = min(self.c[context] + 1, 127)
        shift = (self.c[context] + 1).bit_length() - 1
        self.p[context] = p - (p >> shift) if bit else p + (65535 - p >> shift)

    def finish(self) -> bytes:
        return bytes(self.out) + self.low.to_bytes(4, "big")


def encode_mask(mask: Statuses, before: Sequence[Statuses] = ()) -> bytes:
    encoder = BitEncoder()
    for layer, statuses in enumerate(mask):
        changed = [0, 0, 0, *(int(status != KEPT) for status in statuses)]
        for slot, status in enumerate(statuses):
            m, second, first = changed[slot : slot + 3]
            h = sum(
                weight * int(earlier[layer][slot] != KEPT)
                for weight, earlier in zip((2, 1), before, strict=False)
            )
            encoder.put(8 * h + 4 * first + 2 * second + m, int(status != KEPT))
            if status != KEPT:
                encoder.put(32 + h, int(status != PREDICTED))
                if status != PREDICTED:
                    encoder.put(36, int(status == ENDED))
    return encoder.finish()


def head(kind: int, birth: int, layer: int = 0, flags: int = 0) -> bytes:
    return struct.pack("<4sBBBBi", b"SWG2", kind, layer, flags, 0, birth)


def zigzag(value: int) -> int:
    return 2 * value if value >= 0 else -2 * value - 1


def planes(rows: Sequence[Sequence[int]]) -> bytes:
    return b"".join(map(bytes, zip(*rows, strict=True)))


def residual_row(before: Gaussian, after: Gaussian) -> tuple[list[int], list[int | None]]:
    """The bytes of the planes, and for each coordinate the long residual if it needs one."""
    moves = [b - a for a, b in zip(before.position, after.position, strict=True)]
    row = [min(zigzag(move), 255) for move in moves]
    for a, b in zip(before.attributes, after.attributes, strict=True):
        row.append(zigzag((b - a + 128) % 256 - 128))
    return row, [move if zigzag(move) >= 255 else None for move in moves]


def encode_change(
    pairs: Sequence[tuple[Gaussian, Gaussian]],
    new: Sequence[Gaussian],
    k: int,
    starts: Sequence[int] | None,
) -> bytes:
    """The body of a change, `starts` of the new counted from the birth."""
    rows, long = [], []
    for before, after in pairs:
        row, more = residual_row(before, after)
        rows.append(row)
        long.append(more)
    long_residuals = [more[axis] for axis in range(3) for more in long if more[axis] is not None]
    bits, used, last, new_rows = 0, 0, (0, 0, 0), []
    for gaussian in new:
        position = last if gaussian.escaped else gaussian.position
        new_row = []
        for a, b in zip(last, position, strict=True):
            v = zigzag(b - a)
            new_row.append(v.bit_length())
            if v:
                width = v.bit_length() - 1
                bits |= (v ^ 1 << width) << used
                used += width
        attributes = [0] * (7 + 3 * k)
        if gaussian.escaped is None:
            attributes = [*(a + 128 for a in gaussian.attributes[:-1]), gaussian.attributes[-1]]
        new_rows.append(new_row + attributes)
        last = (position[0], position[1], position[2])
    low_bytes = (used + 7) // 8
    which = [i for i, gaussian in enumerate(new) if gaussian.escaped]
    exact = [gaussian.escaped for gaussian in new if gaussian.escaped]
    return b"".join(
        [
            struct.pack("<5I", len(pairs), len(new), len(long_residuals), len(which), low_bytes),
            planes(rows),
            struct.pack(f"<{len(long_residuals)}i", *long_residuals),
            planes(new_rows),
            bits.to_bytes(low_bytes, "little"),
            struct.pack(f"<{len(which)}I", *which),
            encode_escapes(exact),
            bytes(starts or ()),
        ]
    )


def encode_escapes(exact: Sequence[Floats]) -> bytes:
    arrays = [
        *(g.mean for g in exact),
        *(g.log_scales for g in exact),
        *(g.quat for g in exact),
        [g.logit_opacity for g in exact],
        *(colour for g in exact for colour in g.sh),
    ]
    return b"".join(struct.pack(f"<{len(array)}f", *array) for array in arrays)


def encode_snapshot(lanes: Lanes, frame: int, layer: int, shape: Shape) -> bytes:
    flags, new, starts, bit = 0, [], [], 0
    for birth in range(frame - shape.swin_size + 1, frame + 1):
        for slot in lanes[birth % shape.swin_size][layer]:
            if isinstance(slot, Gaussian):
                flags |= 1 << bit
                new.append(slot)
                starts.append(slot.start - birth if slot.start > frame else 0)
            bit += 1
    stored = starts if any(starts) else None
    body = encode_change([], new, shape.num_coefficients, stored)
    packed = flags.to_bytes((bit + 7) // 8, "little")
    return head(SNAPSHOT, frame, layer, int(any(starts))) + packed + body


class RandomStream:
    """A stream of noise with everything that may occur in one, and the true state of each frame."""

    def __init__(self, shape: Shape, num_frames: int, seed: int, spelled_out: bool = False) -> None:
        self.shape = shape
        self.spelled_out = spelled_out  # slices without changes have packets, too
        self.random = random.Random(seed)
        self.masks: list[Statuses] = []
        self.mask_chunks: list[bytes] = []
        self.changes: list[list[bytes]] = []  # [birth][layer]
        self.truth: list[Lanes] = []
        swin_size = shape.swin_size
        lanes: Lanes = [[] for _ in range(swin_size)]
        for birth in range(1 - swin_size, 1):
            lanes[birth % swin_size] = [
                [self.gaussian(layer, birth) if self.chance(0.8) else Hole.EMPTY for _ in range(n)]
                for layer, n in enumerate(shape.slots)
            ]
        for birth in range(num_frames):
            self.add(birth, lanes)
            self.truth.append([[list(slots) for slots in lane] for lane in lanes])

    def chance(self, share: float) -> bool:
        return self.random.random() < share

    def attribute(self) -> int:
        return self.random.choice((-128, 127, self.random.randint(-128, 127)))

    def coordinate(self) -> int:
        most = 2**23 - 1
        return self.random.choice((-most, most, 0, self.random.randint(-most, most)))

    def gaussian(self, layer: int, birth: int) -> Gaussian:
        k = self.shape.num_coefficients
        start = birth + self.random.choice((0, self.random.randrange(self.shape.swin_size)))
        level = self.random.randrange(self.shape.lattice[layer].opacity_levels)
        if not self.chance(0.1):
            place = (self.coordinate(), self.coordinate(), self.coordinate())
            return Gaussian(start, place, (*(self.attribute() for _ in range(6 + 3 * k)), level))
        numbers = [f32(self.random.gauss(0, 1e5)) for _ in range(11 + 3 * k)]
        sh = tuple(tuple(numbers[i : i + 3]) for i in range(11, 11 + 3 * k, 3))
        escaped = Floats(
            tuple(numbers[:3]), tuple(numbers[3:6]), tuple(numbers[6:10]), numbers[10], sh
        )
        return Gaussian(start, (0, 0, 0), (0,) * (7 + 3 * k), escaped)

    def moved(self, before: Gaussian, layer: int, birth: int) -> Gaussian:
        """Another Gaussian near `before`, or anywhere."""
        while True:
            after = self.gaussian(layer, birth)
            if after.escaped is None:
                break
        if self.chance(0.2):
            return Gaussian(birth, after.position, after.attributes)
        move = (self.random.randint(-130, 130) for _ in range(3))
        most = 2**23 - 1
        place = tuple(
            max(-most, min(most, a + b)) for a, b in zip(before.position, move, strict=True)
        )
        return Gaussian(birth, place, after.attributes)

    def status(self, slot: Slot, birth: int) -> int:
        if birth == 0 or self.chance(0.6):
            return KEPT
        may_be_predicted = isinstance(slot, Gaussian) and slot.escaped is None
        if may_be_predicted and self.chance(0.6):
            return PREDICTED
        return self.random.choice((NEW, ENDED))

    def add(self, birth: int, lanes: Lanes) -> None:
        lane = lanes[birth % self.shape.swin_size]
        mask = [[self.status(slot, birth) for slot in slots] for slots in lane]
        first = birth - birth % self.shape.segment_frames
        earlier = (birth - self.shape.swin_size, birth - 2 * self.shape.swin_size)
        before = [self.masks[b] for b in earlier if b > first]
        self.masks.append(mask)
        is_told = self.spelled_out or any(map(any, mask))
        self.mask_chunks.append(head(MASK, birth) + encode_mask(mask, before) if is_told else b"")
        self.changes.append([])
        for layer, (slots, statuses) in enumerate(zip(lane, mask, strict=True)):
            pairs, new = [], []
            for i, (slot, status) in enumerate(zip(slots, statuses, strict=True)):
                if status == PREDICTED and isinstance(slot, Gaussian):
                    pairs.append((slot, self.moved(slot, layer, birth)))
                    slots[i] = pairs[-1][1]
                elif status == NEW:
                    new.append(self.gaussian(layer, birth))
                    slots[i] = new[-1]
                elif status == ENDED:
                    slots[i] = Hole.EMPTY
            starts = [gaussian.start - birth for gaussian in new]
            body = encode_change(
                pairs, new, self.shape.num_coefficients, starts if any(starts) else None
            )
            is_told = bool(self.spelled_out or pairs or new)
            chunk = head(CHANGE, birth, layer, int(any(starts))) + body
            self.changes[birth].append(chunk if is_told else b"")
