"""The record of a training run: one JSON object per line and, if wanted, TensorBoard scalars."""

from __future__ import annotations

import json
from pathlib import Path
from types import TracebackType
from typing import Any, TextIO

from codec.errors import InvalidError

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


class RunLog:
    """Appends records; a resumed run goes on in the same file. Every line is whole even when the
    process dies."""

    def __init__(self, path: Path, tensorboard: Path | None = None) -> None:
        """Opens nothing before the first record, so that a refused run leaves no file. Raises
        InvalidError when TensorBoard is wanted and not installed."""
        self._path = path
        self._file: TextIO | None = None
        self._scalars = _tensorboard(tensorboard) if tensorboard is not None else None

    def add(self, record: dict[str, Any]) -> None:
        """Writes `record`, which has the key "frame"; its numbers become scalars at that frame."""
        if self._file is None:
            self._file = self._path.open("a", encoding="utf-8")
        self._file.write(json.dumps(record) + "\n")
        self._file.flush()
        if self._scalars is not None:
            for name, value in record.items():
                if isinstance(value, int | float) and name != "frame":
                    self._scalars.add_scalar(name, value, record["frame"])

    def __enter__(self) -> RunLog:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._file is not None:
            self._file.close()
        if self._scalars is not None:
            self._scalars.close()
