"""JSON objects of foreign files: what is looked up is of the type asked for, or a CorruptError says
where it is not."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from codec.errors import CorruptError

MAX_JSON_BYTES = 4 << 20
"""Longest text parsed. What Python makes of it may take thirty times as much."""


@dataclass(frozen=True, slots=True)
class Fields:
    """An object, and where it is in the file, for errors."""

    values: dict[str, Any]
    where: str

    @staticmethod
    def parse(text: bytes, where: str) -> Fields:
        """The object that `text` is. Raises CorruptError."""
        if len(text) > MAX_JSON_BYTES:
            raise CorruptError(f"{where}: {len(text)} bytes of JSON, at most {MAX_JSON_BYTES}")
        try:
            value = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise CorruptError(f"{where}: is not JSON: {error}") from error
        return Fields._of(value, where)

    @staticmethod
    def _of(value: Any, where: str) -> Fields:
        if type(value) is not dict:
            raise CorruptError(f"{where}: is not a JSON object")
        return Fields(value, where)

    def __contains__(self, key: str) -> bool:
        return key in self.values

    def _place(self, key: str) -> str:
        return f"{self.where}.{key}"

    def _get(self, key: str, kind: type, name: str, default: Any = None) -> Any:
        value = self.values.get(key, default)
        if type(value) is not kind:
            problem = f"is not {name}" if key in self.values else "is missing"
            raise CorruptError(f"{self._place(key)}: {problem}")
        return value

    def fields(self, key: str) -> Fields:
        return Fields._of(self._get(key, dict, "an object"), self._place(key))

    def text(self, key: str, default: str | None = None) -> str:
        return str(self._get(key, str, "a string", default))

    def flag(self, key: str) -> bool:
        """True or False; False if it is missing."""
        return bool(self._get(key, bool, "true or false", False))

    def integer(self, key: str, default: int | None = None, *, most: int) -> int:
        """A whole number from 0 to `most`."""
        value = int(self._get(key, int, "a whole number", default))
        if not 0 <= value <= most:
            raise CorruptError(f"{self._place(key)}: is not in 0..{most}")
        return value

    def number(self, key: str) -> float:
        """A finite number."""
        value: Any = self.values.get(key)
        if type(value) not in (int, float) or not abs(value) < math.inf:
            raise CorruptError(f"{self._place(key)}: is not a finite number")
        try:
            return float(value)
        except OverflowError as error:
            raise CorruptError(f"{self._place(key)}: is out of range") from error

    def numbers(
        self, key: str, count: int, default: tuple[float, ...] | None = None, least: int = 0
    ) -> list[float]:
        """As many finite numbers as `count`, or fewer, down to `least`."""
        values = self._get(key, list, "a list", None if default is None else list(default))
        if not (least or count) <= len(values) <= count:
            raise CorruptError(f"{self._place(key)}: {len(values)} numbers, not {count}")
        for value in values:
            if type(value) not in (int, float) or not abs(value) < math.inf:
                raise CorruptError(f"{self._place(key)}: holds a value that is not a finite number")
        try:
            return [float(value) for value in values]
        except OverflowError as error:
            raise CorruptError(f"{self._place(key)}: holds a number out of range") from error

    def texts(self, key: str, count: int | None = None) -> list[str]:
        """As many texts as `count`; or any number, none if the list is missing."""
        values = self._get(key, list, "a list", [] if count is None else None)
        if any(type(value) is not str for value in values) or count not in (None, len(values)):
            wanted = "texts" if count is None else f"{count} strings"
            raise CorruptError(f"{self._place(key)}: is not a list of {wanted}")
        return list(values)

    def size(self, key: str) -> int:
        """How long the list is; 0 if it is missing."""
        return len(self._get(key, list, "a list", []))

    def item(self, key: str, index: int) -> Fields:
        """The object at `index` of a list."""
        values = self._get(key, list, "a list", [])
        if not 0 <= index < len(values):
            raise CorruptError(f"{self._place(key)}: has no item {index}")
        return Fields._of(values[index], f"{self._place(key)}[{index}]")

    def items(self, key: str) -> Iterator[Fields]:
        """The objects of a list, none if it is missing."""
        return (self.item(key, index) for index in range(self.size(key)))

    def integers(self, key: str, *, most: int) -> list[int]:
        """Whole numbers from 0 to `most`, none if the list is missing."""
        values = self._get(key, list, "a list", [])
        if any(type(value) is not int or not 0 <= value <= most for value in values):
            raise CorruptError(f"{self._place(key)}: is not a list of numbers in 0..{most}")
        return list(values)
