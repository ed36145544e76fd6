"""The state that one worker leaves in storage for the next, as bytes."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import numpy.typing as npt

from codec.stream.manifest import MANIFEST_NAME
from trainer.fit.trainer import Trainer
from trainer.lease.takeover import PlayerState

from .task import STATE_FOLDER

Arrays = dict[str, npt.NDArray[Any]]

MAX_STATE_BYTES = 1 << 34
"""Largest accepted file: tens of millions of Gaussians."""

MANIFEST_PATH = f"{STATE_FOLDER}/{MANIFEST_NAME}"
"""The stream's manifest as genesis leaves it."""


def pack_arrays(arrays: Arrays) -> bytes:
    """The opposite of `unpack_arrays`. The same arrays give the same bytes."""
    file = io.BytesIO()
    np.savez(file, **arrays)  # type: ignore[arg-type]  # its stub takes the names for options
    return file.getvalue()


def unpack_arrays(data: bytes) -> Arrays:
    with np.load(io.BytesIO(data), allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def with_prefix(name: str | int, arrays: Arrays) -> Arrays:
    """`arrays` with the prefix `name` on each key."""
    return {f"{name}.{key}": array for key, array in arrays.items()}


def without_prefix(name: str | int, arrays: Arrays) -> Arrays:
    """The arrays whose keys have the prefix `name`, without it; the opposite of `with_prefix`."""
    start = f"{name}."
    return {k.removeprefix(start): v for k, v in arrays.items() if k.startswith(start)}


def part_state(trainer: Trainer, held: PlayerState) -> Arrays:
    """The state of a trainer, and that of a player which has received all its slices."""
    return {**with_prefix("state", trainer.state()), **with_prefix("held", held.to_arrays())}


def player_state_in(arrays: Arrays) -> PlayerState:
    """The player's state in the arrays of `part_state`."""
    return PlayerState.from_arrays(without_prefix("held", arrays))
