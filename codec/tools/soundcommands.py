"""The subcommands of swings-stream audio."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from codec.stream.sound import SoundSource

Folder = tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="STREAM")]]


@dataclass(frozen=True, slots=True)
class Add:
    """Add a sound to a finished stream, from its first frame on."""

    stream: Folder
    """Folder of the stream; a .swings file must be unpacked first."""
    file: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="FILE")]]
    """WAV, FLAC, Opus, or a video with sound."""
    name: str = "main"
    """Name of the source: small letters and digits."""
    at_m: tuple[float, float, float] | None = None
    """Where the source is in the world, metres; it is mono then. Else stereo, heard as it is."""
    bitrate_bps: int = 96000
    """Bits of Opus a second."""


@dataclass(frozen=True, slots=True)
class Remove:
    """Remove a sound from a finished stream."""

    stream: Folder
    """Folder of the stream."""
    name: str = "main"
    """Name of the source."""


@dataclass(frozen=True, slots=True)
class Extract:
    """Write a sound of a stream as a WAV file."""

    stream: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="STREAM")]]
    """Folder of the stream, or its URL in an object store."""
    out: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="OUT.wav")]]
    """File to write."""
    name: str = "main"
    """Name of the source."""


@dataclass(frozen=True, slots=True)
class Audio:
    """The sound of a stream: add, remove, extract."""

    audio: Annotated[Add | Remove | Extract, tyro.conf.arg(name="")]


def run_audio(config: Audio) -> str:
    """Does what `config` says; gives a line about it."""
    from .streamsound import add_sound, extract_sound, remove_sound  # PyAV loads slowly

    match config.audio:
        case Add(stream=stream, file=file, name=name, at_m=at_m, bitrate_bps=bitrate_bps):
            keys = () if at_m is None else ((0.0, *at_m),)
            source = SoundSource(name, 1 if keys else 2, keys)
            size_bytes = add_sound(stream, file, source, bitrate_bps)
            return f"{stream}: sound {name}, {size_bytes} bytes"
        case Remove(stream=stream, name=name):
            remove_sound(stream, name)
            return f"{stream}: sound {name} is removed"
        case Extract(stream=place, out=out, name=name):
            return f"{out}: {extract_sound(place, out, name)} samples"
