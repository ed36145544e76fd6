"""Settings from the environment: words in front of those of the command line.

    flags > environment > defaults

Rule: there is no second list of options: every field of a command is also a variable, and tyro
reads its value.
"""

from __future__ import annotations

import difflib
import os
import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any, get_type_hints

import tyro

from codec.console import cli
from codec.errors import InvalidError

CHECK_CONFIG = "check_config"
"""The command's field for `--check-config`. It is a request, not a setting."""

ROOT = "root"
"""The command's field without a flag."""

_TRUTH = {"true": True, "1": True, "false": False, "0": False}

_BARE = re.compile(r"[\w@%+=:,./*?\[\]-]*", re.ASCII)
"""Text that systemd, a shell and `docker run --env-file` read alike without quotes."""

_NOT_ON_A_LINE = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")


def settings_of(prefix: str, command: Any) -> dict[str, Any]:
    """The values of `command` by their variables, in the order of its fields."""
    hints, found = get_type_hints(type(command), include_extras=True), dict[str, Any]()
    for one in fields(command):
        value, marks = getattr(command, one.name), getattr(hints[one.name], "__metadata__", ())
        if one.name == CHECK_CONFIG or tyro.conf.Fixed in marks:  # no option, see Constant
            continue
        if is_dataclass(value):
            found |= settings_of(prefix, value)
        else:
            found[f"{prefix}_{one.name.upper()}"] = value
    return found


def settings_parser(prefix: str, environment: Mapping[str, str] = os.environ) -> Callable[..., Any]:
    """A `parse` for `run_command` that also reads environment variables: with the prefix
    SWINGS_SERVE, `SWINGS_SERVE_MAX_PLAYS=5` is `--max-plays=5`.

    Raises InvalidError for a variable that no option has.
    """

    def parse(config_type: type[Any], args: Sequence[str], **options: Any) -> Any:
        if {"-h", "--help", "--help-all"} & set(args):
            return cli(config_type, args=args, **options)
        known, words = settings_of(prefix, config_type()), list[str]()
        for variable, text in sorted(environment.items()):
            if not variable.startswith(f"{prefix}_"):
                continue
            if variable not in known:
                raise InvalidError(_unknown(variable, prefix, known))
            name = variable.removeprefix(f"{prefix}_").lower()
            flag = f"--{name.replace('_', '-')}"
            if name == ROOT:  # one on the command line takes its place
                options["default"] = replace(config_type(), **{ROOT: text})
            elif not isinstance(known[variable], bool):
                words.append(f"{flag}={text}")
            elif text.lower() not in _TRUTH:
                raise InvalidError(f"{variable}: {text[:60]!a} is neither true nor false")
            elif _TRUTH[text.lower()]:
                words.append(flag)
        return cli(config_type, args=(*words, *args), **options)

    return parse


def _unknown(variable: str, prefix: str, known: Mapping[str, Any]) -> str:
    # Without the prefix, which would make any two variables look alike.
    names = [name.removeprefix(f"{prefix}_") for name in known]
    near = difflib.get_close_matches(variable.removeprefix(f"{prefix}_"), names, n=1)
    hint = f"did you mean {prefix}_{near[0]}?" if near else "--help-all lists all settings"
    return f"environment: unknown setting {variable[:80]!a}; {hint}"


def settings_variables(prefix: str, command: Any) -> dict[str, str]:
    """The variables that say what `command` says, but for what is not set."""
    return {
        variable: str(value).lower() if isinstance(value, bool) else str(value)
        for variable, value in settings_of(prefix, command).items()
        if value is not None
    }


def settings_text(prefix: str, command: Any) -> str:
    """The settings of `command` as an environment file: one a line, defaults as comments, so that
    a later version may change them.

    Raises InvalidError for a value that no line of such a file can hold.
    """
    lines, given = [], settings_variables(prefix, command)
    defaults = settings_variables(prefix, type(command)())
    for variable in settings_of(prefix, command):
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
