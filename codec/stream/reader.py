"""Reads a stream where it lies: any slice, any window, the slots that show at any frame, any number
of layers; memory stays bounded.

Rule: every file is checked against the index before it is decoded, and an error names the file.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterator

from codec.errors import CodecError, InvalidError, UnsupportedError
from codec.lattice.lattice import bytes_per_gaussian
from codec.slice import Motion, Slice, active_splats, window_births
from codec.slots.decoder import SlotDecoder
from codec.slots.encoder import motion_between
from codec.splats import Splats
from codec.storage.openstorage import Place
from codec.storage.storage import Storage

from .integrity import MAX_INDEX_BYTES, CheckedObject, read_index
from .manifest import (
    MANIFEST_NAME,
    MAX_MANIFEST_BYTES,
    SKIP_MAPS,
    Manifest,
    Part,
    keyframe_part,
    object_name,
)
from .packedstorage import open_place
from .segment import INDEX_NAME, SegmentRecord, record_bytes

FindObject = Callable[[int, Part], CheckedObject]
"""Gives the object of (segment, part)."""


def join(find: FindObject, manifest: Manifest, frame: int, decoder: SlotDecoder) -> None:
    """Brings `decoder`, whatever it held, to `frame`, from the keyframes of its segment on. Raises
    a CodecError that names the object at fault; the decoder holds nothing then."""
    segment = manifest.segment_of(frame)
    first = segment * manifest.segment_frames
    decoder.clear()
    try:
        for layer in range(decoder.num_layers):
            found = find(segment, keyframe_part(layer))
            keyframe = found.content(first)
            try:
                decoder.load(keyframe, layer, first)
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
        skip_maps = find(segment, SKIP_MAPS)
        layers = [find(segment, layer) for layer in range(decoder.num_layers)]

        def blamed(
            error: CodecError,
            layer: int | None,
            skip_maps: CheckedObject = skip_maps,
            layers: list[CheckedObject] = layers,
            birth: int = birth,
        ) -> CodecError:
            return (skip_maps if layer is None else layers[layer]).blamed(error, birth)

        changes = [found.content(birth) for found in layers]
        slice = decoder.apply(birth, skip_maps.content(birth), changes, blamed, with_motion)
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
        before a keyframe one knows only what is left of them."""
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
        # A keyframe costs about as much as the slices of a window.
        if (
            decoder.frame is not None
            and first - manifest.swin_size <= decoder.frame <= frame
            and decoder.joined is not None
        ):
            roll(self._find, manifest, frame, decoder)
        else:
            join(self._find, manifest, frame, decoder)
        return decoder


DEFAULT_MAX_GAUSSIANS = 1 << 22
"""Gaussians of a stream that is opened unless more are allowed: at SH degree 0 about 1 GB."""

FLOAT_COPIES = 5
"""Peak memory of a reader, without its libraries, in copies of all Gaussians as float32: export
needs the most."""


def check_gaussians(manifest: Manifest, max_gaussians: int | None, name: str) -> None:
    """Raises UnsupportedError if the stream `name` has more than `max_gaussians` Gaussians. None
    allows all that the format does, 2^24: a stream of a few kilobytes may have as many.

    To be called before anything is decoded, or allocated by the manifest's counts.
    """
    count = manifest.num_gs
    if max_gaussians is None or count <= max_gaussians:
        return
    memory_gb = FLOAT_COPIES * count * bytes_per_gaussian(manifest.sh_degree) / 1e9
    raise UnsupportedError(
        f"{name} has {count:,} Gaussians; use --max-gaussians {count} to read it "
        f"(about {memory_gb:.1f} GB of memory)"
    )


def read_stream_file(storage: Storage, path: str, limit_bytes: int, offset: int = 0) -> bytes:
    """The file at `path` of the stream in `storage`, from `offset` on. Raises CorruptError."""
    meaning = "this is not a whole swings stream"
    return storage.read(path, limit_bytes, offset, if_missing=meaning)


class StreamReader:
    """A stream where it lies, finished or still growing (`refresh`)."""

    def __init__(self, place: Place, max_gaussians: int | None = DEFAULT_MAX_GAUSSIANS) -> None:
        """max_gaussians: see `check_gaussians`; None for streams of one's own."""
        self._max_gaussians = max_gaussians
        self.storage = open_place(place)
        self.name = self.storage.name
        self.records: list[SegmentRecord] = []
        """One record for each finished segment."""
        self._objects: OrderedDict[tuple[int, Part], CheckedObject] = OrderedDict()
        self._read_manifest()
        self._seeker = Seeker(self._object, self.manifest)
        self.refresh()

    def _read_manifest(self) -> None:
        self.storage.check()
        data = read_stream_file(self.storage, MANIFEST_NAME, MAX_MANIFEST_BYTES)
        try:
            self.manifest = Manifest.from_json(data)
        except CodecError as error:
            raise error.within(self.storage.place(MANIFEST_NAME)) from error
        check_gaussians(self.manifest, self._max_gaussians, self.name)
        self.manifest_json = data

    @property
    def num_frames(self) -> int:
        """Frames that can be shown now: 0..num_frames-1."""
        return self.records[-1].first_frame + self.records[-1].num_frames if self.records else 0

    def summary(self, num_layers: int) -> str:
        """The length of the stream and the layers of it that are read, for people."""
        frames = "1 frame" if self.num_frames == 1 else f"{self.num_frames} frames"
        layers = "1 layer" if num_layers == 1 else f"{num_layers} layers"
        return f"{frames} at {self.manifest.fps:g} a second, {layers}"

    @property
    def births(self) -> range:
        """The births of all slices there are now."""
        first = self.manifest.first_birth
        return range(first, self.num_frames) if self.records else range(first, first)

    @property
    def overhead_bytes(self) -> int:
        """Size of the manifest and of the index's whole records."""
        return len(self.manifest_json) + self.index_bytes

    @property
    def index_bytes(self) -> int:
        """Size of the index's whole records."""
        return len(self.records) * record_bytes(self.manifest.num_layers)

    def refresh(self) -> int:
        """Takes in what was appended since; gives how many segments are new."""
        if self.manifest.live:
            # Before the index: a manifest that says finished then goes with a whole index.
            self._read_manifest()
        begin = self.index_bytes
        data = read_stream_file(self.storage, INDEX_NAME, MAX_INDEX_BYTES, begin)
        try:
            fresh = read_index(data, self.manifest, self.records)
        except CodecError as error:
            raise error.within(self.storage.place(INDEX_NAME), begin) from error
        self.records += fresh
        return len(fresh)

    def object_place(self, segment: int, part: Part) -> str:
        """Where the object of (segment, part) lies, for errors."""
        return self.storage.place(object_name(segment, part))

    def read_object(self, segment: int, part: Part) -> CheckedObject:
        """The object of (segment, part), read and checked now."""
        if not 0 <= segment < len(self.records) or part not in self.manifest.parts:
            name = f"layer {part}" if type(part) is int else part
            raise InvalidError(
                f"{self.name} has no segment {segment} {name}: it has "
                f"{len(self.records)} segments of {self.manifest.num_layers} layers"
            )
        record = self.records[segment]
        size = record.part_bytes[self.manifest.part_number(part)]
        data = read_stream_file(self.storage, object_name(segment, part), size)
        place = self.object_place(segment, part)
        return CheckedObject.check(place, data, self.manifest, record, part)

    def _object(self, segment: int, part: Part) -> CheckedObject:
        key = (segment, part)
        if key not in self._objects:
            self._objects[key] = self.read_object(segment, part)
            # All that a window can touch, and the segment after it.
            segments = 2 + self.manifest.swin_size // self.manifest.segment_frames
            while len(self._objects) > segments * len(self.manifest.parts):
                self._objects.popitem(last=False)
        self._objects.move_to_end(key)
        return self._objects[key]

    def slice(self, birth: int, num_layers: int) -> Slice:
        """The slice born at `birth`, of its layers 0..num_layers-1, whole."""
        self._check_layers(num_layers)
        if birth not in self.births:
            raise InvalidError(
                f"{self.name} has no slice born at {birth}; it has {len(self.births)} slices "
                f"from {self.manifest.first_birth} on"
            )
        return self._seeker.slice(birth, num_layers)

    def _check_layers(self, num_layers: int) -> None:
        if not 1 <= num_layers <= self.manifest.num_layers:
            raise InvalidError(f"{num_layers} layers of {self.manifest.num_layers}")

    def decoder_at(self, frame: int, num_layers: int) -> SlotDecoder:
        """A decoder of the caller's own that stands at `frame`."""
        self._check_layers(num_layers)
        if not 0 <= frame < self.num_frames:
            raise InvalidError(f"{self.name} has no frame {frame}; it has {self.num_frames} frames")
        decoder = SlotDecoder(self.manifest.slot_layout, num_layers)
        join(self._object, self.manifest, frame, decoder)
        return decoder

    def slices(self, first_birth: int, num_layers: int) -> Iterator[Slice]:
        """The slices from `first_birth` to the last one there is when it is reached."""
        birth = first_birth
        if birth < self.manifest.first_birth:
            raise InvalidError(f"{self.name} has no slice born at {birth}")
        while birth in self.births:
            yield self.slice(birth, num_layers)
            birth += 1

    def window(self, frame: int, num_layers: int) -> list[Slice]:
        """The swin_size slices that show at `frame`, oldest first."""
        if not 0 <= frame < self.num_frames:
            raise InvalidError(f"{self.name} has no frame {frame}; it has {self.num_frames} frames")
        self._check_layers(num_layers)
        return self._seeker.window(frame, num_layers)

    def motion(self, frame: int, later: int, num_layers: int) -> Motion:
        """The motion of all slots from `frame` to a `later` one: the Gaussians between them."""
        if not 0 <= frame < later < self.num_frames:
            raise InvalidError(
                f"{self.name} has {self.num_frames} frames; there is no motion from {frame} to "
                f"{later}"
            )
        self._check_layers(num_layers)
        return self._seeker.motion(frame, later, num_layers)

    def active_splats(self, frame: int, num_layers: int) -> Splats:
        """All Gaussians that show at `frame`, oldest slice first."""
        window = self.window(frame, num_layers)
        return active_splats(window, frame, self.manifest.swin_size)
