"""Progress of a long command: a bar and one line in a terminal, or plain lines."""

from __future__ import annotations

import io
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from codec.progressline import ProgressLine, Stage, clock, counted, line_of

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
    ("time_s", "text"), [(0, "0:00"), (59.6, "1:00"), (245, "4:05"), (3845, "1:04:05")]
)
def test_times_are_read_at_a_glance(time_s: float, text: str) -> None:
    assert clock(time_s) == text


def test_without_a_terminal_a_line_comes_at_intervals_and_at_the_end() -> None:
    now_s, file = 0.0, io.StringIO()
    with ProgressLine(Console(file=file, width=20), lambda: now_s, every_s=30) as line:
        for second in range(75):
            now_s = second
            line.show(Stage("5 frames", second / 100, second, 100 - second))
            lines = file.getvalue().splitlines()
            assert len(lines) == 1 + second // 30
        assert lines[1] == "5 frames  30% done  0:30 elapsed, 1:10 left"
    assert file.getvalue().splitlines()[3:] == ["5 frames  74% done  1:14 elapsed, 0:26 left"]


def test_counted_steps_write_a_line_every_ten_seconds() -> None:
    now_s, file = 100.0, io.StringIO()
    with counted("importing x", Console(file=file), lambda: now_s) as show:
        for done in range(1, 25):
            now_s += 1
            show(done, 40)
    assert file.getvalue().splitlines() == [
        "importing x  25% done  0:10 elapsed, 0:30 left  10 of 40",
        "importing x  50% done  0:20 elapsed, 0:20 left  20 of 40",
        "importing x  60% done  0:24 elapsed, 0:16 left  24 of 40",
    ]


def test_what_takes_less_than_ten_seconds_writes_nothing() -> None:
    now_s, file = 100.0, io.StringIO()
    with counted("importing x", Console(file=file), lambda: now_s) as show:
        now_s += 9
        show(40, 40)
    assert file.getvalue() == ""


def test_steps_without_an_end_are_counted() -> None:
    now_s, file = 0.0, io.StringIO()
    with counted("drawing", Console(file=file), lambda: now_s) as show:
        now_s = 12
        show(341, None)
    assert file.getvalue() == "drawing  0:12 elapsed  341\n"


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
