"""Settings from a file and from the environment, below those of the command line.

    flags > environment > file > defaults

Rule: a setting that cannot be used ends the command with one line that names the file or the
variable it is from. None is passed over.
"""

from __future__ import annotations

import difflib
import os
import re
import sys
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import tyro

from codec.console import split_option
from codec.errors import InvalidError

from .settingfields import SettingField, setting_fields

MAX_FILE_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class SettingsConfig:
    """Sources of settings. Every option can also be set in a file and in the environment."""

    config: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """TOML file of options, named with _ instead of -, such as max_plays = 500. Environment
    variables and command-line options override it."""
    check_config: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print the effective settings as a TOML file, and exit."""


@dataclass(frozen=True, slots=True)
class _Given:
    """A setting that was given."""

    field: SettingField
    value: Any
    source: str


def settings_parser(prefix: str, environment: Mapping[str, str] = os.environ) -> Callable[..., Any]:
    """A `parse` for `run_command`, called like tyro.cli, that also reads a file and variables.

    prefix: of the variables, as SWINGS_SERVE: `SWINGS_SERVE_MAX_PLAYS=5` is `--max-plays 5`, and
    `SWINGS_SERVE_CONFIG` is `--config`. The config type has a SettingsConfig among its parts, with
    its prefix omitted. With `--check-config` the settings are printed and the process exits with 0.
    Raises InvalidError for a setting that cannot be used.
    """

    def parse(config_type: type[Any], args: Sequence[str], **options: Any) -> Any:
        known = setting_fields(config_type, SettingsConfig)
        path, _ = split_option(args, "--config")
        path = path or environment.get(f"{prefix}_CONFIG")
        if not {"-h", "--help"} & set(args):
            given = _of_file(Path(path), known) if path else {}
            given |= _of_environment(prefix, environment, known)
            if given:
                options["default"] = _instance(config_type, (), given)
        command = tyro.cli(config_type, args=args, **options)
        if any(one.check_config for one in _parts(command, SettingsConfig)):
            sys.stdout.write(settings_text(command))
            sys.exit(0)
        return command

    return parse


def settings_text(command: Any) -> str:
    """The settings of `command` as a TOML file; those that are not set are comments."""
    lines, tables = list[str](), dict[tuple[str, ...], list[str]]()
    for one in setting_fields(type(command), SettingsConfig):
        value = command
        for name in one.path:
            value = getattr(value, name)
        *table, key = one.keys
        line = f"# {key} is not set" if value is None else f"{key} = {_toml(one.to_toml(value))}"
        (tables.setdefault(tuple(table), []) if table else lines).append(line)
    for names, inside in tables.items():
        lines += ["", f"[{'.'.join(names)}]", *inside]
    return "\n".join(lines) + "\n"


def _toml(value: bool | int | float | str) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return str(value)
    escaped = re.sub(r'[\x00-\x1f"\\\x7f]', lambda match: f"\\u{ord(match[0]):04x}", value)
    return f'"{escaped}"'


def _of_file(path: Path, known: Sequence[SettingField]) -> dict[tuple[str, ...], _Given]:
    try:
        with open(path, "rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise InvalidError(f"config file {path} cannot be read: {error.strerror}") from error
    if len(data) > MAX_FILE_BYTES:
        raise InvalidError(f"{path} has more than {MAX_FILE_BYTES} bytes; it is not a config file")
    try:
        tables = tomllib.loads(data.decode())
    except (ValueError, RecursionError) as error:
        raise InvalidError(f"{path} is not TOML: {error}") from error
    by_keys = {one.keys: one for one in known}
    given = {}
    for keys, value in _flat(tables, ()):
        found, name = by_keys.get(keys), ".".join(keys)
        if found is None:
            names = [".".join(one) for one in by_keys]
            raise InvalidError(f"{path}: unknown setting {name[:80]!a}{_hint(name, names)}")
        try:
            given[found.path] = _Given(found, found.from_toml(value), f"{path}: {name}")
        except InvalidError as error:
            raise InvalidError(f"{path}: {name}: {error}") from error
    return given


def _flat(table: dict[str, Any], keys: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Any]]:
    for key, value in table.items():
        if isinstance(value, dict) and value:
            yield from _flat(value, (*keys, key))
        else:
            yield (*keys, key), value


def _of_environment(
    prefix: str, environment: Mapping[str, str], known: Sequence[SettingField]
) -> dict[tuple[str, ...], _Given]:
    by_variable = {f"{prefix}_{one.variable}": one for one in known}
    given = {}
    for variable, text in sorted(environment.items()):
        if not variable.startswith(f"{prefix}_") or variable == f"{prefix}_CONFIG":
            continue
        found = by_variable.get(variable)
        if found is None:
            hint = _hint(variable, list(by_variable))
            raise InvalidError(f"environment: unknown setting {variable[:80]!a}{hint}")
        try:
            given[found.path] = _Given(found, found.from_text(text), variable)
        except InvalidError as error:
            raise InvalidError(f"{variable}: {error}") from error
    return given


def _hint(name: str, names: list[str]) -> str:
    near = difflib.get_close_matches(name, names, n=1)
    return f"; did you mean {near[0]}?" if near else "; --help lists all settings"


def _instance(
    config_type: type[Any], path: tuple[str, ...], given: Mapping[tuple[str, ...], _Given]
) -> Any:
    """The config with what was given; tyro still asks for what is given nowhere."""
    here = {key[len(path)] for key in given if key[: len(path)] == path}
    values: dict[str, Any] = {}
    for one in fields(config_type):
        own = (*path, one.name)
        if own in given:
            values[one.name] = given[own].value
        elif one.name in here:
            part = one.default if one.default_factory is MISSING else one.default_factory()
            values[one.name] = _replaced(part, own, given)
    required = {
        one.name: tyro.MISSING
        for one in fields(config_type)
        if one.name not in values and one.default is one.default_factory is MISSING
    }
    return _checked(lambda: config_type(**required, **values), path, given)


def _replaced(part: Any, path: tuple[str, ...], given: Mapping[tuple[str, ...], _Given]) -> Any:
    """`part`, which stands at `path`, with what was given for it."""
    changed: dict[str, Any] = {}
    for one in fields(part):
        own = (*path, one.name)
        if own in given:
            changed[one.name] = given[own].value
        elif any(key[: len(own)] == own for key in given):
            changed[one.name] = _replaced(getattr(part, one.name), own, given)
    return _checked(lambda: replace(part, **changed), path, given)


def _checked(
    make: Callable[[], Any], path: tuple[str, ...], given: Mapping[tuple[str, ...], _Given]
) -> Any:
    """What `make` makes; where it refuses its values, the error says where they are from."""
    try:
        return make()
    except InvalidError as error:
        here = [one for key, one in given.items() if key[: len(path)] == path]
        words = set(re.findall(r"\w+", str(error)))
        named = [one for one in here if one.field.path[-1] in words]
        sources = ", ".join(one.source for one in named or here)
        raise InvalidError(f"{sources}: {error}") from error


def _parts(config: Any, wanted: type[Any]) -> Iterator[Any]:
    for one in fields(config):
        value = getattr(config, one.name)
        if isinstance(value, wanted):
            yield value
        elif is_dataclass(value):
            yield from _parts(value, wanted)
