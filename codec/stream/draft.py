"""The segment that a writer has not written yet: slices as packets, and how good they look.

Rule: a draft never changes. Taking in a slice gives another one, so whatever fails on the way
leaves the writer as it was.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from codec.coders.coder import EncodedChunk
from codec.coders.effort import Effort
from codec.errors import InvalidError
from codec.slice import Slice, window_births
from codec.slots.slotdecoder import SlotDecoder
from codec.slots.slotencoder import SlotEncoder
from codec.slots.update import Update

from .manifest import MASKS, Manifest, Part, snapshot_part
from .object import encode_packet, join_packets, packet_content

Quality = Callable[[int, Sequence[Slice]], Sequence[float] | None]
"""Takes a birth and, for 1, 2, ... layers, the whole decoded slice. Gives the PSNR in dB of the
frame that the slice is born in, with 1, 2, ... layers; None for a slice born before frame 0."""

Whole = Callable[[Slice], Update]
"""Makes of a slice the update that sends it whole. Raises InvalidError."""

Packets = tuple[tuple[int, bytes], ...]
"""(birth, packet) of one part of a segment, in order of birth."""

Scores = tuple[tuple[float, ...], ...]
"""PSNR in dB of each frame with 1, 2, ... layers."""


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
class Draft:
    """A writer's state between two segments."""

    manifest: Manifest
    quality: Quality | None
    encoder: SlotEncoder
    """Never altered, like the decoder; what follows is a copy that went on."""
    decoder: SlotDecoder | None
    """The state of a reader that has read everything so far; only to measure quality, and from
    frame 0 on."""
    packets: dict[Part, Packets]
    whole: Whole
    """Makes an update of a slice that is sent whole."""
    scores_db: Scores = ()
    effort: Effort = Effort.USUAL
    """Spent on making packets small."""

    @staticmethod
    def first(
        manifest: Manifest,
        whole: Whole,
        quality: Quality | None,
        read: SlotDecoder | None = None,
        effort: Effort = Effort.USUAL,
    ) -> Draft:
        """The draft of the first segment, or of the one after what `read` has read."""
        encoder = SlotEncoder(manifest.slot_layout) if read is None else SlotEncoder.resumed(read)
        packets: dict[Part, Packets] = dict.fromkeys(manifest.parts, ())
        decoder = read if quality else None
        return Draft(manifest, quality, encoder, decoder, packets, whole, (), effort)

    @staticmethod
    def opened(
        manifest: Manifest, whole: Whole, quality: Quality | None, opening: Sequence[Update]
    ) -> Draft:
        """The draft of the segment after the updates `opening`, see `SlotEncoder.opened`."""
        encoder = SlotEncoder.opened(manifest.slot_layout, opening)
        packets: dict[Part, Packets] = dict.fromkeys(manifest.parts, ())
        return Draft(manifest, quality, encoder, None, packets, whole)

    @property
    def num_packets(self) -> int:
        """Packets that wait for the segment to be whole."""
        return sum(map(len, self.packets.values()))

    def after(self, slice: Slice | Update) -> Draft:
        """The draft that has `slice`, too, which is the next one. Raises InvalidError."""
        update = slice if isinstance(slice, Update) else self.whole(slice)
        encoder = self.encoder.copy()
        encoded = encoder.append(update)
        if encoded is None:
            return replace(self, encoder=encoder)
        birth, packets = update.birth, dict(self.packets)
        parts: list[tuple[Part, EncodedChunk]] = [
            (MASKS, encoded.mask),
            *enumerate(encoded.changes),
        ]
        if birth % self.manifest.segment_frames == 0:
            snapshots = enumerate(encoder.snapshots())
            parts += [(snapshot_part(layer), chunk) for layer, chunk in snapshots]
        for part, chunk in parts:
            packets[part] = (*packets[part], (birth, encode_packet(chunk, effort=self.effort)))
        after = replace(self, encoder=encoder, packets=packets)
        return after if self.quality is None else after._scored(birth)

    def _scored(self, birth: int) -> Draft:
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
        """Size of the last slice's packets, without snapshots."""
        parts = (MASKS, *range(self.manifest.num_layers))
        return sum(len(packet) for part in parts for _, packet in self.packets[part][-1:])

    def _content(self, part: Part) -> bytes:
        """The chunk in the last packet of `part`."""
        return packet_content(self.packets[part][-1][1], self.manifest.max_content_bytes(part))

    def objects(self) -> dict[Part, bytes]:
        """The objects of the segment."""
        return {part: join_packets(packets) for part, packets in self.packets.items()}

    def emptied(self) -> Draft:
        """The draft of the segment that follows."""
        packets: dict[Part, Packets] = dict.fromkeys(self.packets, ())
        return replace(self, packets=packets, scores_db=())
