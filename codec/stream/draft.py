"""The segment that a writer has not written yet: slices as packets, and how good they look.

Rule: a draft never changes. Taking in a slice gives another one, so whatever fails on the way
leaves the writer as it was.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from codec.coders.coder import EncodedChunk
from codec.errors import InvalidError
from codec.slice import Slice, window_births
from codec.slots.slotdecoder import SlotDecoder
from codec.slots.slotencoder import SlotEncoder
from codec.slots.update import Update

from .chunk import encode_chunk
from .layers import RankFunction, merge_layers, split_layers
from .manifest import MASKS, SLOTS_VERSION, Manifest, Part, snapshot_part
from .object import decode_packet, encode_packet, join_packets, packet_content

Quality = Callable[[int, Sequence[Slice]], Sequence[float] | None]
"""Takes a birth and, for 1, 2, ... layers, the whole decoded slice. Gives the PSNR in dB of the
frame that the slice is born in, with 1, 2, ... layers; None for a slice born before frame 0."""

Packets = tuple[tuple[int, bytes], ...]
"""(birth, packet) of one part of a segment, in order of birth."""

Scores = tuple[tuple[float, ...], ...]
"""PSNR in dB of each frame with 1, 2, ... layers."""


class Draft(Protocol):
    """What a writer holds between two segments."""

    @property
    def num_packets(self) -> int:
        """Packets that wait for the segment to be whole."""
        ...

    @property
    def scores_db(self) -> Scores: ...

    @property
    def slice_bytes(self) -> int:
        """What the last slice takes: the packets that whoever plays on fetches."""
        ...

    def after(self, slice: Slice | Update) -> Draft:
        """The draft that has `slice`, too, which is the next one. Raises InvalidError."""
        ...

    def objects(self) -> dict[Part, bytes]:
        """The objects of the segment."""
        ...

    def emptied(self) -> Draft:
        """The draft of the segment that follows."""
        ...


def _measured(
    quality: Quality | None, birth: int, slices: Sequence[Slice]
) -> tuple[tuple[float, ...], ...]:
    """The scores of a slice, if it has any; slices: for 1, 2, ... layers."""
    if quality is None:
        return ()
    scores_db = quality(birth, slices)
    if scores_db is None:
        return ()
    if len(scores_db) != len(slices) or any(map(math.isinf, scores_db)):
        raise InvalidError(
            f"a quality of {tuple(scores_db)} dB is not {len(slices)} numbers, each finite, or NaN "
            "where unknown"
        )
    return (tuple(scores_db),)


@dataclass(frozen=True, slots=True)
class SliceDraft:
    """Of version 1: whole slices, each cut into layers by a rank."""

    manifest: Manifest
    rank: RankFunction
    quality: Quality | None
    packets: tuple[Packets, ...]
    """Of each layer."""
    scores_db: Scores = ()

    @staticmethod
    def first(manifest: Manifest, rank: RankFunction, quality: Quality | None) -> SliceDraft:
        return SliceDraft(manifest, rank, quality, ((),) * manifest.num_layers)

    @property
    def num_packets(self) -> int:
        return sum(map(len, self.packets))

    def after(self, slice: Slice | Update) -> SliceDraft:
        manifest = self.manifest
        if not isinstance(slice, Slice):
            raise InvalidError("an Update is for a stream of version 2; append a Slice")
        if slice.rows is not None:
            raise InvalidError(
                "a slice with rows is not whole; a stream of version 1 needs whole slices"
            )
        if len(slice.splats) > manifest.slice_size:
            raise InvalidError(
                f"{len(slice.splats)} Gaussians, at most {manifest.slice_size} a slice"
            )
        if slice.splats.sh_degree != manifest.sh_degree:
            raise InvalidError(f"SH degree {slice.splats.sh_degree}, not {manifest.sh_degree}")
        parts = split_layers(slice, manifest.layers, self.rank)
        steps = manifest.profile.coding.layer_steps([part.splats for part in parts])
        encoded = [
            encode_packet(encode_chunk(part, layer, manifest.profile, steps[layer]))
            for layer, part in enumerate(parts)
        ]
        scores_db = self.scores_db
        if self.quality is not None:
            # Of the bytes as they are, not of what was given.
            chunks = [decode_packet(packet) for packet in encoded]
            slices = [merge_layers(chunks[:n]) for n in range(1, len(chunks) + 1)]
            scores_db += _measured(self.quality, slice.birth, slices)
        packets = tuple(
            (*kept, (slice.birth, packet))
            for kept, packet in zip(self.packets, encoded, strict=True)
        )
        return replace(self, packets=packets, scores_db=scores_db)

    @property
    def slice_bytes(self) -> int:
        return sum(len(packets[-1][1]) for packets in self.packets)

    def objects(self) -> dict[Part, bytes]:
        return {layer: join_packets(packets) for layer, packets in enumerate(self.packets)}

    def emptied(self) -> SliceDraft:
        return self.first(self.manifest, self.rank, self.quality)


@dataclass(frozen=True, slots=True)
class SlotDraft:
    """Of version 2: what changes in slots that last."""

    manifest: Manifest
    quality: Quality | None
    encoder: SlotEncoder
    """Never altered, like the decoder; what follows is a copy that went on."""
    decoder: SlotDecoder | None
    """What a reader has by now; only for the quality, and from frame 0 on."""
    packets: dict[Part, Packets]
    scores_db: Scores = ()

    @staticmethod
    def first(
        manifest: Manifest, quality: Quality | None, read: SlotDecoder | None = None
    ) -> SlotDraft:
        """The draft of the first segment, or of the one after what `read` has read."""
        encoder = SlotEncoder(manifest.slot_layout) if read is None else SlotEncoder.resumed(read)
        packets: dict[Part, Packets] = dict.fromkeys(manifest.parts, ())
        return SlotDraft(manifest, quality, encoder, read if quality else None, packets)

    @staticmethod
    def opened(manifest: Manifest, quality: Quality | None, opening: Sequence[Update]) -> SlotDraft:
        """The draft of the segment after the updates `opening`, see `SlotEncoder.opened`."""
        encoder = SlotEncoder.opened(manifest.slot_layout, opening)
        packets: dict[Part, Packets] = dict.fromkeys(manifest.parts, ())
        return SlotDraft(manifest, quality, encoder, None, packets)

    @property
    def num_packets(self) -> int:
        return sum(map(len, self.packets.values()))

    def after(self, slice: Slice | Update) -> SlotDraft:
        if not isinstance(slice, Update):
            raise InvalidError("a Slice is for a stream of version 1; append an Update")
        encoder = self.encoder.copy()
        encoded = encoder.append(slice)
        if encoded is None:
            return replace(self, encoder=encoder)
        birth, packets = slice.birth, dict(self.packets)
        parts: list[tuple[Part, EncodedChunk]] = [
            (MASKS, encoded.mask),
            *enumerate(encoded.changes),
        ]
        if birth % self.manifest.segment_frames == 0:
            snapshots = enumerate(encoder.snapshots())
            parts += [(snapshot_part(layer), chunk) for layer, chunk in snapshots]
        for part, chunk in parts:
            packets[part] = (*packets[part], (birth, encode_packet(chunk)))
        after = replace(self, encoder=encoder, packets=packets)
        return after if self.quality is None else after._scored(birth)

    def _scored(self, birth: int) -> SlotDraft:
        """The draft with the scores of the slice of `birth`, its last one: of the bytes as they
        are, not of what was given."""
        manifest, layers = self.manifest, range(1, self.manifest.num_layers + 1)
        births = range(birth, birth + 1)
        if self.decoder is None:
            decoder = SlotDecoder(manifest.slot_layout)
            for layer in range(manifest.num_layers):
                decoder.load(self._content(snapshot_part(layer)), layer, birth)
            births = window_births(birth, manifest.swin_size)
        else:
            decoder = self.decoder.copy()
            changes = [self._content(layer) for layer in range(manifest.num_layers)]
            decoder.apply(birth, self._content(MASKS), changes)
        scores_db = self.scores_db
        for number in births:
            slices = [decoder.whole(number, n) for n in layers]
            scores_db += _measured(self.quality, number, slices)
        return replace(self, decoder=decoder, scores_db=scores_db)

    @property
    def slice_bytes(self) -> int:
        parts = (MASKS, *range(self.manifest.num_layers))
        return sum(len(packet) for part in parts for _, packet in self.packets[part][-1:])

    def _content(self, part: Part) -> bytes:
        """The chunk in the last packet of `part`."""
        return packet_content(self.packets[part][-1][1], self.manifest.max_content_bytes(part))

    def objects(self) -> dict[Part, bytes]:
        return {
            part: join_packets(packets, version=SLOTS_VERSION)
            for part, packets in self.packets.items()
        }

    def emptied(self) -> SlotDraft:
        packets: dict[Part, Packets] = dict.fromkeys(self.packets, ())
        return replace(self, packets=packets, scores_db=())
