"""The file that says how a source of sound moves."""

from __future__ import annotations

import json
from pathlib import Path

from codec.errors import CorruptError
from codec.files import read_bounded
from codec.stream.sound import Key, keys_of

MAX_FILE_BYTES = 1 << 20


def read_keys(path: Path) -> tuple[Key, ...]:
    """The keys in the JSON file at `path`: [[second, x, y, z], ...]. Raises CorruptError that names
    it; `SoundSource` checks their number and order."""
    try:
        value = json.loads(read_bounded(path, MAX_FILE_BYTES))
        if type(value) is not list:
            raise CorruptError("this is not a list of places; give [[SECOND, X, Y, Z], ...]")
        return keys_of(value)
    except CorruptError as error:
        raise error.within(str(path)) from error
    except (OSError, ValueError, RecursionError) as error:
        raise CorruptError(f"{path}: this file cannot be read: {error}") from error
