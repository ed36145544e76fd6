"""How a command line says a folder or a URL."""

from __future__ import annotations

from pathlib import Path

from tyro.constructors import PrimitiveConstructorSpec

from .openstorage import Target, parse_target


def target_named(metavar: str) -> PrimitiveConstructorSpec[Target | None]:
    """To be put into `Annotated`: tyro itself would make a Path of a URL."""
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        instance_from_str=lambda words: parse_target(words[0]),
        is_instance=lambda value: value is None or isinstance(value, str | Path),
        str_from_instance=lambda target: [str(target)],
    )
