"""The subcommands `import` and `export` of swings-stream."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from codec.errors import InvalidError
from codec.foreign.spz import SpzVersion
from codec.interop.exporting import export_stream
from codec.interop.formats import SplatFormat
from codec.interop.importing import ImportOptions, import_stream
from codec.stream.poster import Draw

from .static import export_static


@dataclass(frozen=True, slots=True)
class Import:
    """Make a stream from a file of Gaussians, or from a folder with a numbered file for each
    frame."""

    input: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="INPUT")]]
    """A .ply, compressed .ply, .spz, .splat, bundled .sog, .glb or .gltf file, or a folder of them,
    sorted by number."""
    stream: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="STREAM")]]
    """Folder of the new stream."""
    options: Annotated[ImportOptions, tyro.conf.arg(name="")] = field(default_factory=ImportOptions)


@dataclass(frozen=True, slots=True)
class Export:
    """Write what a frame shows, or a range of frames, to files that other programs read; or, with
    --static, the whole stream to a folder for plain web servers."""

    stream: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="STREAM")]]
    """Folder of the stream, or its URL in an object store, as s3://BUCKET/PATH."""
    out: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="OUT")]]
    """The file; with --frames the name of the sequence, to which each frame's number is added:
    `name.ply` gives name_0000.ply ...; with --static the folder."""
    frame: int | None = None
    """The frame, from 0 on."""
    frames: str | None = None
    """Frames A to B - 1, as A:B; A: and :B go to the ends."""
    format: SplatFormat | None = None
    """ply is exact, sog and spz small; glb and gltf are glTF with KHR_gaussian_splatting; splat is
    for simple viewers. By default what OUT ends with. docs/FORMATS.md says what each keeps."""
    spz_version: SpzVersion | None = None
    """Of spz: 2 or 3 are for older programs; by default 4."""
    layers: int | None = None
    """Most important layers to write; all by default."""
    static: bool = False
    """Write all of the stream, coded so that browsers inflate it by themselves (gzip)."""


def import_files(config: Import, draw: Draw | None = None) -> str:
    """Does what `config` says; gives a line about it. draw: for the poster."""
    made = import_stream(config.input, config.stream, config.options, draw)
    return (
        f"{config.stream}: {made.title}, up to {made.num_gs} Gaussians a frame, "
        f"SH degree {made.sh_degree}, {made.profile}"
    )


def export_files(config: Export) -> str:
    """Does what `config` says; gives a line about it."""
    if config.static:
        return _export_static(config)
    written = export_stream(
        config.stream,
        config.out,
        config.frame,
        config.frames,
        config.format,
        config.layers,
        config.spz_version,
    )
    files = str(written[0]) if len(written) == 1 else f"{written[0]} .. {written[-1].name}"
    total_bytes = sum(path.stat().st_size for path in written)
    noun = "file" if len(written) == 1 else "files"
    return f"{files}: {len(written)} {noun}, {total_bytes} bytes"


def _export_static(config: Export) -> str:
    chosen = (config.frame, config.frames, config.format, config.layers, config.spz_version)
    if chosen != (None,) * 5:
        raise InvalidError("--static writes the whole stream; leave out what is for frames")
    made = export_static(config.stream, config.out)
    share = 100 * made.size_bytes / made.source_bytes
    return (
        f"{config.out}: {made.num_frames} frames in {made.num_segments} segments for any web "
        f"server, {made.size_bytes} bytes, {share:.1f} % of the {made.source_bytes} of "
        f"{config.stream}"
    )
