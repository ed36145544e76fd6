"""Packets to the slices that a renderer takes, frame after frame (version 1).

Rule: pure. Packets come in compressed, when they are due; what does not belong is a CodecError that
names where it came from.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

from codec.errors import CodecError, CorruptError
from codec.slice import Slice
from codec.stream.chunk import Chunk
from codec.stream.integrity import decode_fitting_packet
from codec.stream.layers import merge_layers
from codec.stream.manifest import Manifest
from player.source.source import Packets, SnapshotPackets

from .slotassembler import SlotAssembler


class Assembler(Protocol):
    """What one version makes of packets."""

    def take(
        self, frame: int, packets: Iterable[Packets], with_motion: bool = False
    ) -> list[Slice]:
        """The slices to put before `frame` is drawn, with `packets`, which came into use with it:
        of slices born at or before it. Raises a CodecError.

        with_motion: whether slices say what they move, where the version knows.

        Call it for every frame of a playback in order.
        """
        ...


def open_assembler(manifest: Manifest, num_layers: int, first_frame: int) -> Assembler:
    """What assembles a stream from `first_frame` on, of which `num_layers` layers come at most."""
    if manifest.has_slots:
        return SlotAssembler(manifest, num_layers, first_frame)
    return SliceAssembler(manifest, num_layers)


class SliceAssembler:
    """Version 1: a slice is whole with the layers that have come, and again when more come."""

    def __init__(self, manifest: Manifest, num_layers: int) -> None:
        self._manifest = manifest
        self._num_layers = num_layers
        self._chunks: dict[int, dict[int, Chunk]] = {}  # by birth, by layer

    def take(
        self, frame: int, packets: Iterable[Packets], with_motion: bool = False
    ) -> list[Slice]:
        oldest = frame - self._manifest.swin_size + 1
        altered: set[int] = set()
        for one in packets:
            assert not isinstance(one, SnapshotPackets), "version 1 has none"
            if one.birth < oldest:
                continue
            held = self._chunks.setdefault(one.birth, {})
            for layer, packet in enumerate(one.packets, one.first_layer):
                if layer in held:
                    continue
                if layer >= self._num_layers:
                    raise CorruptError(
                        f"a packet of layer {layer} of the slice born at {one.birth} arrived; "
                        f"this play has {self._num_layers} layers"
                    )
                try:
                    held[layer] = self._chunk(packet, one.birth, layer, held)
                except CodecError as error:
                    raise one.blame(error, layer) from error
                altered.add(one.birth)
        slices = []
        for birth in sorted(altered):
            held = self._chunks[birth]
            usable = next(n for n in range(len(held) + 1) if n not in held)
            if usable:
                slices.append(merge_layers([held[layer] for layer in range(usable)]))
        for birth in [birth for birth in self._chunks if birth < oldest]:
            del self._chunks[birth]
        return slices

    def _chunk(self, packet: bytes, birth: int, layer: int, held: dict[int, Chunk]) -> Chunk:
        # The packets of a slice share what the manifest declares: all are bounded by it together.
        taken = sum(len(other.slice.splats) for other in held.values())
        return decode_fitting_packet(packet, self._manifest, birth, layer, taken)
