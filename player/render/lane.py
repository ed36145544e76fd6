"""The check that a slice fits its lane, the place of slice_size Gaussians."""

from __future__ import annotations

from codec.errors import InvalidError
from codec.slice import Slice


def check_slice(slice: Slice, slice_size: int, sh_degree: int) -> None:
    """Raises InvalidError unless `slice` fits a lane of `slice_size` Gaussians of `sh_degree`."""
    if len(slice.splats) > slice_size:
        raise InvalidError(
            f"the slice born at {slice.birth} has {len(slice.splats)} Gaussians; "
            f"a lane holds {slice_size}"
        )
    if slice.rows is not None and len(slice.rows) and slice.rows[-1] >= slice_size:
        raise InvalidError(
            f"the slice born at {slice.birth} changes row {slice.rows[-1]}; "
            f"a lane has {slice_size} rows"
        )
    if slice.splats.sh_degree != sh_degree:
        raise InvalidError(
            f"the slice born at {slice.birth} has SH degree {slice.splats.sh_degree}, "
            f"the stream has {sh_degree}"
        )
