"""Objects of sound in memory, as they are answered: read and hashed once while a file is the same.

Rule: the index has no hash of them, and another sound may take a name; so the file's stamp is asked
for each time, which for a folder is one look at its metadata.
"""

from __future__ import annotations

import asyncio
import hashlib

from codec.storage.storage import Stamp
from server.http.content import OBJECT_TYPE, REVALIDATE, Content
from server.library import ServedStream

from .bytecache import ByteCache

Key = tuple[int, int, str]
"""Generation of the stream, segment and name of the object."""


class SoundCache:
    """The objects of sound of all streams. Two requests at the same moment may both read what is
    not there yet."""

    def __init__(self, capacity_bytes: int) -> None:
        self._objects = ByteCache[Key, tuple[Stamp, Content]](capacity_bytes)

    @property
    def size_bytes(self) -> int:
        return self._objects.size_bytes

    async def content(self, stream: ServedStream, segment: int, name: str) -> Content:
        """The object that `stream.has_sound`, as an answer. Raises a CodecError for a bad file."""
        key = (stream.generation, segment, name)
        # Before the content: what is replaced between the two is read again at the next request.
        stamp = await asyncio.to_thread(stream.sound_stamp, segment, name)
        found = self._objects.get(key)
        if found is not None and found[0] == stamp:
            return found[1]
        content = await asyncio.to_thread(_load, stream, segment, name)
        if stamp is not None:
            self._objects.keep(key, (stamp, content), len(content.data))
        return content


def _load(stream: ServedStream, segment: int, name: str) -> Content:
    """Blocks."""
    data = stream.read_sound(segment, name)
    sha256 = hashlib.sha256(data).hexdigest()
    return Content(data, sha256, OBJECT_TYPE, REVALIDATE)
