"""The file of signing keys: one `kid:secret` a line, the secret in hex, the newest first."""

from __future__ import annotations

import os
import re
import secrets
from functools import partial
from pathlib import Path

from codec.errors import InvalidError
from codec.files import opened_regular, replacing

from .signing import KID

MAX_BYTES = 64 * 1024

SECRET_BYTES = 32

_LINE = re.compile(rf"({KID}):((?:[0-9A-Fa-f]{{2}}){{16,128}})", re.ASCII)


def read_keys(path: Path) -> dict[str, bytes]:
    """The secrets by key name, in the order of the file; the first is the one to sign with.

    Empty lines and those that begin with # count for nothing. Raises InvalidError for a file that
    others may read or that is not one of keys, CorruptError where it cannot be read.
    """
    keys: dict[str, bytes] = {}
    for number, line in enumerate(_read(path).splitlines(), start=1):
        if not line.strip() or line.startswith("#"):
            continue
        match = _LINE.fullmatch(line.strip())
        # The message does not quote the line: it may be a secret.
        if match is None:
            raise InvalidError(f"{path}: line {number} is not NAME:SECRET, 16 bytes or more in hex")
        if match[1] in keys:
            raise InvalidError(f"{path}: line {number} repeats the key name {match[1]}")
        keys[match[1]] = bytes.fromhex(match[2])
    if not keys:
        raise InvalidError(f"{path} holds no key; swings-sign --new-key adds one")
    return keys


def add_key(path: Path) -> str:
    """Puts a new key before those of `path`, which is made where there is none; gives its name.

    The file is replaced in one step. Raises as `read_keys` does.
    """
    keys, text = dict[str, bytes](), ""
    if path.exists():
        keys, text = read_keys(path), _read(path)
    kid = secrets.token_hex(4)
    while kid in keys:
        kid = secrets.token_hex(4)
    with (
        replacing(path) as draft,
        open(draft, "w", encoding="ascii", opener=partial(os.open, mode=0o600)) as file,
    ):
        file.write(f"{kid}:{secrets.token_hex(SECRET_BYTES)}\n{text}")
    return kid


def _read(path: Path) -> str:
    with opened_regular(path, if_missing=f"swings-sign {path} --new-key makes it") as file:
        if os.fstat(file.fileno()).st_mode & 0o077:
            raise InvalidError(
                f"{path} holds secrets and other users can read it; run chmod 600 {path}"
            )
        data = file.read(MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise InvalidError(f"{path} has more than {MAX_BYTES} bytes; it is not a key file")
    try:
        return data.decode("ascii")
    except UnicodeDecodeError as error:
        raise InvalidError(f"{path} is not a key file: it is not ASCII text") from error
