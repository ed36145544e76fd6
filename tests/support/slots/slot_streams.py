"""Small streams of version 2 on disk, and what a player shows of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from codec.profiles.profile import Profile
from codec.slice import Slice
from codec.slots.slotlayout import SlotLayout
from codec.splats import Splats
from codec.stream import StreamWriter
from codec.stream.manifest import SLOTS_VERSION, Manifest
from player.render.ring import Ring
from tests.support.hosted_streams import small_manifest
from tests.support.slots.updates import patternless_updates, small_layout


def slot_manifest(layout: SlotLayout, **changes: object) -> Manifest:
    """A manifest of streams with the slots of `layout`."""
    values: dict[str, object] = {
        "swin_size": layout.swin_size,
        "num_gs": layout.swin_size * layout.num_slots,
        "layers": (1.0,),
        "segment_frames": layout.segment_frames,
        "profile": Profile.LATTICE,
        "version": SLOTS_VERSION,
        "slots": layout.slots,
        "lattice": layout.lattices,
    }
    return small_manifest(1, layout.sh_degree, **(values | changes))  # type: ignore[arg-type]


def write_slot_stream(
    path: Path,
    num_frames: int,
    layout: SlotLayout | None = None,
    seed: int = 0,
    **changes: object,
) -> Path:
    """A finished stream at `path`, without a pattern. changes: of the manifest."""
    layout = small_layout() if layout is None else layout
    with StreamWriter.create(path, slot_manifest(layout, **changes)) as writer:
        for update in patternless_updates(layout, num_frames, seed):
            writer.append(update)
    return path


class Shown:
    """A player's lanes, by the rules of slices alone."""

    def __init__(self, manifest: Manifest) -> None:
        self._ring = Ring(manifest.swin_size, manifest.slice_size, manifest.sh_degree)

    def after(self, slices: Iterable[Slice], frame: int) -> Splats:
        """What shows at `frame` once `slices`, too, have come."""
        for slice in slices:
            self._ring.put(slice)
        return self._ring.active(frame)


def same_splats(a: Splats, b: Splats) -> bool:
    """Whether two sets of Gaussians have the same bits in the same order."""
    return all(x.tobytes() == y.tobytes() for x, y in zip(a.arrays, b.arrays, strict=True))


def gaussians(splats: Splats) -> Counter[bytes]:
    """How often each Gaussian is there."""
    rows = (b"".join(array[i].tobytes() for array in splats.arrays) for i in range(len(splats)))
    return Counter(rows)
