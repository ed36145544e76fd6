"""Turns packets, as they arrive, into the slices that a renderer takes, frame after frame.

Rule: pure. Late packets are put in where they belong; a lane shows them with its next slice. A
broken packet is a CodecError that names where it came from.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from codec.errors import CodecError, CorruptError
from codec.slice import Slice
from codec.slots.decoder import SlotDecoder
from codec.stream.manifest import SKIP_MAPS, Manifest, Part, keyframe_part, layer_of
from codec.stream.segment import packet_content
from player.source.source import Blame, KeyframePackets, Packets, SlicePackets

log = logging.getLogger(__name__)


@dataclass(slots=True)
class _Gathered:
    """The parts of one slice so far, decompressed, and for each the object that errors name."""

    parts: dict[Part, bytes] = field(default_factory=dict)
    blames: dict[Part, Blame] = field(default_factory=dict)


class Assembler:
    """The slots of a playback: first the whole slices of its first window, then slices that change
    rows. Layers that are missing are hidden."""

    def __init__(
        self, manifest: Manifest, num_layers: int, first_frame: int, mends: bool = False
    ) -> None:
        """num_layers: the most that arrive. mends: whether what is damaged above layer 0 counts as
        missing."""
        self._manifest = manifest
        self._decoder = SlotDecoder(manifest.slot_layout, num_layers)
        self._first_frame = first_frame
        self._mends = mends

    def assemble(
        self, frame: int, packets: Iterable[Packets], with_motion: bool = False
    ) -> list[Slice]:
        """Slices to put before `frame` is drawn. Call it for every frame of a playback, in order.

        packets: those that came into use with the frame, of slices born at or before it.
        with_motion: whether the slices say which Gaussians they move. Raises a CodecError.
        """
        decoder = self._decoder
        keyframes: dict[int, list[KeyframePackets]] = {}
        slices: dict[int, _Gathered] = {}
        for one in packets:
            if isinstance(one, KeyframePackets):
                keyframes.setdefault(one.frame, []).append(one)
            else:
                self._gather(slices.setdefault(one.birth, _Gathered()), one)
        if decoder.frame is None:
            first = decoder.layout.segment_start(self._first_frame)
            self._load(keyframes.pop(first, []))
        if decoder.frame is None:
            raise CorruptError(f"frame {frame} is due, but no keyframe has arrived")
        for early in sorted(keyframes):
            if early <= decoder.frame:
                self._load(keyframes.pop(early))
        for birth in sorted(slices):
            if birth <= decoder.frame:
                self._late(birth, slices[birth])
        made = []
        for birth in range(decoder.frame + 1, frame + 1):
            gathered, whole = slices.get(birth, _Gathered()), keyframes.get(birth, [])
            if SKIP_MAPS not in gathered.parts and any(one.first_layer == 0 for one in whole):
                # After a break the stream begins anew: nothing says what became of the slots.
                decoder.clear()
                self._load(whole)
                made = decoder.hand_out(birth)
                continue
            made.append(self._apply(birth, gathered, with_motion))
            self._load(whole)
        return decoder.hand_out(frame) if frame == self._first_frame else made

    def _gather(self, gathered: _Gathered, one: SlicePackets) -> None:
        parts: list[tuple[Part, bytes]] = [*enumerate(one.packets, one.first_layer)]
        if one.skip_map is not None:
            parts.append((SKIP_MAPS, one.skip_map))
        for part, packet in parts:
            if part not in gathered.parts:
                with self._mending(part):
                    gathered.parts[part] = self._content(packet, part, one.blame)
                    gathered.blames[part] = one.blame

    def _content(self, packet: bytes, part: Part, blame: Blame) -> bytes:
        try:
            return packet_content(packet, self._manifest.max_content_bytes(part))
        except CodecError as error:
            raise blame(error, part) from error

    def _load(self, keyframes: Iterable[KeyframePackets]) -> None:
        for one in keyframes:
            for layer, packet in enumerate(one.packets, one.first_layer):
                part = keyframe_part(layer)
                with self._mending(part):
                    content = self._content(packet, part, one.blame)
                    try:
                        self._decoder.load(content, layer, one.frame)
                    except CodecError as error:
                        raise one.blame(error, part) from error

    def _late(self, birth: int, gathered: _Gathered) -> None:
        for layer in range(self._decoder.num_layers):
            change = gathered.parts.get(layer)
            if change is None:
                continue
            with self._mending(layer):
                try:
                    self._decoder.late(birth, layer, change)
                except CodecError as error:
                    raise gathered.blames[layer](error, layer) from error

    @contextmanager
    def _mending(self, part: Part) -> Iterator[None]:
        """Goes on after an error in `part`, if it may be missing."""
        try:
            yield
        except CodecError as error:
            self._check_mends(error, part)

    def _check_mends(self, error: CodecError, part: Part) -> None:
        if not self._mends or layer_of(part) == 0:
            raise error
        log.warning("%s; the layer is missing for a while", error)

    def _apply(self, birth: int, gathered: _Gathered, with_motion: bool) -> Slice:
        parts = gathered.parts
        if SKIP_MAPS not in parts:
            raise CorruptError(
                f"the slice born at {birth} is due, but its skip map has not arrived"
            )

        at_fault: Part = SKIP_MAPS

        def blamed(error: CodecError, layer: int | None) -> CodecError:
            nonlocal at_fault
            at_fault = SKIP_MAPS if layer is None else layer
            return gathered.blames[at_fault](error, at_fault)

        while True:
            changes = [parts.get(layer) for layer in range(self._decoder.num_layers)]
            try:
                return self._decoder.apply(birth, parts[SKIP_MAPS], changes, blamed, with_motion)
            except CodecError as error:
                self._check_mends(error, at_fault)
                del parts[at_fault]
