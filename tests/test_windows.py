"""All modules, all `--help` and a server of one process need nothing that Windows lacks.

No test runs on Windows itself. These tests remove from a process the parts that Python lacks there,
after loading the libraries; they imitate nothing else of Windows.
"""

from __future__ import annotations

import re
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

from codec.errors import InvalidError
from server.operate.workers import SupervisorConfig
from tests.importlaw import PACKAGES
from tests.support.commands import ENTRY, ROOT, environment
from tests.support.tiny_stream import tiny_manifest, write_tiny
from tests.support.waiting import BOUND_S

NEEDS_GUNICORN = ("factory", "gunicornconf")
"""Modules that only `--workers` above 1 imports, because Windows cannot install gunicorn."""

MODULES = [
    ".".join(file.relative_to(ROOT).with_suffix("").parts)
    for package in PACKAGES
    for file in sorted((ROOT / package).rglob("*.py"))
    if "node_modules" not in file.parts
    if file.stem not in ("__init__", *NEEDS_GUNICORN)
]

AS_ON_WINDOWS = f"""
import asyncio, importlib, os, select, signal, socket, sys

def import_all():
    for name in {MODULES!r}:
        importlib.import_module(name)

import_all()  # with the libraries, which choose by the platform
for name in [m for m in sys.modules if m.split(".")[0] in {PACKAGES!r}]:
    del sys.modules[name]
for name in ("fcntl", "grp", "gunicorn", "pwd", "resource", "termios"):
    sys.modules[name] = None
for module, names in (
    (os, "O_CLOEXEC O_DIRECTORY O_NOFOLLOW O_NONBLOCK fork getppid geteuid getuid WNOHANG killpg"),
    (os, "pread pwrite sched_getaffinity sendfile sysconf"),
    (select, "poll"),
    (signal, "SIGCHLD SIGHUP SIGKILL SIGUSR1 SIGUSR2 SIG_BLOCK SIG_SETMASK pthread_sigmask"),
    (socket, "SO_REUSEPORT TCP_INFO TCP_NOTSENT_LOWAT TCP_USER_TIMEOUT"),
):
    for name in names.split():
        delattr(module, name)
asyncio.SelectorEventLoop.add_signal_handler = asyncio.AbstractEventLoop.add_signal_handler
sys.platform = "win32"
import_all()
"""


def test_every_module_is_imported_every_command_explains_itself_and_one_process_serves(
    tmp_path: Path,
) -> None:
    write_tiny(tmp_path / "stream", 4, tiny_manifest())
    code = f"""{AS_ON_WINDOWS}
for command, entry in {ENTRY!r}.items():
    module, function = entry.split(":")
    sys.argv = [command, "--help"]
    try:
        getattr(sys.modules[module], function)()
    except SystemExit as end:
        assert not end.code, command
    print("explained", command)
sys.argv = ["swings-serve", {str(tmp_path)!r}, "--port", "0"]
sys.modules["server.__main__"].main()
"""
    with subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        said = ""
        while not (url := re.search(r"^serving (\S+)", said, re.MULTILINE)):
            line = process.stdout.readline()
            assert line, process.stderr.read()[-2000:]
            said += line
        try:
            assert len(re.findall(r"^explained ", said, re.MULTILINE)) == len(ENTRY)
            for path in ("/readyz", "/v1/streams/stream/manifest.json", "/watch/stream"):
                with urllib.request.urlopen(url[1] + path, timeout=BOUND_S) as found:
                    assert found.read()
        finally:
            process.terminate()
            process.wait(timeout=BOUND_S)


def test_several_workers_are_refused_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "win32")
    assert SupervisorConfig(1).workers == 1
    with pytest.raises(InvalidError, match="Windows allows only 1; give 1"):
        SupervisorConfig(2)
