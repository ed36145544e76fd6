"""The subcommands of swings-stream edit."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from codec.edit.cut import join_streams, trim_stream
from codec.edit.filters import CropOptions, FloaterOptions
from codec.edit.rewrite import Edited, edit_stream
from codec.edit.transform import TransformOptions
from codec.edit.walk import ViewOptions
from codec.framerange import FRAMES, FrameRange
from codec.outputlock import writing_alone
from codec.progressline import counted
from codec.stream.pictures import Draw
from codec.stream.reader import DEFAULT_MAX_GAUSSIANS

Source = tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="STREAM")]]
Target = tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="OUT")]]


@dataclass(frozen=True, slots=True)
class _Job:
    """The options that all edits share."""

    stream: Source
    """Folder of the stream, or its URL in an object store, such as s3://BUCKET/PATH."""
    out: Target
    """Folder of the new stream."""
    max_gaussians: int = field(default=DEFAULT_MAX_GAUSSIANS, kw_only=True)
    """Largest number of Gaussians a frame; a stream with more is refused."""


@dataclass(frozen=True, slots=True)
class Crop(_Job):
    """Keep only the Gaussians whose centres lie in a region, frame by frame."""

    options: Annotated[CropOptions, tyro.conf.arg(name="")] = field(default_factory=CropOptions)
    preview: Annotated[Path | None, tyro.conf.arg(metavar="PNG")] = None
    """Only draw what stays and what goes in frame 0, with axes in metres, as a picture at this
    path; nothing is written to OUT."""


@dataclass(frozen=True, slots=True)
class Transform(_Job):
    """Scale, turn and move the scene; cameras, bounds and near plane go along."""

    options: Annotated[TransformOptions, tyro.conf.arg(name="")] = field(
        default_factory=TransformOptions
    )


@dataclass(frozen=True, slots=True)
class Floaters(_Job):
    """Remove the Gaussians that too few cameras see at any time of their life."""

    options: Annotated[FloaterOptions, tyro.conf.arg(name="")] = field(
        default_factory=FloaterOptions
    )


@dataclass(frozen=True, slots=True)
class View(_Job):
    """Choose the view that the stream opens with, which its poster shows as well, or its title.
    Segments are copied byte for byte."""

    options: Annotated[ViewOptions, tyro.conf.arg(name="")] = field(default_factory=ViewOptions)


@dataclass(frozen=True, slots=True)
class Trim(_Job):
    """Keep a range of frames. Segments whose frames keep their numbers are copied byte for byte."""

    frames: Annotated[FrameRange, FRAMES]
    """Range of frames A:B, A included, B not; A: runs to the last frame, :B begins at frame 0."""


@dataclass(frozen=True, slots=True)
class Join(_Job):
    """Put streams of the same layout one after another, with the cameras and title of STREAM."""

    then: Annotated[tuple[str, ...], tyro.conf.arg(metavar="STREAM [STREAM ...]")]
    """The streams that follow, in order. They must agree with the first in frame rate, slots,
    lattice, segments and SH degree, as parts and edits of one stream do."""


Edits = Crop | Transform | Floaters | View | Trim | Join


@dataclass(frozen=True, slots=True)
class Edit:
    """Edit a whole stream without training: crop, transform, floaters, view, trim, join."""

    edit: Annotated[Edits, tyro.conf.arg(name="")]


def run_edit(config: Edit, draw: Draw | None = None) -> str:
    """Does what `config` says; gives lines about it. draw: for poster and storyboard."""
    edit = config.edit
    if isinstance(edit, Crop) and edit.preview is not None:
        from .croppreview import draw_crop  # matplotlib loads slowly

        kept, total = draw_crop(edit.stream, edit.options, edit.preview, edit.max_gaussians)
        return f"{edit.preview}: {kept} of {total} Gaussians would stay in frame 0"
    with writing_alone(edit.out), counted("editing") as progress:
        match edit:
            case Trim(frames=frames):
                made = trim_stream(
                    edit.stream, edit.out, frames, draw, progress, edit.max_gaussians
                )
            case Join(then=then):
                streams = (edit.stream, *then)
                made = join_streams(streams, edit.out, draw, progress, edit.max_gaussians)
            case _:
                made = edit_stream(
                    edit.stream, edit.out, edit.options, draw, progress, edit.max_gaussians
                )
    return _describe(edit.out, made)


def _describe(out: Path, made: Edited) -> str:
    share = 100 * made.size_bytes / made.source_bytes
    noun = "segment" if made.num_segments == 1 else "segments"
    copied = f"{made.num_copied} copied byte for byte"
    if made.num_renumbered:
        copied += f", {made.num_renumbered} with new frame numbers"
    lines = [
        f"{out}: {made.num_frames} frames in {made.num_segments} {noun}, {copied}",
        f"size         {made.size_bytes} bytes, {share:.1f} % of {made.source_bytes}",
        *made.notes,
    ]
    return "\n".join(lines)
