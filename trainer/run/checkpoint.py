"""Everything that a training run needs to go on where it was killed.

Rule: a checkpoint is replaced as a whole after each window, and about once a minute in the first,
so the newest one is always usable; a run that resumes from it makes the same bytes as one that was
never stopped.
"""

from __future__ import annotations

import json
import os
import stat
import time
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from codec.errors import InvalidError
from codec.files import open_without_waiting, replacing, write_atomic
from codec.lattice.lattice import States
from codec.slice import Slice
from codec.slots.slotlayout import Update
from codec.splats import ARRAY_NAMES, Splats
from trainer.errors import CheckpointError
from trainer.fit.observer import Observer, Progress

CHECKPOINT_NAME = ".checkpoint.npz"
"""In the stream's folder; readers of a stream ignore names that begin with a dot."""

SETTINGS_NAME = ".settings.json"
"""Beside the checkpoint, from before the first one: the options of the run."""

VERSION = 1

Arrays = dict[str, npt.NDArray[Any]]


KEEP_S = 60.0
"""Seconds of training that a killed run loses at most, about: those from the end of one checkpoint
to the next."""


class KeepTimer:
    """Writes a checkpoint when one is due."""

    def __init__(self, every_s: float, now_s: Callable[[], float] = time.monotonic) -> None:
        self._every_s, self._now_s, self._last_s = every_s, now_s, now_s()

    def keep_if_due(self, keep: Callable[[], None]) -> None:
        """Calls `keep` if none was kept for `every_s` seconds."""
        if self._now_s() - self._last_s >= self._every_s:
            keep()
            self._last_s = self._now_s()


class GenesisKeeper(Observer):
    """Has checkpoints kept while the first window is trained, which takes long."""

    def __init__(self, keep: Callable[[], None], timer: KeepTimer) -> None:
        self._keep, self._timer = keep, timer

    def progressed(self, progress: Progress) -> None:
        if not progress.first_frame:
            self._timer.keep_if_due(self._keep)


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """A run between two windows, or in its first."""

    state: Arrays
    """The result of `Trainer.state`."""
    pending: list[Slice | Update]
    """Slices that have matured and may not be in a finished segment yet, in the order of birth."""


def arrays_of(part: Slice | Update) -> Arrays:
    """All that `part` holds but its birth, for `_part_of`."""
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
    """The opposite of `arrays_of`."""
    if "statuses" not in arrays:
        splats = Splats(*(arrays[f"splats.{name}"] for name in ARRAY_NAMES))
        return Slice(birth, splats, arrays["start_offsets"])
    return update_of(birth, arrays)


def update_of(birth: int, arrays: Arrays) -> Update:
    """The update that `arrays_of` was given."""
    return Update(
        birth,
        arrays["statuses"],
        States(arrays["positions"], arrays["attributes"]),
        arrays["start_offsets"],
        arrays["escaped"],
        Splats(*(arrays[f"escapes.{name}"] for name in ARRAY_NAMES)),
    )


def save_checkpoint(
    path: Path,
    state: Arrays,
    pending: Sequence[Slice | Update],
    settings: Mapping[str, Any],
    options: Mapping[str, Any] | None = None,
) -> None:
    """Writes a checkpoint to `path`. settings: JSON that a resuming run must agree with. options:
    the run's whole configuration as JSON, for `read_options`."""
    arrays: Arrays = {f"state.{name}": array for name, array in state.items()}
    head = {
        "version": VERSION,
        "settings": settings,
        "options": options or {},
        "births": [p.birth for p in pending],
    }
    arrays["head"] = np.frombuffer(json.dumps(head, sort_keys=True).encode(), np.uint8)
    for i, part in enumerate(pending):
        arrays |= {f"pending.{i}.{name}": array for name, array in arrays_of(part).items()}
    # Opened here, because numpy would add .npz to the temporary name.
    with replacing(path) as temporary, open(temporary, "wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]  # its stub takes the names for options


def _named(arrays: Arrays, prefix: str) -> Arrays:
    """Arrays whose names begin with `prefix`, without it."""
    return {n.removeprefix(prefix): array for n, array in arrays.items() if n.startswith(prefix)}


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, dict[str, Any]]]:
    """The arrays by name, read as they are asked for, and the head. Raises CheckpointError."""
    try:
        # Opened here, because numpy leaves a damaged file open.
        with open(path, "rb", opener=open_without_waiting) as raw:
            if not stat.S_ISREG(os.fstat(raw.fileno()).st_mode):
                raise CheckpointError(f"{path} is not a regular file; train anew")
            with np.load(raw, allow_pickle=False) as file:
                head = json.loads(file["head"].tobytes())
                if head["version"] != VERSION:
                    raise CheckpointError(
                        f"{path}: version {head['version']}, not {VERSION}; train anew"
                    )
                yield file, head
    except FileNotFoundError as error:
        raise CheckpointError(
            f"{path} is missing: nothing to resume; train without --resume"
        ) from error
    except InvalidError:  # a ValueError, too, but the caller's
        raise
    except (ValueError, KeyError, TypeError, IndexError, EOFError, zipfile.BadZipFile) as error:
        raise CheckpointError(f"{path} is damaged ({error}); train anew") from error


def write_settings(work: Path, options: Mapping[str, Any]) -> None:
    """Keeps the options of a run that begins in the folder `work`."""
    write_atomic(work / SETTINGS_NAME, json.dumps(options, indent=1).encode())


def read_options(work: Path) -> dict[str, Any] | None:
    """The options of the run that was stopped in the folder `work`; None if there is none. Raises
    CheckpointError or ValueError for files that are damaged."""
    if (work / CHECKPOINT_NAME).exists():
        with _opened(work / CHECKPOINT_NAME) as (_, head):
            options: dict[str, Any] = head["options"]
            return options
    with suppress(OSError):  # a folder without such a run, or none at all
        options = json.loads((work / SETTINGS_NAME).read_bytes())
        return options
    return None


def forget_run(work: Path) -> None:
    """Removes what a finished run does not need."""
    for name in (CHECKPOINT_NAME, SETTINGS_NAME):
        (work / name).unlink(missing_ok=True)


def load_checkpoint(path: Path, settings: Mapping[str, Any]) -> Checkpoint:
    """The checkpoint at `path`.

    Raises CheckpointError when it is missing or damaged, InvalidError when it was made with other
    settings.
    """
    with _opened(path) as (file, head):
        _check_settings(head["settings"], json.loads(json.dumps(settings)))
        arrays = {name: file[name] for name in file.files if name != "head"}
        pending = [
            _part_of(int(birth), _named(arrays, f"pending.{i}."))
            for i, birth in enumerate(head["births"])
        ]
    return Checkpoint(_named(arrays, "state."), pending)


def _check_settings(made_with: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    """Raises InvalidError, with all that differ, unless both are the same."""
    before, now = _flat(made_with), _flat(wanted)
    changed = [
        f"{name} was {before.get(name)!r} and is {now.get(name)!r} now"
        for name in sorted(before.keys() | now.keys())
        if before.get(name) != now.get(name)
    ]
    if changed:
        raise InvalidError(
            f"--resume: {', '.join(changed)}; leave these options out to use those of the first run"
        )


def _flat(settings: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """The settings of inner mappings, under names such as lease.hold."""
    flat: dict[str, Any] = {}
    for name, value in settings.items():
        inner = isinstance(value, Mapping)
        flat |= _flat(value, f"{prefix}{name}.") if inner else {f"{prefix}{name}": value}
    return flat
