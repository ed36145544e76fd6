"""The frame of all commands: parsing, exit codes, and one clear line instead of a traceback."""

from __future__ import annotations

import argparse
import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Annotated, Any, NoReturn, TypeVar

import tyro
from tyro.constructors import PrimitiveConstructorSpec

from .errors import SwingsError
from .files import describe_os_error
from .helptext import help_text
from .version import version

Config = TypeVar("Config")
Value = TypeVar("Value")


Constant = Annotated[Value, tyro.conf.Fixed, tyro.conf.Suppress]
"""A field of a command that no option sets, but code may."""


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


ENDING = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
"""Signals that end a command as Ctrl-C does."""


class Ended(KeyboardInterrupt):
    """The signal `number` has come; `with` blocks clean up on its way out."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


@contextmanager
def ending_by_signals() -> Iterator[None]:
    """Makes a signal of ENDING raise Ended in the main thread, unless it is ignored or has a
    handler already. A second signal does not disturb the clean-up."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    taken = [number for number in ENDING if signal.getsignal(number) is signal.SIG_DFL]

    ended: list[Ended] = []

    def end(number: int, frame: object) -> None:
        for other in taken:
            signal.signal(other, signal.SIG_IGN)
        ended.append(Ended(number))
        raise ended[0]

    for number in taken:
        signal.signal(number, end)
    try:
        yield
    except KeyboardInterrupt as error:
        if ended and error is not ended[0]:  # a library has made another one of it
            raise ended[0] from error
        raise
    finally:
        for number in taken:
            signal.signal(number, signal.SIG_DFL)


@contextmanager
def interruptible() -> Iterator[threading.Event]:
    """Gives an event that the first Ctrl-C in the block sets, so that what runs can end well;
    a second one raises KeyboardInterrupt. Outside the main thread nothing sets it."""
    asked = threading.Event()

    def stop(number: int, frame: object) -> None:
        if asked.is_set():
            raise KeyboardInterrupt
        asked.set()

    if threading.current_thread() is not threading.main_thread():
        yield asked
        return
    before = signal.signal(signal.SIGINT, stop)
    try:
        yield asked
    finally:
        signal.signal(signal.SIGINT, before)


def listed(names: Sequence[str], most: int) -> str:
    """The first `most` names, and how many more there are."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def printable(text: str) -> str:
    """`text` for a terminal: what would steer it, or is not to be seen, stands there as an escape.

    Names and messages come from strangers. Lines stay lines.
    """
    if text.isprintable():
        return text
    return "".join(
        one if one.isprintable() or one == "\n" else one.encode("unicode_escape").decode()
        for one in text
    )


class _PrintableFormatter(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        return printable(super().format(record))


OUTPUT = "standard output"

OUTPUT_CLOSED = 128 + 13
"""Exit code where the reader of the output has gone, as after `head -1`: that of SIGPIPE in a
shell."""


@contextmanager
def printing() -> Iterator[None]:
    """An OSError of what is printed in the block names OUTPUT."""
    try:
        yield
    except OSError as error:
        if error.filename is None:
            error.filename = OUTPUT
        raise


def say(text: str) -> None:
    """Prints `text`, which may come from a stranger."""
    with printing():
        sys.stdout.write(printable(text) + "\n")


def cli(config_type: Any, args: Sequence[str], **options: Any) -> Any:
    """Called like tyro.cli, with our own help (see codec/helptext)."""
    if {"-h", "--help", "--help-all"} & set(args):
        wanted = {k: options[k] for k in ("prog", "description", "default") if k in options}
        say(help_text(config_type, args, **wanted))
        sys.exit(0)
    return tyro.cli(config_type, args=args, **options)


def run_command(
    config_type: type[Config],
    run: Callable[[Config], None],
    prog: str,
    description: str,
    parse: Callable[..., Config] = cli,
) -> None:
    """Parses the command line into `config_type` and runs it. parse: called like `cli`.

    Exits with 0 when done, 1 with one line on stderr for a SwingsError or an OSError, 2 for bad
    usage, 128 + N when signal N has ended it: Ctrl-C, SIGTERM or SIGHUP. A `--verbose` anywhere
    among the arguments shows the traceback and debug logs; `--version` prints the version.
    """
    # Not a field of the configs, because it may stand before a subcommand and after it.
    verbose, arguments = split_option(None, "--verbose", action="store_true")
    logging.basicConfig(level=logging.DEBUG if verbose else logging.WARNING)
    formatter = _PrintableFormatter(f"{prog}: %(levelname)s %(name)s: %(message)s")
    for handler in logging.getLogger().handlers:
        handler.setFormatter(formatter)
    for noisy in ("numba", "matplotlib", "PIL", "asyncio"):
        logging.getLogger(noisy).setLevel(logging.WARNING)

    def fail(error: Exception, status: int) -> NoReturn:
        if verbose:
            raise error
        message = str(error)
        if isinstance(error, OSError) and not isinstance(error, SwingsError):
            message = describe_os_error(error)
        message = " ".join(message.split()) or type(error).__name__
        sys.stderr.write(f"{prog}: {printable(message)}\n")
        sys.exit(status)

    try:
        with ending_by_signals(), _flushing():
            if "--version" in arguments:
                return say(f"{prog} {version()}")
            try:
                with printing():  # a help, or a completion script
                    config = parse(
                        config_type,
                        prog=prog,
                        description=description,
                        args=arguments,
                        config=(tyro.conf.EnumChoicesFromValues,),
                    )
            except SwingsError as error:  # a config refused its values
                fail(error, 2)
            run(config)
    except KeyboardInterrupt as error:
        sys.exit(128 + (error.number if isinstance(error, Ended) else signal.SIGINT))
    except (SwingsError, OSError) as error:
        if isinstance(error, OSError) and error.filename == OUTPUT:
            _forget_output()
            if isinstance(error, BrokenPipeError):
                sys.exit(OUTPUT_CLOSED)
        fail(error, 1)


@contextmanager
def _flushing() -> Iterator[None]:
    """Has what is printed in the block printed at its end, also at that of a help."""
    try:
        yield
    except SystemExit:
        with printing():
            sys.stdout.flush()
        raise
    with printing():
        sys.stdout.flush()


def _forget_output() -> None:
    """Discards buffered output, so that flushing it when the process exits does not fail again."""
    with suppress(OSError, ValueError):  # a test's output has no descriptor
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


def split_option(args: Sequence[str] | None, name: str, **kind: Any) -> tuple[Any, list[str]]:
    """The value of an option that must be known before the others are parsed, and the others.

    args: None for those of the command line. kind: as argparse's add_argument takes it.
    """
    # Not tyro.cli(return_unknown_args=True): asked for shell completion, it would complete this
    # one option only.
    first = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    first.add_argument(name, dest="value", **kind)
    known, others = first.parse_known_args(args)
    return known.value, others
