"""From where the user wants a stream to a sink."""

from __future__ import annotations

from pathlib import Path

from .foldersink import FolderSink
from .objectstore import open_store
from .openstorage import Target, check_url, is_url
from .sink import Shape, Sink
from .storesink import StoreSink


def open_sink(target: Target, shape: Shape) -> Sink:
    """The sink at `target`; nothing is written yet. Raises InvalidError for a URL that cannot be
    one."""
    if not is_url(target):
        return FolderSink(Path(target), shape)
    check_url(str(target))
    return StoreSink(open_store(str(target), patient=True), shape)
