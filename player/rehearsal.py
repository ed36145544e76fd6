"""An unseen play of two frames: it loads, or compiles, all that a real play runs.

It comes before the first request. Otherwise the first decode takes half a second, half a minute
after an install, from the thread that reads the socket, and a server sees a slow link.
"""

from __future__ import annotations

from contextlib import closing
from functools import partial
from pathlib import Path

from rich.console import Console

from codec.framerange import FrameRange
from codec.kernel import load_without_blas
from player.playout.assembler import Assembler
from player.render.gl import create_renderer, with_what_works
from player.render.renderer import GlVersion, RendererKind
from player.source.directory import DirectorySource

STREAM = Path(__file__).with_name("rehearsed")
"""A small stream; tests/goldens/rehearsed_stream.py writes it."""


def rehearse(kind: RendererKind, version: GlVersion = GlVersion.AUTO) -> RendererKind:
    """Makes everything ready that decodes and draws with `kind`; gives the renderer that works.

    See `with_what_works`.
    """
    # After an install all of it is compiled.
    with Console(stderr=True).status("preparing the renderer ..."):
        return with_what_works(kind, version, partial(_play, version))


def _play(version: GlVersion, kind: RendererKind) -> RendererKind:
    load_without_blas()
    source = DirectorySource(STREAM, FrameRange(), None)
    manifest, packets = source.manifest, list(source.packets())
    with closing(create_renderer(kind, manifest, version)) as renderer:
        assembler = Assembler(manifest, source.num_layers, 0)
        for frame in range(source.num_frames):
            due = [one for one in packets if one.first_frame == frame]
            for slice in assembler.assemble(frame, due):
                renderer.put(slice)
            renderer.render(frame, manifest.cameras[0])
    return kind
