"""A play of two frames that nobody sees: whatever a real one runs is loaded, or compiled, by it.

It comes before the first request. Otherwise the first decode takes half a second, half a minute
after an install, from the thread that reads the socket, and a server sees a slow link.
"""

from __future__ import annotations

import logging
from contextlib import closing

import numpy as np
from rich.console import Console

from codec.camera import Camera
from codec.errors import CodecError
from codec.profiles.profile import Profile
from codec.slice import Slice
from codec.slots.lattice import Lattice, States, quantise
from codec.slots.slotencoder import SlotEncoder
from codec.slots.update import NEW, PREDICTED, Update
from codec.splats import Splats
from codec.stream.chunk import encode_chunk
from codec.stream.manifest import SLOTS_VERSION, Manifest, Part
from codec.stream.object import encode_packet
from player.playout.assembler import open_assembler
from player.render.gl import GlError, create_renderer
from player.render.renderer import GlVersion, RendererKind
from player.source.source import Packets, SlicePackets, SnapshotPackets

log = logging.getLogger(__name__)

_SWIN_SIZE, _SLICE_SIZE, _SIZE_PX = 2, 4, 32
_CAMERA = Camera("front", _SIZE_PX, _SIZE_PX, 30.0, 30.0, 16.0, 16.0, np.eye(4))


def rehearse(kind: RendererKind, version: GlVersion = GlVersion.AUTO) -> RendererKind:
    """Makes everything ready that decodes and draws with `kind`; gives the renderer that works.

    AUTO becomes GL, or CPU where OpenGL cannot start, which is logged. Raises GlError where OpenGL
    is asked for and cannot start.
    """
    # After an install all of it is compiled.
    with Console(stderr=True).status("preparing the renderer ..."):
        if kind is RendererKind.CPU:
            return _play(RendererKind.CPU, version)
        try:
            return _play(RendererKind.GL, version)
        except GlError as error:
            if kind is RendererKind.GL or version is not GlVersion.AUTO:
                raise
            log.warning("drawing on the CPU: %s", error)
            return _play(RendererKind.CPU, version)


def _play(kind: RendererKind, version: GlVersion) -> RendererKind:
    splats = _some_splats()
    for manifest, packets in (_whole_slices(splats), _slots(splats)):
        with closing(create_renderer(kind, manifest, version)) as renderer:
            assembler = open_assembler(manifest, 1, 0)
            for frame in range(2):
                due = [one for one in packets if max(0, one.first_frame) == frame]
                for slice in assembler.take(frame, due):
                    renderer.put(slice)
                renderer.render(frame, _CAMERA)
    return kind


def _some_splats() -> Splats:
    rng = np.random.default_rng(0)
    arrays = (
        rng.uniform((-0.5, -0.5, 3), (0.5, 0.5, 4), (_SLICE_SIZE, 3)),
        np.full((_SLICE_SIZE, 3), -2.0),
        rng.normal(size=(_SLICE_SIZE, 4)),
        np.full(_SLICE_SIZE, 2.0),
        rng.normal(size=(_SLICE_SIZE, 4, 3)),
    )
    return Splats(*(array.astype(np.float32) for array in arrays))


def _manifest(**changes: object) -> Manifest:
    values: dict[str, object] = {
        "fps": 30.0,
        "swin_size": _SWIN_SIZE,
        "num_gs": _SWIN_SIZE * _SLICE_SIZE,
        "layers": (1.0,),
        "segment_frames": 4,
        "sh_degree": 1,
        "profile": Profile.COMPACT,
        "antialias": False,
        "near_m": 0.1,
        "bounds": ((-1.0, -1.0, 2.0), (1.0, 1.0, 5.0)),
        "cameras": (_CAMERA,),
        "default_camera": _CAMERA.name,
        "live": False,
    }
    return Manifest(**(values | changes))  # type: ignore[arg-type]


def _blame(error: CodecError, part: Part) -> CodecError:
    return error


def _whole_slices(splats: Splats) -> tuple[Manifest, list[Packets]]:
    """A stream of version 1."""
    packets: list[Packets] = []
    for birth in range(1 - _SWIN_SIZE, 2):
        made = Slice(birth, splats, np.zeros(len(splats), np.uint8))
        packet = encode_packet(encode_chunk(made, 0, Profile.COMPACT))
        packets.append(SlicePackets(birth, 0, (packet,), None, _blame))
    return _manifest(), packets


def _slots(splats: Splats) -> tuple[Manifest, list[Packets]]:
    """A stream of version 2: new, predicted and kept."""
    lattice = Lattice.suiting(splats)
    manifest = _manifest(
        version=SLOTS_VERSION, profile=Profile.LATTICE, slots=(_SLICE_SIZE,), lattice=(lattice,)
    )
    states, _ = quantise(splats, lattice)
    encoder, packets = SlotEncoder(manifest.slot_layout), list[Packets]()
    for birth in range(1 - _SWIN_SIZE, 2):
        encoded = encoder.append(_update(birth, states))
        if birth == 0:
            snapshot = encode_packet(encoder.snapshots()[0])
            packets.append(SnapshotPackets(0, 0, (snapshot,), _blame))
        elif encoded is not None:
            change, mask = encode_packet(encoded.changes[0]), encode_packet(encoded.mask)
            packets.append(SlicePackets(birth, 0, (change,), mask, _blame))
    return manifest, packets


def _update(birth: int, states: States) -> Update:
    statuses = np.full(_SLICE_SIZE, NEW, np.uint8)
    if birth > 0:
        statuses[:] = (NEW, PREDICTED, PREDICTED, 0)
    coded = np.flatnonzero(statuses)
    nothing = np.zeros(len(coded), np.uint8)
    return Update(
        birth, statuses, states.take(coded), nothing, nothing.astype(np.bool_), Splats.empty(1)
    )
