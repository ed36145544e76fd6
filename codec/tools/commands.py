"""The subcommands of swings-stream, and what `import` and `export` do."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
import tyro

from codec.console import interruptible
from codec.errors import InvalidError
from codec.foreign.spz import SpzVersion
from codec.helptext import Groups
from codec.interop.formats import SequenceFormat, SplatFormat, export_stream
from codec.outputlock import writing_alone
from codec.progressline import counted
from codec.sequence.following import FollowOptions, follow_folder
from codec.sequence.importing import Imported, ImportOptions, import_stream
from codec.stream.pictures import Draw
from codec.stream.reader import DEFAULT_MAX_GAUSSIANS
from codec.stream.streampacker import pack_stream, unpack_stream

from .static import export_static

Stream = Annotated[str, tyro.conf.arg(metavar="STREAM")]


@dataclass(frozen=True, slots=True)
class Info:
    """Describe a stream from its manifest, index and skip maps."""

    stream: tyro.conf.Positional[Stream]
    """Folder of the stream, its .swings file, or the URL of either in an object store, such as
    s3://BUCKET/PATH."""
    json: bool = False
    """Print one JSON object instead of text."""
    plot: Annotated[Path | None, tyro.conf.arg(metavar="PNG")] = None
    """Also draw bitrate per layer and quality over time, as a picture at this path."""
    max_gaussians: int = DEFAULT_MAX_GAUSSIANS
    """Largest number of Gaussians a frame; a stream with more is refused, because a few kilobytes
    of file can ask for gigabytes of memory."""


@dataclass(frozen=True, slots=True)
class Verify:
    """Read, check and decode every byte of a stream; name the first wrong file and byte."""

    stream: tyro.conf.Positional[Stream]
    """Folder of the stream, its .swings file, or the URL of either in an object store, such as
    s3://BUCKET/PATH."""
    max_gaussians: int = DEFAULT_MAX_GAUSSIANS
    """Largest number of Gaussians a frame; a stream with more is refused, because a few kilobytes
    of file can ask for gigabytes of memory."""


@dataclass(frozen=True, slots=True)
class Import:
    """Make a stream from a file of Gaussians, a file of a whole sequence, or a folder with one
    numbered file per frame; with --follow a live stream from a folder that is still being
    written."""

    EVERYDAY: ClassVar[Groups] = {
        "Files": ("fps", "frames"),
        "Stream": ("title", "layers", "sh-degree", "exact"),
        "Live": ("follow", "resume", "live.segment-s", "live.end-after-s"),
    }

    input: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="INPUT")]]
    """A .ply, compressed .ply, .spz, .splat, .ksplat, .sog, .glb or .gltf file, the folder of an
    unbundled SOG, or a folder of such models, one per frame, sorted by number; or a sequence in one
    .tsog file."""
    stream: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="STREAM")]]
    """Folder of the new stream."""
    follow: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Write a live stream while files still come into the folder INPUT. Ctrl-C finishes the
    stream; a stream that a signal or an error ended stays live, for --resume."""
    resume: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """With --follow: go on with the live stream at STREAM, after its last finished segment."""
    options: Annotated[ImportOptions, tyro.conf.arg(name="")] = field(default_factory=ImportOptions)
    live: FollowOptions = field(default_factory=FollowOptions)

    def __post_init__(self) -> None:
        if not self.follow and (self.resume or self.live != FollowOptions()):
            raise InvalidError("--resume and --live need --follow")


@dataclass(frozen=True, slots=True)
class Export:
    """Write one frame or a range of frames to files that other programs read, a sequence to one
    file, or, with --static, the whole stream to a folder for plain web servers."""

    stream: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="STREAM")]]
    """Folder of the stream, its .swings file, or the URL of either in an object store, such as
    s3://BUCKET/PATH."""
    out: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="OUT")]]
    """Output file. With --frames, one numbered file for each frame: `name.ply` gives name_0000.ply
    and so on; a .tsog file holds them all. With --static, the output folder."""
    frame: int | None = None
    """Number of the frame, from 0 on."""
    frames: Annotated[str | None, tyro.conf.arg(metavar="A:B")] = None
    """Range of frames A:B, A included, B not; A: runs to the last frame, :B begins at frame 0."""
    format: SplatFormat | SequenceFormat | None = None
    """File format; by default the one that OUT ends with. ply is exact; sog and spz are small; glb
    and gltf are glTF with KHR_gaussian_splatting; splat is for simple viewers. tsog holds a
    whole sequence. docs/FORMATS.md lists what each format keeps."""
    spz_version: SpzVersion | None = None
    """Version of the spz format; 3 by default. Few programs read 4 yet; some need 2."""
    layers: int | None = None
    """Number of layers to write, most important first; all by default."""
    static: bool = False
    """Write the whole stream, finished, to a folder."""
    page: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """With --static: also write index.html and the browser player into OUT, a folder that plays the
    stream from any web server."""
    max_gaussians: int = DEFAULT_MAX_GAUSSIANS
    """Largest number of Gaussians a frame; a stream with more is refused, because a few kilobytes
    of file can ask for gigabytes of memory."""


@dataclass(frozen=True, slots=True)
class Pack:
    """Write a finished stream as one .swings file, which players read in place and any ZIP program
    opens. Nothing of the stream changes."""

    stream: tyro.conf.Positional[Stream]
    """Folder of the stream, or its URL in an object store, such as s3://BUCKET/PATH."""
    out: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="OUT.swings")]]
    """File to write."""


@dataclass(frozen=True, slots=True)
class Unpack:
    """Write the files of a .swings file to a folder: the stream that was packed, byte for byte."""

    packed: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="FILE.swings")]]
    """File made by pack, or its URL in an object store, such as s3://BUCKET/PATH."""
    out: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="OUT")]]
    """Folder of the stream, absent or empty."""


def import_files(config: Import, draw: Draw | None = None) -> str:
    """Does what `config` says; gives lines about it. draw: for the poster and PSNR."""
    if config.follow:
        return _follow_files(config, draw)
    with counted(f"importing {config.input.name}") as progress:
        made = import_stream(config.input, config.stream, config.options, draw, progress)
    manifest = made.manifest
    a_frame = made.played_bytes / made.num_frames
    lines = [
        f"{config.stream}: {manifest.title}, up to {manifest.num_gs} Gaussians a frame, "
        f"SH degree {manifest.sh_degree}"
    ]
    lines.append(
        f"frames       {made.num_frames} at {manifest.fps:g} a second; {made.num_bytes} bytes, "
        f"{made.played_bytes} of them to play all, {a_frame:.0f} a frame"
    )
    lines += _slot_lines(made)
    if made.scores_db:
        means = np.mean(made.scores_db, axis=0)
        least = min(scores[-1] for scores in made.scores_db)
        told_db = ", ".join(f"{db:.1f}" for db in means)
        lines.append(
            f"PSNR         {told_db} dB with 1, 2, ... layers against the files, "
            f"at least {least:.1f} dB with all"
        )
        if made.source_sh_degree > manifest.sh_degree:
            lines.append(
                f"             the files at SH degree {made.source_sh_degree}, "
                f"the stream at {manifest.sh_degree}"
            )
    left_out = made.notes.left_out
    if left_out:
        lines.append(f"left out     {sum(left_out.values())} Gaussians, in {len(left_out)} frames")
    if made.notes.hint:
        lines.append(f"hint         {made.notes.hint}")
    return "\n".join(lines)


def _follow_files(config: Import, draw: Draw | None) -> str:
    config.stream.parent.mkdir(parents=True, exist_ok=True)
    with (
        writing_alone(config.stream),
        interruptible() as stop,
        counted(f"following {config.input.name}") as progress,
    ):
        made = follow_folder(
            config.input,
            config.stream,
            config.options,
            config.live,
            config.resume,
            stop,
            draw,
            progress,
        )
    manifest = made.manifest
    lines = [
        f"{config.stream}: {manifest.title}, finished with {made.num_frames} frames at "
        f"{manifest.fps:g} a second; {made.num_bytes} bytes"
    ]
    if made.median_delay_s is not None:
        lines.append(f"delay        {made.median_delay_s:.2f} s from a file to its segment, median")
    if made.troubles:
        lines.append(f"troubles     {made.troubles}")
    return "\n".join(lines)


def _slot_lines(made: Imported) -> list[str]:
    """Lines on the slots that were sent, and on their distance from the files."""
    position_m, size, turn, colour, opacity = made.errors.values()
    lines = [
        f"errors       at most: positions {position_m:.3g} m, sizes {100 * size:.1f} %, "
        f"turns {turn:.4f}, colours {colour:.3f}, opacities {opacity:.4f}"
    ]
    if made.num_escaped:
        lines.append(f"exact        {made.num_escaped} Gaussians at full precision")
    total = sum(made.statuses)
    if total:
        shares = [f"{100 * count / total:.1f} %" for count in made.statuses]
        names = "kept", "ended", "moved", "new"
        told_shares = ", ".join(
            f"{share} {name}" for share, name in zip(shares, names, strict=True)
        )
        lines.append(f"slots        {told_shares}, after the first frame")
    return lines


def export_files(config: Export) -> str:
    """Does what `config` says; gives a line about it."""
    if config.static:
        return _export_static(config)
    if config.page:
        raise InvalidError("--page needs --static")
    written = export_stream(
        config.stream,
        config.out,
        config.frame,
        config.frames,
        config.format,
        config.layers,
        config.spz_version,
        config.max_gaussians,
    )
    files = str(written[0]) if len(written) == 1 else f"{written[0]} .. {written[-1].name}"
    total_bytes = sum(path.stat().st_size for path in written)
    noun = "file" if len(written) == 1 else "files"
    return f"{files}: {len(written)} {noun}, {total_bytes} bytes"


def pack_files(config: Pack) -> str:
    """Does what `config` says; gives a line about it."""
    made = pack_stream(config.stream, config.out)
    return f"{config.out}: {made.num_frames} frames in one file, {made.size_bytes} bytes"


def unpack_files(config: Unpack) -> str:
    """Does what `config` says; gives a line about it."""
    made = unpack_stream(config.packed, config.out)
    return (
        f"{config.out}: {made.num_frames} frames in {made.num_files} files, {made.size_bytes} bytes"
    )


def _export_static(config: Export) -> str:
    chosen = (config.frame, config.frames, config.format, config.layers, config.spz_version)
    if chosen != (None,) * 5:
        raise InvalidError("--static writes the whole stream; leave out the options for frames")
    made = export_static(config.stream, config.out, config.max_gaussians, config.page)
    noun = "segment" if made.num_segments == 1 else "segments"
    return (
        f"{config.out}: {made.num_frames} frames in {made.num_segments} {noun} for any web "
        f"server, {made.objects_bytes} bytes of objects"
    )
