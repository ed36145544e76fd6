"""The values in manifest.json, each of the type that the format says."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from codec.errors import CorruptError
from codec.lattice.lattice import MIN_STEP, Lattice


def parse_manifest(data: bytes) -> dict[str, Any]:
    """The JSON object in `data`. Raises CorruptError."""
    try:
        value = json.loads(data.decode(), parse_constant=_no_constant)
    except UnicodeDecodeError as error:
        raise CorruptError("manifest: is not UTF-8", error.start) from error
    except json.JSONDecodeError as error:
        at = len(error.doc[: error.pos].encode())
        raise CorruptError(f"manifest: is not JSON: {error}", at) from error
    except (ValueError, RecursionError) as error:
        raise CorruptError(f"manifest: is not JSON: {error}") from error
    if not isinstance(value, dict):
        raise CorruptError("manifest: is not a JSON object")
    return value


def _no_constant(name: str) -> Any:
    raise ValueError(f"{name} is not a number")


def typed(value: Mapping[str, Any], key: str, *kinds: type) -> Any:
    """The value of `key`, which must be there and of one of `kinds`. Raises CorruptError."""
    found = value.get(key)
    if key not in value or type(found) not in kinds:
        raise CorruptError(f"manifest: {key} is missing or of the wrong type")
    return found


def number(value: Any, key: str) -> float:
    """`value`, which `key` holds, as a float. Raises CorruptError."""
    if type(value) not in (int, float):
        raise CorruptError(f"manifest: {key} holds something that is not a number")
    try:
        return float(value)
    except OverflowError as error:
        raise CorruptError(f"manifest: {key} holds a number out of range") from error


def lattice_of(value: Any) -> Lattice:
    """The lattice that `value` describes. Raises CorruptError or InvalidError."""
    if type(value) is not dict:
        raise CorruptError("manifest: a lattice is not an object")
    names = "position_m", "log_scale", "rotation", "colour"
    steps = {name: number(typed(value, name, int, float), name) for name in names}
    least = min(steps.values())
    if least < MIN_STEP:
        raise CorruptError(f"manifest: a step of a lattice is {least:g}, below {MIN_STEP:g}")
    return Lattice(
        **steps,
        opacity_levels=typed(value, "opacity_levels", int),
        log_scale_base=number(typed(value, "log_scale_base", int, float), "log_scale_base"),
    )


def lattice_to_json(lattice: Lattice) -> dict[str, Any]:
    """JSON that `lattice_of` reads; numbers as short as a float32 can be written."""

    def short(step: float) -> float:
        return float(str(np.float32(step)))

    return {
        "position_m": short(lattice.position_m),
        "log_scale": short(lattice.log_scale),
        "log_scale_base": short(lattice.log_scale_base),
        "rotation": short(lattice.rotation),
        "colour": short(lattice.colour),
        "opacity_levels": lattice.opacity_levels,
    }
