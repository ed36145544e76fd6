"""The subcommands of swings-stream audio."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from codec.errors import CorruptError, InvalidError
from codec.files import read_bounded
from codec.stream.sound import DEFAULT_BITRATE_BPS, Key, SoundSource, keys_of

MAX_PATH_FILE_BYTES = 1 << 20

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
    path: Annotated[Path | None, tyro.conf.arg(metavar="JSON")] = None
    """How the source moves: [[SECOND, X, Y, Z], ...] in the stream's time and metres, in order of
    time. It is mono then, and goes straight from one place to the next."""
    offset_s: float = 0.0
    """Second of the stream at which the file begins, after silence; below 0, what comes before
    frame 0 is left out."""
    bitrate_bps: int = DEFAULT_BITRATE_BPS
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


def _read_keys(path: Path) -> tuple[Key, ...]:
    """The keys in the JSON file at `path`: [[second, x, y, z], ...]. Raises CorruptError that names
    it; `SoundSource` checks their number and order."""
    try:
        value = json.loads(read_bounded(path, MAX_PATH_FILE_BYTES))
        if type(value) is not list:
            raise CorruptError("this is not a list of places; give [[SECOND, X, Y, Z], ...]")
        return keys_of(value)
    except CorruptError as error:
        raise error.within(str(path)) from error
    except (OSError, ValueError, RecursionError) as error:
        raise CorruptError(f"{path}: this file cannot be read: {error}") from error


def _keys(add: Add) -> tuple[Key, ...]:
    """Where the source is. Raises InvalidError or CorruptError."""
    if add.path is None:
        return () if add.at_m is None else ((0.0, *add.at_m),)
    if add.at_m is not None:
        raise InvalidError("give --at-m or --path, not both")
    keys = _read_keys(add.path)
    if not keys:
        raise InvalidError(f"{add.path} names no place; give [[SECOND, X, Y, Z], ...]")
    return keys


def run_audio(config: Audio) -> str:
    """Does what `config` says; gives a line about it."""
    from .streamtracks import add_sound, extract_sound, remove_sound  # PyAV loads slowly

    match config.audio:
        case Add(stream=stream, file=file, name=name) as add:
            keys = _keys(add)
            source = SoundSource(name, 1 if keys else 2, keys)
            size_bytes = add_sound(stream, file, source, add.bitrate_bps, add.offset_s)
            return f"{stream}: sound {name}, {size_bytes} bytes"
        case Remove(stream=stream, name=name):
            remove_sound(stream, name)
            return f"{stream}: sound {name} is removed"
        case Extract(stream=place, out=out, name=name):
            return f"{out}: {extract_sound(place, out, name)} samples"
