"""What workers leave for each other, as bytes."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import numpy.typing as npt

from codec.stream.manifest import MANIFEST_NAME
from trainer.fit.trainer import Trainer
from trainer.lease.takeover import Held

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


def under(name: str | int, arrays: Arrays) -> Arrays:
    """With `name` before each of their own."""
    return {f"{name}.{key}": array for key, array in arrays.items()}


def below(name: str | int, arrays: Arrays) -> Arrays:
    """The opposite of `under`."""
    start = f"{name}."
    return {k.removeprefix(start): v for k, v in arrays.items() if k.startswith(start)}


def standing(trainer: Trainer, held: Held) -> Arrays:
    """Where a trainer stands, and what a player holds there."""
    return {**under("state", trainer.state()), **under("held", held.to_arrays())}


def held_in(arrays: Arrays) -> Held:
    """What a player holds where a trainer stands."""
    return Held.from_arrays(below("held", arrays))
