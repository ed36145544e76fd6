"""What all commands share: parsing, exit codes, and one clear line instead of a traceback."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable
from typing import NoReturn, TypeVar

import tyro
from tyro.constructors import PrimitiveConstructorSpec

from .errors import SwingsError

Config = TypeVar("Config")
Value = TypeVar("Value")


def option(
    metavar: str, parse: Callable[[str], Value], show: Callable[[Value], str] = str
) -> PrimitiveConstructorSpec[Value]:
    """Stands in the Annotated of a field whose value `parse` makes of one word.

    An InvalidError from `parse` is bad usage. show: the word of a default, for the help.
    """
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        instance_from_str=lambda words: parse(words[0]),
        is_instance=lambda value: not isinstance(value, str),
        str_from_instance=lambda value: [show(value)],
    )


def run_command(
    config_type: type[Config], run: Callable[[Config], None], prog: str, description: str
) -> None:
    """Parses argv into `config_type` and runs it.

    Exits with 0 when done, 1 with one line on stderr for a SwingsError or an OSError, 2 for bad
    usage. A `--verbose` anywhere among the arguments shows the traceback and debug logs.
    """
    arguments = sys.argv[1:]
    verbose = "--verbose" in arguments
    arguments = [a for a in arguments if a != "--verbose"]
    logging.basicConfig(
        level=logging.DEBUG if verbose else logging.WARNING,
        format=f"{prog}: %(levelname)s %(name)s: %(message)s",
    )
    for noisy in ("numba", "matplotlib", "PIL", "asyncio"):
        logging.getLogger(noisy).setLevel(logging.WARNING)
    epilogue = "--verbose shows debug logs and, on failure, the traceback."

    def fail(error: Exception, status: int) -> NoReturn:
        if verbose:
            raise error
        message = " ".join(str(error).split()) or type(error).__name__
        sys.stderr.write(f"{prog}: {message}\n")
        sys.exit(status)

    try:
        config = tyro.cli(
            config_type,
            prog=prog,
            description=f"{description}\n\n{epilogue}",
            args=arguments,
            config=(tyro.conf.EnumChoicesFromValues,),
        )
    except SwingsError as error:  # a config refused its values
        fail(error, 2)
    try:
        run(config)
    except KeyboardInterrupt:
        sys.exit(130)
    except (SwingsError, OSError) as error:
        fail(error, 1)
