"""Settings from flags, environment, file and defaults, each before the next."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
import tyro
from hypothesis import given
from hypothesis import strategies as st

from codec.console import option, run_command
from codec.errors import InvalidError
from server.operate.log.logline import LogStyle
from server.operate.overload import OverloadConfig
from server.operate.settingfields import setting_fields
from server.operate.settings import SettingsConfig, settings_parser, settings_text
from server.state.config import ServerConfig
from tests.support.commands import ROOT


def twice(word: str) -> int:
    if not word.isdigit():
        raise InvalidError(f"{word!a} is not a number to double")
    return 2 * int(word)


@dataclass(frozen=True, slots=True)
class Command:
    """Much as that of swings-serve."""

    root: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="ROOT")]]
    """Folder."""
    host: str = "127.0.0.1"
    """Address."""
    style: LogStyle = LogStyle.PLAIN
    """Style."""
    mode: Literal["a", "b"] = "a"
    """Mode."""
    spread: bool = False
    """Whether."""
    key_file: Path | None = None
    """File."""
    doubled: Annotated[int, option("N", twice, lambda number: str(number // 2))] = 0
    """Number."""
    settings: tyro.conf.OmitArgPrefixes[SettingsConfig] = field(default_factory=SettingsConfig)
    server: tyro.conf.OmitArgPrefixes[ServerConfig] = field(default_factory=ServerConfig)
    overload: OverloadConfig = field(default_factory=OverloadConfig)


def read(folder: Path, toml: str = "", *flags: str, **variables: str) -> Command:
    """What the command would get."""
    arguments = list(flags)
    if toml:
        (folder / "swings.toml").write_text(toml)
        arguments += ["--config", str(folder / "swings.toml")]
    environment = {f"SWINGS_SERVE_{key}": value for key, value in variables.items()}
    parse = settings_parser("SWINGS_SERVE", environment | {"HOME": "/"})
    command = parse(Command, args=arguments, prog="x", config=(tyro.conf.EnumChoicesFromValues,))
    assert isinstance(command, Command)
    return replace(command, settings=SettingsConfig())


def test_each_source_goes_before_the_next(tmp_path: Path) -> None:
    toml = "max_plays = 1\nqueue_s = 1\nfirst_bytes = 1000"
    assert read(tmp_path, "", "r").server.max_plays == ServerConfig().max_plays
    assert read(tmp_path, toml, "r").server.max_plays == 1
    assert read(tmp_path, toml, "r", MAX_PLAYS="2").server.max_plays == 2
    assert read(tmp_path, toml, "r", "--max-plays", "3", MAX_PLAYS="2").server.max_plays == 3
    # What one source does not say, the one below does.
    session = read(tmp_path, toml, "r", QUEUE_S="2", MAX_PLAYS="2").server.session
    assert (session.queue_s, session.first_bytes) == (2.0, 1000)


def test_every_kind_of_setting_can_stand_everywhere(tmp_path: Path) -> None:
    command = read(
        tmp_path,
        'root = "streams"\nhost = "::"\nstyle = "json"\nmode = "b"\nspread = true\n'
        'key_file = "keys"\ndoubled = "21"\nrefresh_s = 3\n[overload]\nshed_from = 0.5\n',
    )
    assert command.root == Path("streams")
    assert (command.host, command.style, command.mode) == ("::", LogStyle.JSON, "b")
    assert (command.spread, command.key_file, command.doubled) == (True, Path("keys"), 42)
    assert command.server.refresh_s == 3.0
    assert command.overload == OverloadConfig(shed_from=0.5)
    same = read(
        tmp_path,
        ROOT="streams", HOST="::", STYLE="json", MODE="b", SPREAD="true", KEY_FILE="keys",
        DOUBLED="21", REFRESH_S="3", OVERLOAD_SHED_FROM="0.5",
    )  # fmt: skip
    assert same == command
    flags = "streams --host :: --style json --mode b --spread --key-file keys --doubled 21"
    more = "--refresh-s 3 --overload.shed-from 0.5"
    assert read(tmp_path, "", *f"{flags} {more}".split()) == command


def test_what_is_required_is_still_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        read(tmp_path, "max_plays = 5")
    assert ended.value.code == 2
    assert "ROOT" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("toml", "message"),
    [
        ("max_playz = 5", "swings.toml: unknown setting 'max_playz'; did you mean max_plays?"),
        ("zzz = 5", "swings.toml: unknown setting 'zzz'; --help lists all settings"),
        ("[server]\nmax_plays = 5", "swings.toml: unknown setting 'server.max_plays'"),
        ("shed_fro = 0.5", "unknown setting 'shed_fro'; did you mean shed_from?"),
        ("config = 'x'", "unknown setting 'config'"),
        ("max_plays = '5'", "swings.toml: max_plays: '5' is not a whole number"),
        ("max_plays = true", "swings.toml: max_plays: 'True' is not a whole number"),
        ("max_plays = 5.0", "swings.toml: max_plays: '5.0' is not a whole number"),
        ("refresh_s = 'soon'", "swings.toml: refresh_s: 'soon' is not a number"),
        ("spread = 1", "swings.toml: spread: '1' is not true or false"),
        ("host = 127", "swings.toml: host: '127' is not a text"),
        ("style = 'xml'", "swings.toml: style: 'xml' is not one of json, plain"),
        ("doubled = 'x'", "swings.toml: doubled: 'x' is not a number to double"),
        ("max_plays = [5]", "swings.toml: max_plays: '[5]' is not a whole number"),
        ("max_plays = 0", "swings.toml: max_plays: max_plays is 0; it must be positive"),
        ("max_plays = ", "swings.toml is not TOML"),
        ("a" * 2_000_000, "more than 1048576 bytes"),
        ("[overload]\nshed_from = 0.99", "swings.toml: overload.shed_from: shed_from is 0.99"),
    ],
)
def test_a_bad_setting_names_the_file(tmp_path: Path, toml: str, message: str) -> None:
    with pytest.raises(InvalidError) as raised:
        read(tmp_path, toml, "r")
    assert message in str(raised.value)


@pytest.mark.parametrize(
    ("variable", "value", "message"),
    [
        (
            "MAX_PLAYZ",
            "5",
            "unknown setting 'SWINGS_SERVE_MAX_PLAYZ'; did you mean SWINGS_SERVE_MAX_PLAYS?",
        ),
        ("CHECK_CONFIG", "1", "unknown setting 'SWINGS_SERVE_CHECK_CONFIG'"),
        ("MAX_PLAYS", "many", "SWINGS_SERVE_MAX_PLAYS: 'many' is not a whole number"),
        ("MAX_PLAYS", "", "SWINGS_SERVE_MAX_PLAYS: '' is not a whole number"),
        ("MAX_PLAYS", "0", "SWINGS_SERVE_MAX_PLAYS: max_plays is 0; it must be positive"),
        ("SPREAD", "maybe", "SWINGS_SERVE_SPREAD: 'maybe' is neither true nor false"),
        ("MODE", "c", "SWINGS_SERVE_MODE: 'c' is not one of a, b"),
    ],
)
def test_a_bad_setting_names_the_variable(
    tmp_path: Path, variable: str, value: str, message: str
) -> None:
    with pytest.raises(InvalidError) as raised:
        read(tmp_path, "", "r", **{variable: value})
    assert message in str(raised.value)


def test_values_that_go_together_are_judged_together(tmp_path: Path) -> None:
    """The file's 0.97 would be refused beside the default, and is not beside 0.99."""
    toml = "[overload]\nshed_from = 0.97"
    overload = read(tmp_path, toml, "r", OVERLOAD_REFUSE_FROM="0.99").overload
    assert (overload.shed_from, overload.refuse_from) == (0.97, 0.99)


def test_the_file_can_be_named_by_the_environment(tmp_path: Path) -> None:
    path = tmp_path / "other.toml"
    path.write_text("max_plays = 9")
    assert read(tmp_path, "", "r", CONFIG=str(path)).server.max_plays == 9
    assert read(tmp_path, "max_plays = 8", "r", CONFIG=str(path)).server.max_plays == 8
    with pytest.raises(InvalidError, match=r"absent.toml cannot be read"):
        read(tmp_path, "", "r", CONFIG=str(tmp_path / "absent.toml"))


def test_settings_are_called_what_the_help_calls_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        read(tmp_path, "nonsense = 1", "--help")
    assert ended.value.code == 0
    flags = set(re.findall(r"--([a-z][a-z0-9.-]+)", capsys.readouterr().out))
    flags = {flag for flag in flags if not flag.startswith("no-")} - {"help", "config"}
    names = {
        ".".join(one.keys).replace("_", "-") for one in setting_fields(Command, SettingsConfig)
    }
    assert flags - {"check-config"} == names - {"root"}


def test_the_settings_printed_are_a_file_that_gives_them_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flags = ["r", "--host", 'a"\\b\x1b', "--max-plays", "7", "--overload.shed-from", "0.125"]
    with pytest.raises(SystemExit) as ended:
        read(tmp_path, "live_idle_s = 2", *flags, "--check-config", STYLE="json")
    assert ended.value.code == 0
    printed = capsys.readouterr().out
    assert tomllib.loads(printed)["overload"]["shed_from"] == 0.125
    assert "# key_file is not set\n" in printed
    before = read(tmp_path, "live_idle_s = 2", *flags, STYLE="json", DOUBLED="4")
    assert before.doubled == 8
    assert read(tmp_path, settings_text(before)) == before


@given(st.text(st.characters(exclude_categories=["Cs"])))
def test_any_text_is_printed_so_that_it_is_read_again(text: str) -> None:
    told = settings_text(Command(Path("r"), host=text))
    assert tomllib.loads(told)["host"] == text


@given(st.text(max_size=100), st.text(max_size=20))
def test_any_file_and_any_variable_give_settings_or_one_line(
    tmp_path_factory: Any, toml: str, value: str
) -> None:
    folder = tmp_path_factory.mktemp("any")
    (folder / "swings.toml").write_bytes(toml.encode("utf-8", "surrogatepass"))
    parse = settings_parser("S", {"S_MAX_PLAYS": value, "S_REFRESH_S": value, "S_MODE": "a"})
    try:
        parse(Command, args=["r", "--config", str(folder / "swings.toml")])
    except InvalidError as error:
        assert str(error)  # noqa: PT017


def main(run: Callable[[Command], None] = lambda _: None) -> None:
    run_command(Command, run, "swings-serve", "Serves.", settings_parser("SWINGS_SERVE"))


def test_as_a_process_a_bad_setting_is_one_line_and_exit_2(tmp_path: Path) -> None:
    code = "from tests.server.operate.test_settings import main; main()"

    def run(*flags: str, **variables: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-c", code, *flags],
            cwd=ROOT,
            env={"SWINGS_SERVE_ROOT": "r", **variables},
            capture_output=True,
            text=True,
        )

    done = run(SWINGS_SERVE_MAX_PLAYS="many")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "swings-serve: SWINGS_SERVE_MAX_PLAYS: 'many' is not a whole number\n"
    done = run("--check-config", SWINGS_SERVE_MAX_PLAYS="5")
    assert (done.returncode, done.stderr) == (0, "")
    assert 'root = "r"\n' in done.stdout
    assert "max_plays = 5\n" in done.stdout
    assert run().returncode == 0
