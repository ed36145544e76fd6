"""The slots that show at any frame of a stream: decoders that go on, or begin at a snapshot."""

from __future__ import annotations

from collections.abc import Callable

from codec.errors import CodecError
from codec.halfway import Motion
from codec.slice import Slice, window_births
from codec.slots.altered import motion_between
from codec.slots.slotdecoder import SlotDecoder

from .integrity import CheckedObject
from .manifest import MASKS, Manifest, Part, snapshot_part

FindObject = Callable[[int, Part], CheckedObject]
"""Gives the object of (segment, part)."""


def join(find: FindObject, manifest: Manifest, frame: int, decoder: SlotDecoder) -> None:
    """Brings `decoder`, whatever it held, to `frame`, from the snapshots of its segment on. Raises
    a CodecError that names the object at fault; the decoder holds nothing then."""
    segment = manifest.segment_of(frame)
    first = segment * manifest.segment_frames
    decoder.clear()
    try:
        for layer in range(decoder.num_layers):
            found = find(segment, snapshot_part(layer))
            snapshot = found.content(first)
            try:
                decoder.load(snapshot, layer, first)
            except CodecError as error:
                raise found.blamed(error, first) from error
        roll(find, manifest, frame, decoder)
    except BaseException:
        decoder.clear()
        raise


def roll(
    find: FindObject,
    manifest: Manifest,
    frame: int,
    decoder: SlotDecoder,
    with_motion: bool = False,
) -> list[Slice]:
    """Applies to `decoder` the slices behind the one that it stands at, up to that of `frame`.
    with_motion: gives them, with their motion; else none is kept. Raises a CodecError that names
    the object at fault; the decoder stands before its slice then."""
    assert decoder.frame is not None
    made = []
    for birth in range(decoder.frame + 1, frame + 1):
        segment = manifest.segment_of(birth)
        masks = find(segment, MASKS)
        layers = [find(segment, layer) for layer in range(decoder.num_layers)]

        def blamed(
            error: CodecError,
            layer: int | None,
            masks: CheckedObject = masks,
            layers: list[CheckedObject] = layers,
            birth: int = birth,
        ) -> CodecError:
            return (masks if layer is None else layers[layer]).blamed(error, birth)

        changes = [found.content(birth) for found in layers]
        slice = decoder.apply(birth, masks.content(birth), changes, blamed, with_motion)
        if with_motion:
            made.append(slice)
    return made


class Seeker:
    """Any slice and any window of a stream; keeps a decoder for each number of layers."""

    def __init__(self, find: FindObject, manifest: Manifest) -> None:
        self._find = find
        self._manifest = manifest
        self._decoders: dict[int, SlotDecoder] = {}

    def slice(self, birth: int, num_layers: int) -> Slice:
        """The whole slice born at `birth`, which the stream has. Raises a CodecError."""
        for layers, decoder in sorted(self._decoders.items()):
            if layers >= num_layers and self._holds(decoder, birth):
                return decoder.whole(birth, num_layers)
        return self._at(max(birth, 0), num_layers).whole(birth)

    def window(self, frame: int, num_layers: int) -> list[Slice]:
        """The whole slices that show at `frame`, oldest first. Raises a CodecError."""
        for layers, decoder in sorted(self._decoders.items()):
            if layers >= num_layers and decoder.frame == frame:
                return decoder.window(frame, num_layers)
        return self._at(frame, num_layers).window(frame)

    def motion(self, frame: int, later: int, num_layers: int) -> Motion:
        """The motion of all slots from `frame` to a `later` one. Raises a CodecError."""
        decoder = self._at(frame, num_layers).copy()
        before = decoder.window(frame)
        changes = roll(self._find, self._manifest, later, decoder, with_motion=True)
        return motion_between(before, changes, decoder.window(later))

    def _holds(self, decoder: SlotDecoder, birth: int) -> bool:
        """Whether the slice of `birth` lies in the window of `decoder` as it was born: of slices
        before a snapshot one knows only what is left of them."""
        if decoder.frame is None or decoder.joined is None:
            return False
        window = window_births(decoder.frame, self._manifest.swin_size)
        return birth in window and decoder.joined <= max(birth, 0)

    def _at(self, frame: int, num_layers: int) -> SlotDecoder:
        """The decoder of `num_layers` layers, at `frame`."""
        manifest = self._manifest
        if num_layers not in self._decoders:
            self._decoders[num_layers] = SlotDecoder(manifest.slot_layout, num_layers)
        decoder = self._decoders[num_layers]
        first = manifest.segment_of(frame) * manifest.segment_frames
        # A snapshot costs about as much as the slices of a window.
        if (
            decoder.frame is not None
            and first - manifest.swin_size <= decoder.frame <= frame
            and decoder.joined is not None
        ):
            roll(self._find, manifest, frame, decoder)
        else:
            join(self._find, manifest, frame, decoder)
        return decoder
