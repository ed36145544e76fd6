"""Reads fields of bytes one after the other, and refuses to read past their end."""

from __future__ import annotations

import struct
from typing import Any

from codec.errors import CorruptError

BLOCK = struct.Struct("<Q")
TEXT = struct.Struct("<I")


class ByteCursor:
    """Where in `data`, called `what` in errors, the next field begins."""

    def __init__(self, data: bytes | memoryview, what: str) -> None:
        self._data, self._what, self._at = memoryview(data), what, 0

    @property
    def left(self) -> int:
        """Bytes not read yet."""
        return len(self._data) - self._at

    def take(self, num_bytes: int) -> memoryview:
        """The next `num_bytes`. Raises CorruptError if there are fewer."""
        if num_bytes > self.left:
            raise CorruptError(f"{self._what}: ends {num_bytes - self.left} bytes too early")
        self._at += num_bytes
        return self._data[self._at - num_bytes : self._at]

    def fields(self, layout: struct.Struct) -> tuple[Any, ...]:
        """The next fields, as `layout` has them. Raises CorruptError."""
        return layout.unpack(self.take(layout.size))

    def block(self) -> memoryview:
        """Bytes behind their number, a u64. Raises CorruptError."""
        return self.take(self.fields(BLOCK)[0])

    def text(self) -> str:
        """A string behind its number of bytes, a u32. Raises CorruptError."""
        try:
            return bytes(self.take(self.fields(TEXT)[0])).decode()
        except UnicodeDecodeError as error:
            raise CorruptError(f"{self._what}: a text is not UTF-8") from error
