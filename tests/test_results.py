"""The command lines of docs/RESULTS.md are accepted by the current commands.

Each is passed to its parser, which refuses unknown options and values; nothing runs.
"""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys

import pytest

from tests.support.commands import ENTRY, ROOT, environment

PAGE = (ROOT / "docs" / "RESULTS.md").read_text(encoding="utf-8")
IS_COMMAND = re.compile(r"(swings-\w+|scripts/bench) +\S")
STANDS_FOR = {
    "--seed S": "--seed 0",
    "-share X": "-share 0.1",
    " ...": "",
    "URL --link demo/link.json": "http://127.0.0.1 --link 8M",
}
"""Placeholders of the page, and their replacements."""
NAMES_ALONE = {
    "swings-stream info",
    "swings-stream verify",
    "swings-stream export --static",
    "swings-train --frames A:B --scale 0.5",
}
"""Commands that the page mentions without their arguments."""

PARSE_EACH = """
import contextlib, io, json, runpy, sys
from importlib import import_module
from pathlib import Path

import codec.console

real = codec.console.run_command
codec.console.run_command = lambda kind, run, *rest, **named: real(
    kind, lambda config: None, *rest, **named
)
entry, lines = json.load(sys.stdin)
found = []
for name, *words in lines:
    said = io.StringIO()
    status = 0
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
        try:
            if name in entry:
                module, function = entry[name].split(":")
                sys.argv = [name, *words]
                getattr(import_module(module), function)()
            else:
                bench, *words = words
                (file,) = Path("bench").rglob(bench + ".py")
                sys.argv = [str(file), *words]
                runpy.run_path(str(file), run_name="__main__")
        except SystemExit as end:
            status = end.code or 0
    found.append((status, said.getvalue()))
print(json.dumps(found))
"""


def command_lines() -> list[str]:
    lines = re.findall(r"^ {4}(\S.*)$", PAGE, re.MULTILINE)
    spans = [" ".join(span.split()) for span in re.findall(r"`([^`]+)`", PAGE)]
    found = {line for line in [*lines, *spans] if IS_COMMAND.match(line)}
    return sorted(found - NAMES_ALONE)


def test_every_line_is_accepted() -> None:
    lines = command_lines()
    assert len(lines) > 40
    words = []
    for line in lines:
        for old, new in STANDS_FOR.items():
            line = line.replace(old, new)
        words.append(shlex.split(line))
    done = subprocess.run(
        [sys.executable, "-c", PARSE_EACH],
        input=json.dumps([ENTRY, words]),
        cwd=ROOT,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    refused = {line: said for line, (status, said) in zip(lines, found, strict=True) if status}
    assert not refused


@pytest.mark.parametrize("line", [x for x in command_lines() if "swings-train panoptic" in x])
def test_training_names_the_rate_that_the_capture_lacks(line: str) -> None:
    assert "--fps 30" in line
