"""held_out.txt: which cameras of a capture are kept out of training."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from trainer.errors import CaptureError

HELD_OUT_NAME = "held_out.txt"


def read_held_out(root: Path, names: Sequence[str]) -> frozenset[str]:
    """The names in held_out.txt, one a line, of a capture whose cameras are called `names`.

    An empty file holds out none. Without a file the first camera is held out, as the authors of the
    Neural 3D Video data set do. Raises CaptureError for a name that no camera has.
    """
    path = root / HELD_OUT_NAME
    if not path.is_file():
        return frozenset(names[:1])
    try:
        listed = path.read_text(encoding="utf-8").split()
    except UnicodeDecodeError as error:
        raise CaptureError(f"{path}: not text: {error}") from error
    for name in listed:
        if name not in names:
            raise CaptureError(
                f"{path}: {name!r} is not a camera of this capture, such as {names[0]!r}"
            )
    return frozenset(listed)
