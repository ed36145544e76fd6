"""A training run's settings as JSON, so that a resumed run needs no options."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from types import UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

from codec.storage.openstorage import parse_target

Config = TypeVar("Config")


def config_to_json(config: Any) -> dict[str, Any]:
    """The fields of a dataclass, of those in it too. Paths are absolute: a run may be resumed from
    another folder."""
    return {f.name: _to_json(getattr(config, f.name)) for f in dataclasses.fields(config)}


def _to_json(value: Any) -> Any:
    if dataclasses.is_dataclass(value):
        return config_to_json(value)
    if isinstance(value, Path):
        return str(value.absolute())
    if isinstance(value, Enum):
        return value.value
    return list(value) if isinstance(value, tuple) else value


def config_from_json(config_type: type[Config], values: Any) -> Config:
    """The opposite of `config_to_json`. A field that `values` lack has its default.

    Raises TypeError or ValueError, InvalidError among them, for values that make no such config.
    """
    if not isinstance(values, Mapping):
        raise TypeError(f"{values!r} holds no settings")
    types = get_type_hints(config_type)
    unknown = values.keys() - types.keys()
    if unknown:
        raise ValueError(f"no setting is called {min(unknown)}")
    return config_type(**{name: _from_json(types[name], v) for name, v in values.items()})


def _from_json(wanted: Any, value: Any) -> Any:
    if get_origin(wanted) in (Union, UnionType):
        if value is None:
            return None
        if {str, Path} <= set(get_args(wanted)):
            return parse_target(value)
        wanted = next(kind for kind in get_args(wanted) if kind is not type(None))
    if get_origin(wanted) is tuple:
        return tuple(value)
    if isinstance(wanted, type):
        if dataclasses.is_dataclass(wanted):
            return config_from_json(wanted, value)
        if issubclass(wanted, Path | Enum):
            return wanted(value)
    return value
