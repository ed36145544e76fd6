"""The syntax of links on the command line."""

from __future__ import annotations

import contextlib
import json
import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import InvalidError
from player.link.relay import read_link
from server.abr.link import LinkStep
from server.abr.traces import MAX_TRACE_BYTES


def test_rates() -> None:
    assert read_link("8M").at(5).rate_bps == 8e6
    assert read_link("1.5G").at(0).rate_bps == 1.5e9
    assert read_link("64k,20ms").at(1e6) == LinkStep(3600.0, 64e3, 0.02)


def test_trace_files_have_any_name(tmp_path: Path) -> None:
    entry = {"duration_ms": 500, "bandwidth_kbps": 2000, "latency_ms": 30.5}
    trace = tmp_path / "trace.json"
    trace.write_text(json.dumps([entry, {**entry, "bandwidth_kbps": 0}]))
    link = read_link(str(trace))
    assert link.steps == (LinkStep(0.5, 2e6, 0.0305), LinkStep(0.5, 0.0, 0.0305))
    assert read_link(str(trace.rename(tmp_path / "trace"))).steps == link.steps
    trace.write_text("50\n100\n")
    assert read_link(str(trace)).steps == (LinkStep(0.1, 2 * 1504 * 80, 0.0),)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("fast", "'fast' is neither a rate such as 8M or 8M,20ms nor a trace: No such file"),
        ("8M,20", "neither a rate"),
        ("", "neither a rate"),
        ("-8M", "neither a rate"),
        ("nowhere.json", "No such file"),
        (".", "nor a trace: Is a directory"),
        ("a\0b", "nor a trace: embedded null"),
        ("0", "every rate is 0"),
        ("9" * 400, "step 0 is"),
    ],
)
def test_bad_links(text: str, message: str) -> None:
    with pytest.raises(InvalidError, match=message) as error:
        read_link(text)
    assert "\n" not in str(error.value)


def test_a_bad_trace_is_named(tmp_path: Path) -> None:
    trace = tmp_path / "trace.txt"
    trace.write_text("5\n3\n")
    with pytest.raises(InvalidError, match=r"trace .*/trace\.txt: line 2 is 3 ms"):
        read_link(str(trace))
    os.truncate(trace, MAX_TRACE_BYTES + 5)  # a hole, which takes no space
    with pytest.raises(InvalidError, match="more than 64 MiB"):
        read_link(str(trace))


@given(st.text())
def test_any_text_gives_a_link_or_an_error(text: str) -> None:
    with contextlib.suppress(InvalidError):
        read_link(text)
