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
from codec.splats import ARRAY_NAMES, Splats
from trainer.errors import CheckpointError

CHECKPOINT_NAME = ".checkpoint.npz"
"""In the stream's folder; readers of a stream ignore names that begin with a dot."""

VERSION = 1

Arrays = dict[str, npt.NDArray[Any]]


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """A run between two windows."""

    state: Arrays
    """What `Trainer.state` gave."""
    pending: list[Slice]
    """Matured slices that may not be in a finished segment yet, in the order of birth."""


def save_checkpoint(
    path: Path, state: Arrays, pending: Sequence[Slice], settings: Mapping[str, Any]
) -> None:
    """Writes a checkpoint to `path`. settings: JSON that a resuming run must agree with."""
    arrays: Arrays = {f"state.{name}": array for name, array in state.items()}
    head = {"version": VERSION, "settings": settings, "births": [s.birth for s in pending]}
    arrays["head"] = np.frombuffer(json.dumps(head, sort_keys=True).encode(), np.uint8)
    if pending:
        for name in ARRAY_NAMES:
            arrays[f"pending.{name}"] = np.stack([getattr(s.splats, name) for s in pending])
        arrays["pending.start_offsets"] = np.stack([s.start_offsets for s in pending])
    # Opened here, because numpy would add .npz to the temporary name.
    with replacing(path) as temporary, open(temporary, "wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]  # its stub takes the names for options


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
        state = {n.removeprefix("state."): a for n, a in arrays.items() if n.startswith("state.")}
        pending = [
            Slice(
                int(birth),
                Splats(*(arrays[f"pending.{name}"][i] for name in ARRAY_NAMES)),
                arrays["pending.start_offsets"][i],
            )
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
