"""Everything that a training run needs to go on where it was killed.

Rule: a checkpoint is replaced as a whole after each window, so the newest one is always usable; a
run that resumes from it makes the same bytes as one that was never stopped.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from codec.errors import InvalidError
from codec.files import replacing
from codec.slice import Slice
from codec.slots.lattice import States
from codec.slots.update import Update
from codec.splats import ARRAY_NAMES, Splats
from trainer.errors import CheckpointError

CHECKPOINT_NAME = ".checkpoint.npz"
"""In the stream's folder; readers of a stream ignore names that begin with a dot."""

VERSION = 2

Arrays = dict[str, npt.NDArray[Any]]


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """A run between two windows."""

    state: Arrays
    """What `Trainer.state` gave."""
    pending: list[Slice | Update]
    """What has matured and may not be in a finished segment yet, in the order of birth."""


def _arrays_of(part: Slice | Update) -> Arrays:
    """All that `part` holds but its birth."""
    if isinstance(part, Slice):
        return {**_splat_arrays("splats", part.splats), "start_offsets": part.start_offsets}
    return {
        "statuses": part.statuses,
        "positions": part.states.positions,
        "attributes": part.states.attributes,
        "start_offsets": part.start_offsets,
        "escaped": part.escaped,
        **_splat_arrays("escapes", part.escapes),
    }


def _splat_arrays(name: str, splats: Splats) -> Arrays:
    return {f"{name}.{a}": array for a, array in zip(ARRAY_NAMES, splats.arrays, strict=True)}


def _part_of(birth: int, arrays: Arrays) -> Slice | Update:
    """The opposite of `_arrays_of`."""
    if "statuses" not in arrays:
        splats = Splats(*(arrays[f"splats.{name}"] for name in ARRAY_NAMES))
        return Slice(birth, splats, arrays["start_offsets"])
    return Update(
        birth,
        arrays["statuses"],
        States(arrays["positions"], arrays["attributes"]),
        arrays["start_offsets"],
        arrays["escaped"],
        Splats(*(arrays[f"escapes.{name}"] for name in ARRAY_NAMES)),
    )


def save_checkpoint(
    path: Path, state: Arrays, pending: Sequence[Slice | Update], settings: Mapping[str, Any]
) -> None:
    """Writes a checkpoint to `path`. settings: JSON that a resuming run must agree with."""
    arrays: Arrays = {f"state.{name}": array for name, array in state.items()}
    head = {"version": VERSION, "settings": settings, "births": [p.birth for p in pending]}
    arrays["head"] = np.frombuffer(json.dumps(head, sort_keys=True).encode(), np.uint8)
    for i, part in enumerate(pending):
        arrays |= {f"pending.{i}.{name}": array for name, array in _arrays_of(part).items()}
    # Opened here, because numpy would add .npz to the temporary name.
    with replacing(path) as temporary, open(temporary, "wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]  # its stub takes the names for options


def _named(arrays: Arrays, prefix: str) -> Arrays:
    """Those whose names begin with `prefix`, without it."""
    return {n.removeprefix(prefix): array for n, array in arrays.items() if n.startswith(prefix)}


def load_checkpoint(path: Path, settings: Mapping[str, Any]) -> Checkpoint:
    """The checkpoint at `path`.

    Raises CheckpointError when it is missing or damaged, InvalidError when it was made with other
    settings.
    """
    try:
        # Opened here, because numpy leaves a damaged file open.
        with open(path, "rb") as raw, np.load(raw, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        head = json.loads(arrays.pop("head").tobytes())
        if head["version"] != VERSION:
            raise CheckpointError(f"{path}: version {head['version']}, not {VERSION}")
        made_with = head["settings"]
        state = _named(arrays, "state.")
        pending = [
            _part_of(int(birth), _named(arrays, f"pending.{i}."))
            for i, birth in enumerate(head["births"])
        ]
    except FileNotFoundError as error:
        raise CheckpointError(
            f"{path} is missing: nothing to resume; train without --resume"
        ) from error
    except (ValueError, KeyError, TypeError, IndexError, EOFError, zipfile.BadZipFile) as error:
        raise CheckpointError(f"{path} is damaged ({error}); train anew") from error
    wanted = json.loads(json.dumps(settings))
    for name in sorted(wanted.keys() | made_with.keys()):
        if wanted.get(name) != made_with.get(name):
            raise InvalidError(
                f"--resume: {name} was {made_with.get(name)!r} and is {wanted.get(name)!r} now; "
                "resume with the settings of the first run"
            )
    return Checkpoint(state, pending)
