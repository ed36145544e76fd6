"""swings-stream: looks at a stream, edits and packs it; imports and exports Gaussians."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from functools import partial
from typing import Annotated

import tyro

from codec.stream.pictures import Draw
from codec.tools.audit import describe, summarise, verify_stream
from codec.tools.commands import (
    Export,
    Import,
    Info,
    Pack,
    Unpack,
    Verify,
    export_files,
    import_files,
    pack_files,
    unpack_files,
)
from codec.tools.editcommands import Edit, run_edit
from codec.tracks.captionscommands import Captions, run_captions
from codec.tracks.soundcommands import Audio, run_audio

from .console import run_command, say


@dataclass(frozen=True, slots=True)
class Command:
    """Which subcommand to run."""

    action: Annotated[
        Info | Verify | Import | Export | Edit | Pack | Unpack | Audio | Captions,
        tyro.conf.arg(name=""),
    ]


def run(command: Command, draw: Draw | None) -> None:
    match command.action:
        case Info(stream=path, json=as_json, plot=picture, max_gaussians=most):
            summary = summarise(path, most)
            if picture is not None:
                from codec.tools.plot import draw_stream  # matplotlib loads slowly

                draw_stream(path, picture)
            say(json.dumps(asdict(summary)) if as_json else describe(summary))
            if picture is not None and not as_json:
                say(f"picture      {picture}")
        case Verify(stream=path, max_gaussians=most):
            found = verify_stream(path, most)
            say(f"{path}: {found.num_frames} frames in {found.num_segments} segments are intact")
        case Import() as config:
            say(import_files(config, draw))
        case Export() as config:
            say(export_files(config))
        case Edit() as config:
            say(run_edit(config, draw))
        case Pack() as config:
            say(pack_files(config))
        case Unpack() as config:
            say(unpack_files(config))
        case Audio() as config:
            say(run_audio(config))
        case Captions() as config:
            say(run_captions(config))


def main(draw: Draw | None = None) -> None:
    """draw: for the poster of what is imported or edited; `player.streamcommand` hands it in."""
    what = "Inspects, edits and packs a stream; imports and exports Gaussians."
    run_command(Command, partial(run, draw=draw), "swings-stream", what)


if __name__ == "__main__":
    main()
