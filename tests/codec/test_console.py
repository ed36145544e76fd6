"""What all commands do with their command line."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import pytest
import tyro

from codec.console import run_command
from codec.errors import InvalidError, SwingsError


@dataclass(frozen=True)
class Number:
    """Which number to think of."""

    value: tyro.conf.Positional[int]
    """The number."""
    twice: bool = False
    """Think of twice the number."""

    def __post_init__(self) -> None:
        if self.value == 13:
            raise InvalidError("value 13: choose\nanother")


def think(number: Number) -> None:
    if number.value < 0:
        raise SwingsError(f"{number.value} is below 0")
    sys.stdout.write(f"{number}\n")


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch) -> Any:
    def command(*arguments: str, **options: Any) -> None:
        monkeypatch.setattr("sys.argv", ["think", *arguments])
        run_command(Number, think, "think", "Thinks of a number.", **options)

    return command


def test_one_line_and_an_exit_code_say_what_is_wrong(
    command: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    command("7", "--twice")
    assert capsys.readouterr().out == "Number(value=7, twice=True)\n"
    for arguments, status, message in (
        (["-3"], 1, "think: -3 is below 0\n"),
        (["seven"], 2, None),
        (["7", "--thrice"], 2, None),
        (["7", "--verb"], 2, None),  # no abbreviations
        ([], 2, None),
    ):
        with pytest.raises(SystemExit) as ended:
            command(*arguments)
        assert ended.value.code == status
        shown = capsys.readouterr()
        assert shown.out == ""
        assert message in (None, shown.err)


@pytest.mark.parametrize("arguments", [["--verbose", "-3"], ["-3", "--verbose", "--twice"]])
def test_verbose_anywhere_shows_the_traceback(command: Any, arguments: Sequence[str]) -> None:
    with pytest.raises(SwingsError, match="-3 is below 0"):
        command(*arguments)


def test_help_and_completion_are_those_of_the_command(
    command: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    for arguments in (["--help"], ["--tyro-print-completion", "bash"]):
        with pytest.raises(SystemExit) as ended:
            command(*arguments)
        assert not ended.value.code
        assert "--twice" in capsys.readouterr().out


def test_a_command_may_parse_in_its_own_way(
    command: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    def parse(config_type: type[Number], args: Sequence[str], **options: Any) -> Number:
        found = tyro.cli(config_type, args=args, **options)
        return config_type(found.value + 1)

    command("7", "--verbose", parse=parse)
    assert capsys.readouterr().out == "Number(value=8, twice=False)\n"
    with pytest.raises(SystemExit) as ended:
        command("12", parse=parse)
    assert ended.value.code == 2
    assert capsys.readouterr().err == "think: value 13: choose another\n"
