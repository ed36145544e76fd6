"""The command line that all commands share, their progress, and swings-stream as a process."""

from __future__ import annotations

import io
import re
import signal
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import tyro
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

import codec
from codec.console import Ended, ending_by_signals, run_command
from codec.errors import InvalidError, SwingsError
from codec.helptext import help_text
from codec.progressline import Stage, counted, line_of
from tests.support.commands import ROOT
from tests.support.hostile import refused
from tests.support.waiting import BOUND_S
from trainer.run.config import TrainConfig


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


def test_what_is_wrong_is_one_line(command: Any, capsys: pytest.CaptureFixture[str]) -> None:
    command("7", "--twice")
    assert capsys.readouterr().out == "Number(value=7, twice=True)\n"
    for arguments, status, message in (
        (["-3"], 1, "think: -3 is below 0\n"),
        (["seven"], 2, None),
        (["7", "--thrice"], 2, None),
        (["7", "--verb"], 2, None),  # no abbreviations
        ([], 2, None),
    ):
        assert refused(SystemExit, "", command, *arguments).code == status
        shown = capsys.readouterr()
        assert shown.out == ""
        assert message in (None, shown.err)


@pytest.mark.parametrize("arguments", [["--verbose", "-3"], ["-3", "--verbose", "--twice"]])
def test_verbose_anywhere_shows_the_traceback(command: Any, arguments: Sequence[str]) -> None:
    refused(SwingsError, "-3 is below 0", command, *arguments)


def test_help_version_and_completion(command: Any, capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in (["--help"], ["--tyro-print-completion", "bash"]):
        assert not refused(SystemExit, "", command, *arguments).code
        assert "--twice" in capsys.readouterr().out
    command("--version")
    assert capsys.readouterr().out == f"think {codec.__version__}\n"


@pytest.mark.parametrize("columns", [60, 80, 150])
def test_everyday_options_come_first_and_lines_are_full(columns: int) -> None:
    told, whole = (
        help_text(TrainConfig, [word], "train", "Trains.", columns=columns)
        for word in ("--help", "--help-all")
    )
    assert re.search(r"Quality and time:\n  --preset \{cpu,fast,fine,gpu,paper\}\n +Set of", told)
    assert "--calm-from" not in told
    assert "\n\nMore options:\n" in whole
    assert "\n\nLearning rates:\n  --optimiser." in whole
    assert "--no-" not in whole
    assert not re.search(r"None|INT|FLOAT|STR\b|default: :|default: \)", whole)
    column = min(26, columns // 3)
    for line, after in pairwise(whole.splitlines()):
        assert len(line) <= columns
        if after.startswith(" " * column) and line[column - 2 :].startswith("  "):
            assert len(line) + 1 + len(after.split()[0]) > min(columns, 100)


def test_a_parser_of_its_own(command: Any, capsys: pytest.CaptureFixture[str]) -> None:
    def parse(config_type: type[Number], args: Sequence[str], **options: Any) -> Number:
        found = tyro.cli(config_type, args=args, **options)
        return config_type(found.value + 1)

    command("7", "--verbose", parse=parse)
    assert capsys.readouterr().out == "Number(value=8, twice=False)\n"
    assert refused(SystemExit, "", command, "12", parse=parse).code == 2
    assert capsys.readouterr().err == "think: value 13: choose another\n"


SLEEPER = """
import sys
from signal import *
from threading import Event
from codec.console import run_command
from tests.codec.test_console import Number

if "ignoring" in sys.argv:
    signal(SIGHUP, SIG_IGN)

def rest(number):
    try:
        print("asleep", flush=True)
        while not Event().wait(0.1):  # pause() would miss a signal that comes just before it
            pass
    finally:
        print("cleaning", flush=True)
        sys.stdin.readline()
        print("clean", flush=True)

sys.argv = ["sleep", "7"]
run_command(Number, rest, "sleep", "Sleeps.")
"""


@pytest.mark.parametrize(
    ("number", "mode"),
    [(signal.SIGINT, ""), (signal.SIGTERM, ""), (signal.SIGHUP, ""), (signal.SIGTERM, "ignoring")],
)
def test_a_signal_ends_a_command_when_it_has_cleaned_up(number: signal.Signals, mode: str) -> None:
    process = piped(SLEEPER, mode, stdin=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stdout.readline() == "asleep\n"
    if mode:  # an ignored signal stays ignored: of two it would be handled first
        process.send_signal(signal.SIGHUP)
    process.send_signal(number)
    assert process.stdout.readline() == "cleaning\n"
    for later in (signal.SIGTERM, signal.SIGHUP):
        if number is not signal.SIGINT:  # a terminal that is closed may send both
            process.send_signal(later)
    assert process.communicate("\n", timeout=BOUND_S) == ("clean\n", "")
    assert process.returncode == 128 + number


def piped(program: str, *arguments: str, **options: Any) -> subprocess.Popen[str]:
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | options
    words = [sys.executable, "-c", program, *arguments]
    return subprocess.Popen(words, cwd=ROOT, text=True, **options)


def test_a_library_that_raises_its_own_for_a_signal_does_not_hide_it() -> None:
    def wait() -> None:
        try:
            signal.raise_signal(signal.SIGTERM)
        except KeyboardInterrupt:
            raise KeyboardInterrupt from None

    with pytest.raises(Ended) as raised, ending_by_signals():
        wait()
    assert raised.value.number == signal.SIGTERM


PRINTER = """
import sys
from dataclasses import dataclass
from codec.console import run_command, say

@dataclass(frozen=True)
class Lines:
    count: int = 3

def tell(lines):
    for number in range(lines.count):
        say(f"line {number}")

run_command(Lines, tell, "tell", "Tells lines.")
"""


@pytest.mark.parametrize("words", ["--count 3", "--count 100000", "--help"])
def test_who_reads_the_first_line_only_gets_it_and_no_complaint(words: str) -> None:
    teller = piped(PRINTER, *words.split())
    assert teller.stdout is not None
    assert teller.stderr is not None
    if "100000" in words:
        assert teller.stdout.readline() == "line 0\n"
    teller.stdout.close()  # with few lines before the command has printed any
    assert teller.stderr.read() == ""
    teller.stderr.close()
    assert teller.wait(timeout=BOUND_S) == 141


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs Linux: /dev/full")
@pytest.mark.parametrize("count", [3, 100_000])
def test_a_full_disk_under_the_output_is_one_line(count: int) -> None:
    with open("/dev/full", "w") as full:
        done = piped(PRINTER, "--count", str(count), stdout=full)
        said = done.communicate(timeout=BOUND_S)[1]
    assert done.returncode == 1
    assert said == "tell: standard output cannot be written: No space left on device\n"


finite = st.floats(0, 1e7)
words = st.text("abc ", min_size=1, max_size=30)
stages = st.builds(
    Stage,
    what=words,
    share=st.none() | st.floats(0, 1),
    elapsed_s=finite,
    left_s=st.none() | finite,
    figures=st.lists(words, max_size=3).map(tuple),
)


@given(stages, st.integers(1, 200))
def test_the_line_fits_and_leaves_out_whole_parts_only(stage: Stage, columns: int) -> None:
    line = line_of(stage, columns)
    assert 0 < len(line) <= columns
    whole = line_of(stage, 10_000)
    assert whole.startswith(line)
    if len(line) < columns and line != whole:
        assert whole[len(line) :].startswith("  ")


@pytest.mark.parametrize(
    ("steps", "step_s", "total", "lines"),
    [
        (
            *(24, 1, 40),
            [
                "importing x  25% done  0:10 elapsed, 0:30 left  10 of 40",
                "importing x  50% done  0:20 elapsed, 0:20 left  20 of 40",
                "importing x  60% done  0:24 elapsed, 0:16 left  24 of 40",
            ],
        ),
        (1, 3845, None, ["importing x  1:04:05 elapsed  1"]),
        (9, 1, 9, []),
    ],
)
def test_counted_steps(steps: int, step_s: float, total: int | None, lines: list[str]) -> None:
    """A line every ten seconds and at the end; what takes less time writes nothing."""
    now_s, file = 100.0, io.StringIO()
    with counted("importing x", Console(file=file), lambda: now_s) as show:
        for done in range(1, steps + 1):
            now_s += step_s
            show(done, total)
    assert file.getvalue().splitlines() == lines


@pytest.mark.parametrize(("columns", "bar"), [(120, 30), (70, 10), (58, 0)])
def test_a_terminal_has_as_much_of_a_bar_as_there_is_room(columns: int, bar: int) -> None:
    file = io.StringIO()
    console = Console(file=file, width=columns, force_terminal=True, color_system=None)
    with counted("importing x", console, lambda: 0.0) as show:
        show(20, 40)
    shown = re.sub(r"\x1b\[[?0-9]*[a-zA-Z]", "", file.getvalue()).split("\r")[-1].strip("\n")
    before, line, after = shown.partition("importing x  50% done  0:00 elapsed, 0:00 left")
    assert (line != "", after.rstrip()) == (True, "  20 of 40")
    assert len(before) == (bar + 1 if bar else 0)
    assert before.count("━") == bar // 2
