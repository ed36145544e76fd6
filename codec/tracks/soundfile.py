"""Sound files to Opus packets and back to samples, by PyAV."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import Any, BinaryIO

import av
import av.stream
import numpy as np
import numpy.typing as npt

from codec.errors import CorruptError, InvalidError
from codec.stream.sound import SAMPLE_RATE, SoundObject, packet_samples

PACKET_SAMPLES = 960
"""Samples in a packet that is written: 20 ms."""

MAX_LATE_S = 3600.0
"""Most silence that the times in a video put before its sound."""

MIN_BITRATE_BPS, MAX_BITRATE_BPS = 6000, 510000

Samples = npt.NDArray[np.int16]
"""(n, channels)."""

LAYOUTS = {1: "mono", 2: "stereo"}


def read_samples(path: Path, channels: int, opened: BinaryIO | None = None) -> Iterator[Samples]:
    """The first sound in the file at `path`, at SAMPLE_RATE, piece by piece; that of a video from
    its first picture on, with silence if it begins later. opened: its bytes, if they do not lie
    there. Raises InvalidError if it has none, CorruptError if it cannot be read."""
    if not path.is_file():
        raise InvalidError(f"{path} is not a file; name one with sound")
    source = f"file:{path}" if opened is None else opened
    try:
        with av.open(source, "r", options={"protocol_whitelist": "file"}) as container:
            if not container.streams.audio:
                raise InvalidError(f"{path} has no sound")
            resampler = av.AudioResampler("s16", LAYOUTS[channels], SAMPLE_RATE)
            frames = iter(container.decode(container.streams.audio[0]))
            first = next(frames, None)
            if first is None:
                return
            late_s = _late_s(container, first)
            yield from shifted(_resampled(resampler, chain([first], frames)), channels, late_s)
    except (av.FFmpegError, ValueError) as error:
        if isinstance(error, InvalidError):
            raise
        reason = getattr(error, "strerror", None) or error
        raise CorruptError(
            f"{path}: its sound cannot be read: {reason}; "
            "give WAV, FLAC, Opus, or a video with sound"
        ) from error


def _late_s(container: Any, first: Any) -> float:
    """By how much the sound, whose frame `first` is, begins after the pictures; 0 without them."""
    for video in container.streams.video:
        if not video.disposition & av.stream.Disposition.attached_pic:
            if video.start_time is None or first.pts is None:
                return 0.0
            late_s = first.pts * first.time_base - video.start_time * video.time_base
            return max(-MAX_LATE_S, min(MAX_LATE_S, float(late_s)))
    return 0.0


def _resampled(resampler: Any, frames: Iterable[av.AudioFrame]) -> Iterator[Samples]:
    for frame in chain(frames, [None]):
        if frame is not None:
            frame.pts = None
        for piece in resampler.resample(frame):
            block = piece.to_ndarray().astype(np.int16, copy=False)
            yield block.reshape(-1, len(piece.layout.channels))


def shifted(pieces: Iterable[Samples], channels: int, offset_s: float) -> Iterator[Samples]:
    """`pieces` begun `offset_s` later, after silence; below 0 without the beginning."""
    offset = round(offset_s * SAMPLE_RATE)
    while offset > 0:
        count = min(offset, SAMPLE_RATE)
        yield np.zeros((count, channels), np.int16)
        offset -= count
    for piece in pieces:
        dropped = min(len(piece), -offset)
        offset += dropped
        if dropped < len(piece):
            yield piece[dropped:]


def encode(
    pieces: Iterable[Samples], channels: int, max_samples: int, bitrate_bps: int
) -> SoundObject:
    """All packets of a source: of `pieces`, `max_samples` at most. Raises InvalidError."""
    if not MIN_BITRATE_BPS <= bitrate_bps <= MAX_BITRATE_BPS:
        raise InvalidError(
            f"a bit rate of {bitrate_bps} is not in {MIN_BITRATE_BPS}..{MAX_BITRATE_BPS}"
        )
    encoder: Any = av.CodecContext.create("libopus", "w")
    encoder.sample_rate, encoder.layout, encoder.format = SAMPLE_RATE, LAYOUTS[channels], "s16"
    encoder.bit_rate = bitrate_bps
    encoder.open()
    pre_skip = int.from_bytes(bytes(encoder.extradata)[10:12], "little")
    packets: list[bytes] = []
    rest = np.zeros((0, channels), np.int16)
    count = fed = 0

    def feed(block: Samples | None) -> None:
        nonlocal fed
        frame = None
        if block is not None:
            row = np.ascontiguousarray(block).reshape(1, -1)
            frame = av.AudioFrame.from_ndarray(row, "s16", LAYOUTS[channels])
            frame.sample_rate, frame.pts = SAMPLE_RATE, fed
            fed += len(block)
        packets.extend(bytes(packet) for packet in encoder.encode(frame))

    for piece in pieces:
        piece = piece[: max_samples - count]
        count += len(piece)
        rest = np.concatenate([rest, piece])
        while len(rest) >= PACKET_SAMPLES:
            feed(rest[:PACKET_SAMPLES])
            rest = rest[PACKET_SAMPLES:]
        if count >= max_samples:
            break
    # Silence pushes out the samples that the encoder holds back.
    tail = -(-(len(rest) + pre_skip) // PACKET_SAMPLES) * PACKET_SAMPLES
    padded = np.zeros((tail, channels), np.int16)
    padded[: len(rest)] = rest
    for at in range(0, tail, PACKET_SAMPLES):
        feed(padded[at : at + PACKET_SAMPLES])
    feed(None)
    return SoundObject(channels, pre_skip, count, 0, tuple(packets))


class PacketDecoder:
    """A decoder of Opus that goes on from packet to packet."""

    def __init__(self, channels: int) -> None:
        self._channels = channels
        self._decoder: Any = av.CodecContext.create("libopus", "r")
        self._decoder.sample_rate, self._decoder.layout = SAMPLE_RATE, LAYOUTS[channels]

    def decode(self, packet: bytes) -> Samples:
        """The samples of the next packet. Raises CorruptError."""
        try:
            frames = self._decoder.decode(av.Packet(packet))
        except (av.FFmpegError, ValueError) as error:
            raise CorruptError(f"sound: a packet is not Opus: {error}") from error
        pieces = [frame.to_ndarray() for frame in frames]
        found = np.concatenate(pieces, axis=1) if pieces else np.zeros((1, 0), np.int16)
        if found.dtype != np.int16:
            found = np.rint(np.clip(found, -1, 1) * 32767).astype(np.int16)
        samples = found.reshape(-1, self._channels) if found.shape[0] == 1 else found.T
        if len(samples) != packet_samples(packet):
            raise CorruptError(f"sound: a packet gave {len(samples)} samples")
        return samples


def decode(packets: Iterable[bytes], channels: int) -> Iterator[Samples]:
    """The samples of `packets`, with the pre-skip, one piece for each. Raises CorruptError."""
    decoder = PacketDecoder(channels)
    yield from map(decoder.decode, packets)
