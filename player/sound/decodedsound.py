"""The samples of a stream's sources by segment, and their mix from any sample on.

Rule: pure; `SegmentLoader` alone asks for bytes. One thread may put segments while another mixes.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator

import numpy as np

from codec.camera import Camera
from codec.errors import CodecError
from codec.stream.manifest import Manifest
from codec.stream.sound import SAMPLE_RATE, SoundSource
from codec.tracks.soundfile import Samples

from .mixing import SourcePiece, Stereo, gains_of, mix
from .segmentsound import SegmentDecoder, check_playable, segment_span

ReadSound = Callable[[int, SoundSource], bytes]
"""Gives the object of a source in a segment. Raises what a place of files raises."""


class SegmentLoader:
    """Reads and decodes all sources of one segment after another."""

    def __init__(self, manifest: Manifest, read: ReadSound) -> None:
        """Raises UnsupportedError for a stream whose sound is not played."""
        check_playable(manifest)
        self._read = read
        self._decoders = [(source, SegmentDecoder(source, manifest)) for source in manifest.sound]

    def load(self, segment: int, end_frame: int) -> list[Samples]:
        """The samples of each source. Blocks. end_frame: the frames before it are in the stream.
        Raises a SwingsError."""
        found = []
        for source, decoder in self._decoders:
            data = self._read(segment, source)
            try:
                found.append(decoder.decode(segment, data, end_frame))
            except CodecError as error:
                raise error.within(f"segment {segment}, {source.part}") from error
        return found


class DecodedSound:
    """Decoded segments. What is not there is silent."""

    def __init__(self, manifest: Manifest) -> None:
        self._manifest = manifest
        self._segments: dict[int, list[Samples]] = {}

    def segment_at(self, sample: int) -> int:
        """The segment with which `sample` is heard."""
        manifest = self._manifest
        frame = int(sample * manifest.fps / SAMPLE_RATE)
        segment = frame // manifest.segment_frames
        # Segments begin at whole samples, which lie before their frames.
        while segment_span(manifest, segment)[1] <= sample:
            segment += 1
        return segment

    def has(self, segment: int) -> bool:
        return segment in self._segments

    def put(self, segment: int, samples: list[Samples]) -> None:
        """samples: of each source of the manifest, of the whole segment."""
        self._segments[segment] = samples

    def keep(self, segments: Container[int]) -> None:
        """Drops all others."""
        for segment in [one for one in self._segments if one not in segments]:
            del self._segments[segment]

    def mix(self, begin: int, stop: int, camera: Camera, then: Camera | None = None) -> Stereo:
        """The samples `begin` to `stop`, as heard at `camera` at the first of them and at `then`
        after the last; there too if it is None."""
        spans = list(self._spans(max(0, begin), stop))
        pieces = []
        for number, source in enumerate(self._manifest.sound):
            samples: Samples = np.zeros((stop - begin, source.channels), np.int16)
            for at, found, low, high in spans:
                samples[at - begin : at - begin + high - low] = found[number][low:high]
            first = gains_of(source, begin / SAMPLE_RATE, camera)
            last = first if then is None else gains_of(source, stop / SAMPLE_RATE, then)
            pieces.append(SourcePiece(samples, first, last))
        return mix(pieces, stop - begin)

    def _spans(self, begin: int, stop: int) -> Iterator[tuple[int, list[Samples], int, int]]:
        """The parts of the samples `begin` to `stop` that are here: the first sample of each, its
        segment, and where the part begins and ends in that."""
        while begin < stop:
            segment = self.segment_at(begin)
            first, end = segment_span(self._manifest, segment)
            last = min(stop, end)
            found = self._segments.get(segment)
            if found is not None:
                yield begin, found, begin - first, last - first
            begin = last
