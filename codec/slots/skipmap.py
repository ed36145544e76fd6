"""The skip map of a slice: what becomes of each slot of its lane (codec/FORMAT.md, section 9)."""

from __future__ import annotations

import numpy as np

from codec.arrays import Bytes
from codec.coders.coder import EncodedChunk
from codec.errors import CorruptError
from codec.kernel import kernel

from .rangecoder import WHOLE, decode_bit, encode_bit, finish_encoding, new_model, start_decoding
from .slotlayout import ENDED, HEADER_BYTES, KEPT, NEW, PREDICTED, Kind, SlotHeader, SlotLayout

CONTEXTS = 37
FIRST_OF_B, CONTEXT_OF_C = 32, 36


class SkipMapHistory:
    """Which slots earlier skip maps of a segment did not keep: the contexts of the skip maps to
    come."""

    def __init__(self, layout: SlotLayout) -> None:
        self._layout = layout
        # 2 if not kept by the last skip map of the lane, plus 1 if not by the one before that.
        self._recent = np.zeros((layout.swin_size, layout.num_slots), np.uint8)
        self._lost = np.zeros(layout.swin_size, np.bool_)

    def of(self, birth: int) -> Bytes:
        """(S,) uint8, 0..3: the `h` of each slot in the skip map of `birth`."""
        if birth == self._layout.segment_start(birth):
            return np.zeros(self._layout.num_slots, np.uint8)
        recent: Bytes = self._recent[self._layout.lane(birth)]
        return recent

    def copy(self) -> SkipMapHistory:
        made = SkipMapHistory(self._layout)
        made._recent[:] = self._recent
        made._lost[:] = self._lost
        return made

    def is_readable(self, birth: int) -> bool:
        """Whether the skip map of `birth` can be decoded: no skip map that it is read with was
        lost."""
        first = birth == self._layout.segment_start(birth)
        return first or not self._lost[self._layout.lane(birth)]

    def note(self, birth: int, statuses: Bytes | None) -> None:
        """Takes in the skip map of `birth`, None if it is lost; that of a segment's first frame
        begins anew."""
        if birth == self._layout.segment_start(birth):
            self._recent.fill(0)
            self._lost.fill(False)
            return
        if statuses is None:
            self._lost[self._layout.lane(birth)] = True
            return
        lane = self._recent[self._layout.lane(birth)]
        lane >>= 1
        lane |= (statuses != KEPT).view(np.uint8) << 1


def encode_skip_map(
    layout: SlotLayout, birth: int, statuses: Bytes, history: Bytes
) -> EncodedChunk:
    """The skip map of (S,) `statuses`, of which `history` is `SkipMapHistory.of(birth)`; of no
    bytes if it keeps all."""
    if not statuses.any():
        return EncodedChunk(birth, b"", (0, 0))
    out = np.zeros(layout.max_skip_map_bytes, np.uint8)
    size = _encode(statuses, history, np.array(layout.row_edges), new_model(CONTEXTS), out)
    head = SlotHeader(Kind.SKIP_MAP, 0, birth).pack()
    data = head + out[:size].tobytes()
    return EncodedChunk(birth, data, (0, len(data)))


def decode_skip_map(
    layout: SlotLayout, birth: int, data: bytes | memoryview, history: Bytes
) -> Bytes:
    """(S,) the statuses in the skip map `data` of `birth`; without data all are kept. Raises a
    CodecError."""
    if not data:
        return np.full(layout.num_slots, KEPT, np.uint8)
    SlotHeader.read(data, Kind.SKIP_MAP).expect(birth, 0)
    body = np.frombuffer(data, np.uint8, offset=HEADER_BYTES)
    statuses = np.empty(layout.num_slots, np.uint8)
    read = _decode(body, history, np.array(layout.row_edges), new_model(CONTEXTS), statuses)
    if read < 0:
        raise CorruptError("skip map: its code is not below its range", HEADER_BYTES)
    if read != len(body):
        raise CorruptError(
            f"skip map: a body of {len(body)} bytes, of which {read} are read",
            HEADER_BYTES + min(read, len(body)),
        )
    return statuses


@kernel(nogil=True)
def _encode(statuses, history, row_edges, model, out):  # type: ignore[no-untyped-def]
    """Fills out; gives how many bytes."""
    range_, low, at = WHOLE, 0, 0
    for layer in range(row_edges.shape[0] - 1):
        before = 0  # bit 0: the slot before is not kept; bits 1 and 2: those before that
        for i in range(row_edges[layer], row_edges[layer + 1]):
            h, status = np.int64(history[i]), statuses[i]
            neighbours = 2 * (before & 1) + ((before >> 1) & 1)
            context = 8 * h + 2 * neighbours + (before >> 2)
            changed = 0 if status == KEPT else 1
            range_, low, at = encode_bit(out, model, context, changed, range_, low, at)
            if changed:
                other = 0 if status == PREDICTED else 1
                context = FIRST_OF_B + h
                range_, low, at = encode_bit(out, model, context, other, range_, low, at)
                if other:
                    ended = 0 if status == NEW else 1
                    range_, low, at = encode_bit(out, model, CONTEXT_OF_C, ended, range_, low, at)
            before = ((before << 1) | changed) & 7
    return finish_encoding(out, low, at)


@kernel(nogil=True)
def _decode(body, history, row_edges, model, statuses):  # type: ignore[no-untyped-def]
    """Fills statuses; gives how many bytes that took, which may be more than there are, or -1."""
    range_ = WHOLE
    code, at = start_decoding(body)
    if code >= range_:
        return -1
    for layer in range(row_edges.shape[0] - 1):
        before = 0
        for i in range(row_edges[layer], row_edges[layer + 1]):
            h = np.int64(history[i])
            neighbours = 2 * (before & 1) + ((before >> 1) & 1)
            context = 8 * h + 2 * neighbours + (before >> 2)
            changed, range_, code, at = decode_bit(body, model, context, range_, code, at)
            status = KEPT
            if changed:
                status = PREDICTED
                context = FIRST_OF_B + h
                other, range_, code, at = decode_bit(body, model, context, range_, code, at)
                if other:
                    ended, range_, code, at = decode_bit(
                        body, model, CONTEXT_OF_C, range_, code, at
                    )
                    status = ENDED if ended else NEW
            statuses[i] = status
            before = ((before << 1) | changed) & 7
    return at
