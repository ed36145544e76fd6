"""The settings of a command, read off its dataclass: what they are called, and what they may be.

Rule: there is no second list of options. What tyro makes a flag of is a key of the file and a
variable of the environment.
"""

from __future__ import annotations

import types
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import tyro
from tyro.constructors import PrimitiveConstructorSpec

from codec.errors import InvalidError


@dataclass(frozen=True, slots=True)
class SettingField:
    """One setting."""

    path: tuple[str, ...]
    """Names of the fields that lead to it, from the command on."""
    keys: tuple[str, ...]
    """What it is called in a file: the last is its key, those before are tables."""
    hint: Any
    """Its type, with what is annotated."""

    @property
    def variable(self) -> str:
        """What it is called in the environment, after the command's prefix."""
        return "_".join(self.keys).upper()

    def from_text(self, text: str) -> Any:
        """The value that `text` says. Raises InvalidError, which tells what it should be."""
        kind, spec = _kind_of(self.hint)
        if kind is bool:
            if text.lower() not in ("true", "false", "1", "0"):
                raise InvalidError(f"{text[:60]!a} is neither true nor false")
            return text.lower() in ("true", "1")
        if kind in (int, float) and spec is None:
            try:
                return kind(text)
            except ValueError as error:
                raise InvalidError(f"{text[:60]!a} is not {_NAMES[kind]}") from error
        return _of_word(kind, spec, text)

    def from_toml(self, value: Any) -> Any:
        """The value that a TOML value stands for. Raises InvalidError likewise."""
        kind, spec = _kind_of(self.hint)
        if kind is float and type(value) is int:
            return float(value)
        expected = kind if kind in _NAMES and spec is None else str
        if type(value) is not expected:
            raise InvalidError(f"{str(value)[:60]!a} is not {_NAMES[expected]}")
        return _of_word(kind, spec, value) if expected is str else value

    def to_toml(self, value: Any) -> bool | int | float | str:
        """What `from_toml` makes `value` of, which is not None."""
        _, spec = _kind_of(self.hint)
        if spec is not None:
            return " ".join(spec.str_from_instance(value))
        plain = value.value if isinstance(value, Enum) else value
        return plain if isinstance(plain, bool | int | float) else str(plain)


_NAMES = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}


def _kind_of(hint: Any) -> tuple[Any, PrimitiveConstructorSpec[Any] | None]:
    """The plain type of a hint, None aside, and how tyro reads it, where that is annotated."""
    if get_origin(hint) is Annotated:
        plain, *notes = get_args(hint)
        kind, inner = _kind_of(plain)
        specs = [note for note in notes if isinstance(note, PrimitiveConstructorSpec)]
        return kind, specs[0] if specs else inner
    if get_origin(hint) in (Union, types.UnionType):
        (plain,) = (one for one in get_args(hint) if one is not type(None))
        return _kind_of(plain)
    return hint, None


def _of_word(kind: Any, spec: PrimitiveConstructorSpec[Any] | None, word: str) -> Any:
    if spec is not None:
        return spec.instance_from_str([word])
    if kind is str:
        return word
    if kind is Path:
        return Path(word)
    if get_origin(kind) is Literal:
        choices = {str(choice): choice for choice in get_args(kind)}
    elif isinstance(kind, type) and issubclass(kind, Enum):
        choices = {str(choice.value): choice for choice in kind}
    else:
        raise TypeError(f"no setting can be of type {kind}")
    if word not in choices:
        raise InvalidError(f"{word[:60]!a} is not one of {', '.join(choices)}")
    return choices[word]


def setting_fields(config_type: type[Any], leave_out: type[Any]) -> list[SettingField]:
    """The settings of `config_type`, those of its parts included, but for parts of `leave_out`."""
    return list(_walk(config_type, leave_out, (), (), False))


def _walk(
    config_type: type[Any],
    leave_out: type[Any],
    path: tuple[str, ...],
    keys: tuple[str, ...],
    omit: bool,
) -> Iterator[SettingField]:
    hints = get_type_hints(config_type, include_extras=True)
    for one in fields(config_type):
        hint = hints[one.name]
        kind, _ = _kind_of(hint)
        own_path = (*path, one.name)
        if not is_dataclass(kind):
            yield SettingField(own_path, (*keys, one.name), hint)
        elif kind is not leave_out:
            assert isinstance(kind, type)
            # tyro hands the mark on to all that is below.
            marked = omit or _is_marked(hint, tyro.conf.OmitArgPrefixes)
            own_keys = keys if marked else (*keys, one.name)
            yield from _walk(kind, leave_out, own_path, own_keys, marked)


def _is_marked(hint: Any, marker: Any) -> bool:
    return any(note in get_args(marker[int]) for note in get_args(hint)[1:])
