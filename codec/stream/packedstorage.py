"""A packed stream as a storage: the files in it are read as those of a folder are.

Rule: the head and the index are read again whenever the manifest is asked for, because the file may
have been replaced; until then the places are those of the last time.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from codec.errors import CodecError, CorruptError, MissingFolderError, UnreadableError
from codec.storage.folder import FolderStorage
from codec.storage.objectstore import open_store
from codec.storage.openstorage import Place, is_url, open_storage
from codec.storage.storage import Stamp, Storage, StorageRoot

from .manifest import MANIFEST_NAME
from .packedlayout import PACKED_SUFFIX, PackedLayout, read_layout
from .segment import INDEX_NAME


class PackedStorage:
    """The files of the stream in one file."""

    def __init__(self, storage: StorageRoot, path: str, name: str | None = None) -> None:
        """path: of the file in `storage`. name: what people call it, if not by that."""
        self._storage = storage
        self._path = path
        self._name = storage.place(path) if name is None else name
        self._layout: PackedLayout | None = None

    @property
    def name(self) -> str:
        return self._name

    @property
    def last_name(self) -> str:
        return self._path.rpartition("/")[2].removesuffix(PACKED_SUFFIX)

    def place(self, path: str) -> str:
        return f"{self._name}/{path}"

    def check(self) -> None:
        if self._storage.stamp(self._path) is None:
            raise MissingFolderError(f"{self._name} does not exist; name a packed stream")

    def read(
        self, path: str, limit_bytes: int, offset: int = 0, *, if_missing: str | None = None
    ) -> bytes:
        layout = self.open() if path == MANIFEST_NAME else self.layout
        found = layout.find(path)
        if found is None:
            meaning = "" if if_missing is None else f"; {if_missing}"
            raise CorruptError(f"{self.place(path)} is missing{meaning}")
        at, size_bytes = found
        wanted = max(size_bytes - offset, 0)
        if wanted > limit_bytes:
            raise CorruptError(f"{self.place(path)} is longer than {limit_bytes} bytes")
        return self.read_raw(at + offset, wanted) if wanted else b""

    @property
    def layout(self) -> PackedLayout:
        """Where everything lies. Raises a CodecError."""
        return self._layout or self.open()

    def open(self) -> PackedLayout:
        """Reads head and index, and checks that the file is whole. Raises a CodecError."""
        stamp = self._storage.stamp(self._path)
        if stamp is None:
            raise CorruptError(f"{self._name} is missing; was it removed?")
        file_bytes = stamp.size_bytes

        def read(offset: int, most_bytes: int) -> tuple[bytes, int]:
            return self.read_raw(offset, min(most_bytes, file_bytes - offset)), file_bytes

        try:
            layout = read_layout(read)
        except UnreadableError:
            raise
        except CodecError as error:
            raise error.within(self._name) from error
        self._layout = layout
        return layout

    def read_raw(self, offset: int, size_bytes: int) -> bytes:
        """Bytes of the file itself. Raises CorruptError."""
        return self._storage.read_range(self._path, offset, size_bytes)

    def stamp(self, path: str) -> Stamp | None:
        stamp = self._storage.stamp(self._path)
        if stamp is None or path in (MANIFEST_NAME, INDEX_NAME):
            return stamp
        found = self._find(path)
        return None if found is None else Stamp(found[1], stamp.identity)

    def holds(self, path: str) -> bool:
        return self._find(path) is not None

    def _find(self, path: str) -> tuple[int, int] | None:
        try:
            return self.layout.find(path)
        except UnreadableError:
            raise
        except CodecError:
            return None

    def sizes(self, folder: str) -> Iterator[tuple[str, int]]:
        for path, _, size_bytes in self.layout.files():
            if path.startswith(f"{folder}/") and path.count("/") == folder.count("/") + 2:
                yield path, size_bytes


def open_place(place: Place) -> Storage:
    """The storage of the stream, or the streams, at `place`: a folder, an object store, or in
    either a packed stream, whose name ends with `.swings`. Raises InvalidError for a URL that
    cannot be one."""
    if isinstance(place, Storage):
        return place
    name = str(place)
    if not name.endswith(PACKED_SUFFIX) or (not is_url(place) and Path(place).is_dir()):
        return open_storage(place)
    if is_url(place):
        folder, _, file = name.rpartition("/")
        return PackedStorage(open_store(folder), file)
    path = Path(place)
    # Links on the way to what the user has named may lead anywhere.
    real = path.resolve()
    return PackedStorage(FolderStorage(real.parent), real.name, str(path))
