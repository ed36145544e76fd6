"""The help of a command: its everyday options in groups, the others behind --help-all.

tyro parses the command line. Its own help is one list of all options, which keeps the line breaks
of our sources. Here, as there, the options come from the fields of a dataclass and their
docstrings, and a union of dataclasses is a choice of subcommands.
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import re
import shutil
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from functools import cache, partial
from itertools import pairwise
from types import SimpleNamespace, UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

Groups = Mapping[str, Sequence[str]]
"""Titles, and below each the everyday options, without dashes. A config that has very many options
has such a ClassVar, EVERYDAY; the options that it does not name are shown by --help-all."""

MORE = "More options"
"""Title of the options of the config itself that are in no group."""

COLUMN = 26
"""Column at which explanations begin."""

WIDEST = 100
"""Columns of text that are still easy to read."""

_PLAIN = {"INT": "N", "FLOAT": "NUMBER", "STR": "TEXT"}

_SAYS_NOTHING = {"", ":", "0:"}
"""Defaults that mean nothing is chosen."""

_ARGUMENT: Any = type(tyro.conf.arg())


@dataclasses.dataclass(frozen=True, slots=True)
class Option:
    """An option, or an argument without a name."""

    flag: str
    """Its name without dashes; empty for an argument."""
    usage: str
    """What is typed, such as `--frames A:B`."""
    about: str
    group: str
    """What it belongs to: the purpose of the dataclass, MORE for the outermost one."""
    is_required: bool


def subcommands_of(config_type: Any) -> dict[str, Any]:
    """The dataclass of each subcommand by its name; empty for a command that has none."""
    for hint in get_type_hints(config_type).values():
        kinds = get_args(hint) if get_origin(hint) in (Union, UnionType) else ()
        if kinds and all(map(dataclasses.is_dataclass, kinds)):
            return {re.sub(r"(?<!^)(?=[A-Z])", "-", k.__name__).lower(): k for k in kinds}
    return {}


def options_of(config_type: Any, default: Any = None) -> list[Option]:
    """The options of a dataclass, or of a partial of one. default: whose values are shown."""
    if isinstance(config_type, partial):
        default = SimpleNamespace(**config_type.keywords)
        config_type = config_type.func
    return list(_walk(config_type, default, "", MORE, {tyro.conf.EnumChoicesFromValues}))


def _walk(kind: Any, values: Any, prefix: str, group: str, markers: set[Any]) -> Iterator[Option]:
    hints, about = get_type_hints(kind, include_extras=True), _field_docs(kind)
    for one in sorted(dataclasses.fields(kind), key=lambda field: bool(field.kw_only)):
        hint = hints[one.name]
        info = PrimitiveTypeInfo.make(hint, markers)
        if tyro.conf.Fixed in info.markers:
            continue
        extras = getattr(hint, "__metadata__", ())
        name, metavar, text = one.name.replace("_", "-"), None, about.get(one.name, "")
        for extra in extras:
            if isinstance(extra, _ARGUMENT):
                name = name if extra.name is None else extra.name
                metavar = extra.metavar or metavar
                text = extra.help or text
        value = getattr(values, one.name, _default_of(one))
        has_parser = any(isinstance(extra, PrimitiveConstructorSpec) for extra in extras)
        if dataclasses.is_dataclass(info.type) and not has_parser:
            is_plain = tyro.conf.OmitArgPrefixes in info.markers
            below = prefix if is_plain or not name else f"{prefix}{name}."
            title = group if not name else about.get(one.name, name).partition(".")[0]
            yield from _walk(info.type, value, below, title, info.markers)
            continue
        spec = ConstructorRegistry.get_primitive_spec(info)
        if not isinstance(spec, PrimitiveConstructorSpec):
            raise TypeError(f"no option can be of type {hint}")
        is_required = value is dataclasses.MISSING or value is tyro.MISSING
        metavar = _readable(metavar or spec.metavar)
        explained = " ".join(text.split())
        if tyro.conf.Positional in info.markers:
            metavar = one.name.upper() if metavar == "PATH" else metavar
            usage = metavar if is_required else f"[{metavar}]"
            yield Option("", usage, explained, "", is_required)
            continue
        flag, is_switch = prefix + name, info.type is bool and not is_required
        usage = f"--{flag} {metavar}".strip()
        if is_switch:
            usage = f"--{prefix}no-{name}" if value else f"--{flag}"
            explained += " (default: on; this switches it off)" if value else ""
        elif is_required:
            explained += " (required)"
        elif value is not None:
            shown = " ".join(spec.str_from_instance(value))
            explained += "" if shown in _SAYS_NOTHING else f" (default: {shown})"
        yield Option(flag, usage, explained, group, is_required)


def _default_of(field: dataclasses.Field[Any]) -> Any:
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return field.default


def _readable(metavar: str) -> str:
    """A placeholder without Python's types."""
    shown = metavar.replace("{None}|", "").replace("{None,", "{")
    shown = re.sub(r"\b(INT|FLOAT|STR)\b", lambda found: _PLAIN[found[1]], shown)
    shown = re.sub(r"\[(\w+) \[\1 \.\.\.\]\]", r"\1 ...", shown)
    return shown if "," in shown else re.sub(r"^\{(\w+)\}$", r"\1", shown)


@cache
def _field_docs(kind: type[Any]) -> dict[str, str]:
    """The docstrings below the fields of a dataclass and of those that it is made from."""
    docs = {}
    for one in reversed(kind.__mro__):
        if not dataclasses.is_dataclass(one):
            continue
        try:
            source = inspect.getsource(one)
        except OSError:  # of a class that stands in no file
            continue
        (made,) = ast.parse(textwrap.dedent(source)).body
        assert isinstance(made, ast.ClassDef)
        for field, text in pairwise(made.body):
            match field, text:
                case (
                    ast.AnnAssign(target=ast.Name(id=name)),
                    ast.Expr(value=ast.Constant(value=str(about))),
                ):
                    docs[name] = about
    return docs


def help_text(
    config_type: Any,
    args: Sequence[str],
    prog: str,
    description: str = "",
    default: Any = None,
    columns: int | None = None,
) -> str:
    """The help that `args` ask for, which may name a subcommand and --help-all. default: whose
    values are shown as such. columns: those of the terminal."""
    for word in args:
        chosen = subcommands_of(_class_of(config_type)).get(word)
        if chosen is not None:
            config_type, default = chosen, None
            prog, description = f"{prog} {word}", _purpose(chosen)
    width = min(columns or shutil.get_terminal_size().columns, WIDEST)
    page = _Page(width)
    choices = subcommands_of(_class_of(config_type))
    if choices:
        page.text(f"usage: {prog} COMMAND ...")
        page.text(description)
        page.title("Commands")
        for name, kind in choices.items():
            page.row(name, _purpose(kind))
        page.title("Help")
        page.row("COMMAND --help", "Explain a command.")
    else:
        _describe_options(page, config_type, prog, description, default, "--help-all" in args)
    page.row("--verbose", "Show debug logs and, on failure, the traceback.")
    page.row("--version", "Print the version of swings.")
    return "\n".join(page.lines)


def _class_of(config_type: Any) -> Any:
    return config_type.func if isinstance(config_type, partial) else config_type


def _purpose(kind: Any) -> str:
    return " ".join((kind.__doc__ or "").split())


def _describe_options(
    page: _Page, config_type: Any, prog: str, description: str, default: Any, shows_all: bool
) -> None:
    options = options_of(config_type, default)
    arguments = [one for one in options if not one.flag]
    flags = {one.flag: one for one in options if one.flag}
    everyday: Groups = getattr(_class_of(config_type), "EVERYDAY", {})
    groups = {title: [flags.pop(flag) for flag in names] for title, names in everyday.items()}
    num_more = len(flags)
    if shows_all or not everyday:
        for one in flags.values():
            title = one.group if everyday or one.group != MORE else "Options"
            groups.setdefault(title, []).append(one)
    words = [one.usage for one in arguments]
    words += [one.usage for one in options if one.flag and one.is_required]
    page.text(" ".join([f"usage: {prog}", *words, "[options]"]))
    page.text(description)
    page.lines.append("")
    for one in arguments:
        page.row(one.usage, one.about)
    for title, found in groups.items():
        page.title(title)
        for one in found:
            page.row(one.usage, one.about)
    page.title("Help")
    page.row("-h, --help", "Show this help.")
    if everyday and not shows_all:
        page.row("--help-all", f"Show {num_more} more options.")


class _Page:
    """Lines of text that fit into a width."""

    def __init__(self, width: int) -> None:
        self._width = width
        self.lines: list[str] = []

    def text(self, text: str) -> None:
        """A paragraph, with an empty line before it unless it is the first."""
        self.lines += [""] * bool(self.lines) + _wrapped(text, self._width)

    def title(self, title: str) -> None:
        self.lines += ["", f"{title}:"]

    def row(self, usage: str, about: str) -> None:
        """What is typed, and beside it, or below where it is long, what it means."""
        column = min(COLUMN, self._width // 3)
        beside = _wrapped(about, self._width - column)
        typed = f"  {usage}"
        if len(typed) + 2 <= column and beside:
            self.lines.append(f"{typed:<{column}}{beside.pop(0)}")
        else:
            self.lines.append(typed)
        self.lines += [" " * column + line for line in beside]


def _wrapped(text: str, width: int) -> list[str]:
    return textwrap.wrap(text, width, break_on_hyphens=False, break_long_words=False)
