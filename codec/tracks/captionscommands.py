"""The subcommands of swings-stream captions."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from codec.stream.captions import Captions as Language

from .streamtracks import add_captions, remove_captions

Folder = tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="STREAM")]]


@dataclass(frozen=True, slots=True)
class Add:
    """Add captions to a finished stream, or replace those of the same language."""

    stream: Folder
    """Folder of the stream; a .swings file must be unpacked first."""
    file: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="FILE.vtt")]]
    """WebVTT, whose times count from frame 0."""
    language: str = "en"
    """Language as BCP 47 writes it, such as en or pt-BR."""
    label: str = ""
    """Name that viewers choose, such as English; by default the language."""


@dataclass(frozen=True, slots=True)
class Remove:
    """Remove captions from a finished stream."""

    stream: Folder
    """Folder of the stream."""
    language: str = "en"
    """Language of the captions to remove, as BCP 47 writes it."""


@dataclass(frozen=True, slots=True)
class Captions:
    """The captions of a stream: add, remove."""

    captions: Annotated[Add | Remove, tyro.conf.arg(name="")]


def run_captions(config: Captions) -> str:
    """Runs the subcommand that `config` describes; gives the line to print."""
    match config.captions:
        case Add(stream=stream, file=file, language=language, label=label):
            count = add_captions(stream, file, Language(language, label or language))
            return f"{stream}: captions {language}, {count} cues"
        case Remove(stream=stream, language=language):
            remove_captions(stream, language)
            return f"{stream}: captions {language} are removed"
