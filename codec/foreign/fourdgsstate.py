"""The Gaussians of a .4dgs file at one time, as integers on its grids: keyframes give all of them,
deltas what changes against a state before.

A delta says who dies, how the integers of others change, and who is born. It adds to integers, so
errors do not grow. A rotation is given anew: which component is left out may change.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from codec.errors import CorruptError

from .bytecursor import ByteCursor
from .fourdgsrecords import (
    BIN,
    CHANNELS,
    DELTA_HEAD,
    FLAGS,
    ID,
    KEYFRAME_HEAD,
    LARGEST,
    ROTATION,
    SIGMA,
    WINDOW,
    Span,
    StateRecord,
    Streams,
    band_channels,
    read_block,
    read_content,
    read_stream,
    read_streams,
)
from .limits import check_count, check_ratio
from .packed import Ints

NEEDED = CHANNELS.keys() - {ID}
FIXED = {SIGMA, FLAGS, WINDOW}
"""The grids of a Gaussian depend on these, so a delta cannot change them."""
GIVEN_ANEW = {LARGEST, ROTATION}
ROW_BYTES = 4 * sum(CHANNELS.values())
FIRST_BAND = 100
"""The column of the harmonics of band b is FIRST_BAND + b."""

Columns = dict[int, npt.NDArray[np.int32]]


@dataclass(frozen=True, slots=True)
class State:
    """The integers of all Gaussians, in the order in which they were given."""

    ids: Ints  # (N,)
    columns: Columns  # (N, channels) of each attribute

    def __len__(self) -> int:
        return len(self.ids)

    def places(self, ids: Ints, what: str) -> npt.NDArray[np.intp]:
        """(n,) the rows of `ids`. Raises CorruptError for one that there is not."""
        order = np.argsort(self.ids)
        at = np.searchsorted(self.ids, ids, sorter=order)
        rows = order[np.minimum(at, len(order) - 1)] if len(order) else at
        if len(ids) and (not len(order) or (self.ids[rows] != ids).any()):
            raise CorruptError(f"{what}: names a Gaussian that is not there")
        return rows


def _bins(numbers: Ints, what: str) -> npt.NDArray[np.int32]:
    if numbers.size and (numbers.min() < BIN.min or numbers.max() > BIN.max):
        raise CorruptError(f"{what}: a number of more than 32 bits")
    return numbers.astype(np.int32)


def _whole(
    block: bytes | memoryview, count: int, bands: list[tuple[int, Ints]], what: str
) -> State:
    """The `count` Gaussians that `block` gives whole."""
    ids, streams = read_streams(block, count, what)
    if count and (missing := NEEDED - streams.keys()):
        raise CorruptError(f"{what}: attribute {min(missing)} is missing")
    columns = {kind: _bins(numbers, what) for kind, numbers in streams.items()}
    if not count:
        columns = {kind: np.zeros((0, CHANNELS[kind]), np.int32) for kind in NEEDED}
    columns |= {FIRST_BAND + band: _bins(numbers, what) for band, numbers in bands}
    return State(ids, columns)


def _read_bands(path: Path, spans: list[Span], count: int, degree: int) -> list[tuple[int, Ints]]:
    """The harmonics, band by band, of `count` Gaussians."""
    bands = []
    for number, span in enumerate(spans[:degree], 1):
        what = f".4dgs: harmonics at {span.offset}"
        cursor = read_content(path, span, what)
        (band,) = cursor.fields(struct.Struct("<B"))
        if band != number:
            raise CorruptError(f"{what}: of band {band}, not {number}")
        numbers = read_stream(cursor, count, band_channels(band), what)[1]
        if numbers.size and (numbers.min() < 0 or numbers.max() > 255):
            raise CorruptError(f"{what}: a number of more than 8 bits")
        bands.append((band, numbers))
    if len(bands) < degree and count:
        raise CorruptError(f".4dgs: {len(bands)} bands of harmonics, not {degree}")
    for band in range(len(bands) + 1, degree + 1):
        bands.append((band, np.zeros((0, band_channels(band)), np.int64)))
    return bands


def read_keyframe(path: Path, record: StateRecord, degree: int, max_gaussians: int) -> State:
    """The state of a keyframe. Raises CorruptError, or UnsupportedError, also for more than
    `max_gaussians`."""
    what = f".4dgs: keyframe at {record.offset}"
    cursor = read_content(path, record.content, what)
    count = cursor.fields(KEYFRAME_HEAD)[3]
    check_count(what, count, max_gaussians)
    check_ratio(what, count * ROW_BYTES, record.content.num_bytes)
    bands = _read_bands(path, record.bands, count, degree)
    return _whole(read_block(cursor, what), count, bands, what)


def read_delta(
    path: Path, record: StateRecord, before: State, degree: int, max_gaussians: int
) -> State:
    """The state after a delta on `before`. Raises CorruptError, or UnsupportedError, also for more
    than `max_gaussians`."""
    what = f".4dgs: delta at {record.offset}"
    cursor = read_content(path, record.content, what)
    updates, births, deaths = cursor.fields(DELTA_HEAD)[7:]
    if max(updates, deaths) > len(before):
        raise CorruptError(f"{what}: changes more than the {len(before)} Gaussians there are")
    check_count(what, len(before) - deaths + births, max_gaussians)
    check_ratio(what, births * ROW_BYTES, record.content.num_bytes)
    groups = ByteCursor(read_block(cursor, what), what)
    update_block, birth_block, death_block = (groups.block() for _ in range(3))
    dead, others = read_streams(death_block, deaths, f"{what}: deaths")
    if others:
        raise CorruptError(f"{what}: deaths with attributes")
    changed, changes = read_streams(update_block, updates, f"{what}: updates")
    bands = _read_bands(path, record.bands, births, degree)
    born = _whole(birth_block, births, bands, f"{what}: births")
    rows = before.places(dead, what)
    kept = np.ones(len(before), np.bool_)
    kept[rows] = False
    state = State(before.ids[kept], {k: v[kept] for k, v in before.columns.items()})
    _change(state, changed, changes, what)
    if np.isin(born.ids, state.ids).any():
        raise CorruptError(f"{what}: a Gaussian is born that is there already")
    return State(
        np.concatenate([state.ids, born.ids]),
        {k: np.concatenate([v, born.columns[k]]) for k, v in state.columns.items()},
    )


def _change(state: State, ids: Ints, changes: Streams, what: str) -> None:
    """Alters the columns of `state`, which nothing else refers to."""
    if changes.keys() & FIXED or len(changes.keys() & GIVEN_ANEW) == 1:
        raise CorruptError(f"{what}: changes an attribute that cannot be changed by itself")
    rows = state.places(ids, what)
    for kind, numbers in changes.items():
        column = state.columns[kind]
        column[rows] = _bins(numbers if kind in GIVEN_ANEW else column[rows] + numbers, what)
