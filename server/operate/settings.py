"""Settings from the environment: words in front of those of the command line.

    flags > environment > defaults

Rule: there is no second list of options: every flag that tyro makes is also a variable, and tyro
reads its value.
"""

from __future__ import annotations

import difflib
import os
import re
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from operator import attrgetter
from typing import Any, get_type_hints

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from codec.console import cli
from codec.errors import InvalidError

CHECK_CONFIG = "check_config"
"""The command's field for `--check-config`. It is a request, not a setting."""

_TRUTH = {"true": True, "1": True, "false": False, "0": False}

_BARE = re.compile(r"[\w@%+=:,./*?\[\]-]*", re.ASCII)
"""Text that systemd, a shell and `docker run --env-file` read alike without quotes."""

_NOT_ON_A_LINE = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")


@dataclass(frozen=True, slots=True)
class Setting:
    """A setting of a command."""

    path: str
    """Names of the fields that lead to it, with dots between them."""
    flag: str
    """Its flag without the dashes, as `overload.shed-from`."""
    is_switch: bool
    """Whether it is true or false, and its flag takes no value."""
    is_positional: bool
    """Whether it has no flag."""
    spec: PrimitiveConstructorSpec[Any]
    """How tyro reads and writes its value."""

    def to_text(self, value: Any) -> str:
        """What the command line has for `value`, which is not None."""
        (text,) = self.spec.str_from_instance(value)
        return text.lower() if self.is_switch else text

    def words(self, text: str) -> list[str]:
        """What `text` is on the command line. Raises InvalidError."""
        if not self.is_switch:
            return [f"--{self.flag}={text}"]
        if text.lower() not in _TRUTH:
            raise InvalidError(f"{text[:60]!a} is neither true nor false")
        return [f"--{self.flag}"] if _TRUTH[text.lower()] else []


def settings_of(prefix: str, config_type: type[Any]) -> dict[str, Setting]:
    """The settings of a command by their variables, in the order of the fields."""
    return {
        f"{prefix}_{re.sub('[.-]', '_', one.flag).upper()}": one
        for one in _walk(config_type, "", "", {tyro.conf.EnumChoicesFromValues})
        if one.path != CHECK_CONFIG
    }


def _walk(config_type: type[Any], path: str, flag: str, markers: set[Any]) -> Iterator[Setting]:
    hints = get_type_hints(config_type, include_extras=True)
    for name, hint in ((one.name, hints[one.name]) for one in fields(config_type)):
        info = PrimitiveTypeInfo.make(hint, markers)
        if tyro.conf.Fixed in info.markers:
            continue
        own_flag = flag + name.replace("_", "-")
        if is_dataclass(info.type):
            # tyro applies the marker to all levels below.
            below = flag if tyro.conf.OmitArgPrefixes in info.markers else f"{own_flag}."
            yield from _walk(info.type, f"{path}{name}.", below, info.markers)
        else:
            spec = ConstructorRegistry.get_primitive_spec(info)
            if not isinstance(spec, PrimitiveConstructorSpec):
                raise TypeError(f"no setting can be of type {hint}")
            is_positional = tyro.conf.Positional in info.markers
            yield Setting(path + name, own_flag, info.type is bool, is_positional, spec)


def settings_parser(prefix: str, environment: Mapping[str, str] = os.environ) -> Callable[..., Any]:
    """A `parse` for `run_command` that also reads environment variables: with the prefix
    SWINGS_SERVE, `SWINGS_SERVE_MAX_PLAYS=5` is `--max-plays=5`.

    Raises InvalidError for a variable that no option has.
    """

    def parse(config_type: type[Any], args: Sequence[str], **options: Any) -> Any:
        if not {"-h", "--help", "--help-all"} & set(args):
            known, words = settings_of(prefix, config_type), list[str]()
            for variable, text in sorted(environment.items()):
                if not variable.startswith(f"{prefix}_"):
                    continue
                one = _found(variable, known, prefix)
                if one.is_positional:  # one on the command line takes its place
                    options["default"] = _defaults(config_type, {one.path: text})
                else:
                    try:
                        words += one.words(text)
                    except InvalidError as error:
                        raise InvalidError(f"{variable}: {error}") from error
            args = (*words, *args)
        return cli(config_type, args=args, **options)

    return parse


def _found(variable: str, known: Mapping[str, Setting], prefix: str) -> Setting:
    if variable not in known:
        # Without the prefix, which would make any two variables look alike.
        names = [name.removeprefix(f"{prefix}_") for name in known]
        near = difflib.get_close_matches(variable.removeprefix(f"{prefix}_"), names, n=1)
        hint = f"did you mean {prefix}_{near[0]}?" if near else "--help-all lists all settings"
        raise InvalidError(f"environment: unknown setting {variable[:80]!a}; {hint}")
    return known[variable]


def _defaults(config_type: type[Any], given: Mapping[str, Any]) -> Any:
    """The defaults of a command; fields that have none are as `given`, or tyro.MISSING, which tyro
    reports."""
    required = [one.name for one in fields(config_type) if one.default is one.default_factory]
    return config_type(**{**dict.fromkeys(required, tyro.MISSING), **given})


def settings_text(prefix: str, command: Any) -> str:
    """The settings of `command` as an environment file: one a line, defaults as comments, so that
    a later version may change them.

    Raises InvalidError for a value that no line of such a file can hold.
    """
    lines, given = [], settings_variables(prefix, command)
    defaults = settings_variables(prefix, _defaults(type(command), {}))
    for variable in settings_of(prefix, type(command)):
        if variable not in given:
            lines.append(f"# {variable} is not set\n")
            continue
        text = given[variable]
        if _NOT_ON_A_LINE.search(text):
            raise InvalidError(
                f"{variable}: {text[:60]!a} has control characters or is not Unicode; an "
                "environment file cannot hold it"
            )
        mark = "# " if text == defaults.get(variable) else ""
        lines.append(f"{mark}{variable}={text if _BARE.fullmatch(text) else shlex.quote(text)}\n")
    return "".join(lines)


def settings_variables(prefix: str, command: Any) -> dict[str, str]:
    """The variables that say what `command` says, but for what is not set."""
    values = {
        variable: (one, attrgetter(one.path)(command))
        for variable, one in settings_of(prefix, type(command)).items()
    }
    return {
        variable: one.to_text(value)
        for variable, (one, value) in values.items()
        if value is not None and value is not tyro.MISSING
    }
