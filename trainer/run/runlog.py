"""The record of a training run: one JSON object per line and, if wanted, TensorBoard scalars."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from codec.errors import InvalidError
from codec.files import append_durably, opened_regular

LOG_NAME = "training.jsonl"
"""The log's file name in a stream's folder, unless another is named."""


def _tensorboard(folder: Path) -> Any:
    try:
        from tensorboardX import SummaryWriter
    except ImportError as error:
        raise InvalidError(
            "--tensorboard needs the package tensorboardX: pip install '.[tensorboard]'"
        ) from error
    return SummaryWriter(str(folder))


def _whole_lines_bytes(path: Path) -> int:
    """Size of what is at `path` up to the end of its last line: a machine that stopped may have
    left a part of one."""
    if not path.exists():
        return 0
    with opened_regular(path) as file:
        return file.read().rfind(b"\n") + 1


class RunLog:
    """Appends records; a resumed run goes on in the same file. Every line is whole, also when the
    process dies or the disk is full."""

    def __init__(self, path: Path, tensorboard: Path | None = None) -> None:
        """Opens nothing before the first record, so that a refused run leaves no file. Raises
        InvalidError when TensorBoard is wanted and not installed."""
        self._path = path
        self._size_bytes: int | None = None
        self._scalars = _tensorboard(tensorboard) if tensorboard is not None else None

    def add(self, record: dict[str, Any]) -> None:
        """Writes `record`, which has the key "frame"; its numbers become scalars at that frame."""
        if self._size_bytes is None:
            self._size_bytes = _whole_lines_bytes(self._path)
        line = json.dumps(record).encode() + b"\n"
        append_durably(self._path, self._size_bytes, line)
        self._size_bytes += len(line)
        if self._scalars is not None:
            for name, value in record.items():
                if isinstance(value, int | float) and name != "frame":
                    self._scalars.add_scalar(name, value, record["frame"])

    def __enter__(self) -> RunLog:
        return self

    def __exit__(self, *_: object) -> None:
        if self._scalars is not None:
            self._scalars.close()
