"""The systemd unit and the Dockerfile: what can be checked without the programs that read them."""

from __future__ import annotations

import configparser
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from server.state.config import ServerConfig
from tests.deploy.proxied import DEPLOY
from tests.support.commands import serving
from tests.support.server.certificates import make_certificate

ROOT = DEPLOY.parent
UNIT = DEPLOY / "swings-serve.service"
DOCKERFILE = DEPLOY / "Dockerfile"


def instructions() -> list[tuple[str, str]]:
    """The Dockerfile's, with continued lines joined."""
    text = DOCKERFILE.read_text().replace("\\\n", " ")
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    return [(name, rest.strip()) for name, _, rest in (line.partition(" ") for line in lines)]


def copied() -> list[str]:
    """What the build stage takes from the repository."""
    found = []
    for name, rest in instructions():
        if name == "COPY" and not rest.startswith("--from"):
            found += rest.split()[:-1]
    return found


def test_systemd_takes_the_unit(tmp_path: Path) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd-analyze is not installed")
    unit = tmp_path / UNIT.name
    # The program is not installed where the unit expects it.
    unit.write_text(UNIT.read_text().replace("/opt/swings/bin/swings-serve", "/bin/true"))
    done = subprocess.run(["systemd-analyze", "verify", unit], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_the_server_may_stop_by_itself_before_systemd_kills_it() -> None:
    parser = configparser.ConfigParser(strict=False, interpolation=None)
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    parser.read(UNIT)
    service = parser["Service"]
    given = re.search(r"--shutdown-timeout-s (\d+)", service["ExecStart"])
    stop_s = float(given[1]) if given else ServerConfig().supervisor.shutdown_timeout_s
    assert float(service["TimeoutStopSec"]) >= stop_s + 5
    assert service["KillSignal"] == "SIGTERM"
    for name, value in {
        "DynamicUser": "yes",
        "ProtectSystem": "strict",
        "NoNewPrivileges": "yes",
        "Restart": "on-failure",
        "CapabilityBoundingSet": "",
        # Else a call that a library can do without kills the server.
        "SystemCallErrorNumber": "EPERM",
    }.items():
        assert service[name] == value, name


def checked_settings(words: list[str], environment: dict[str, str]) -> dict[str, object]:
    """The settings of a server with these arguments; it must take them."""
    done = subprocess.run(
        [sys.executable, "-m", "server", *words, "--check-config"],
        cwd=ROOT,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return tomllib.loads(done.stdout)


def test_the_server_takes_the_settings_of_the_unit_and_can_reload() -> None:
    lines = UNIT.read_text().splitlines()
    values = [line.split("=", 1) for line in lines if re.match(r"\w+=", line)]
    command = next(value for name, value in values if name == "ExecStart").split()
    environment = dict(value.split("=", 1) for name, value in values if name == "Environment")
    settings = checked_settings(command[1:], environment)
    assert settings["host"] == "127.0.0.1"
    assert ["ExecReload", "/bin/kill -HUP $MAINPID"] in values
    assert settings["workers"] == 2


def test_the_server_takes_the_settings_of_the_container() -> None:
    settings = checked_settings(json.loads(dict(instructions())["CMD"]), {})
    assert (settings["host"], settings["public"]) == ("0.0.0.0", True)


def test_the_dockerfile_copies_what_is_there_and_runs_as_nobody_special() -> None:
    steps = instructions()
    assert [rest for name, rest in steps if name == "FROM"] == [
        "python:3.11-slim AS build",
        "python:3.11-slim",
    ]
    for source in copied():
        assert (ROOT / source).exists(), source
    last = len(steps) - 1 - [name for name, _ in reversed(steps)].index("FROM")
    names = dict(steps[last:])
    assert names["USER"] == "10001"
    for name in ("ENTRYPOINT", "CMD"):
        assert isinstance(json.loads(names[name]), list)


@pytest.mark.parametrize("scheme", ["http", "https"])
def test_the_health_check_asks_where_it_is_told_to(tmp_path: Path, scheme: str) -> None:
    names = dict(instructions())
    assert names["ENV"] == "HEALTH_URL=http://127.0.0.1:8080/healthz"
    words = json.loads(names["HEALTHCHECK"].partition("CMD ")[2])
    assert words[0].endswith("/python")
    options: tuple[object, ...] = ()
    if scheme == "https":
        cert, key = make_certificate(tmp_path / "tls")
        options = ("--tls-cert", cert, "--tls-key", key)

    def status(url: str) -> int:
        environment = {**os.environ, "HEALTH_URL": url}
        command = [sys.executable, *words[1:]]
        return subprocess.run(command, env=environment, capture_output=True).returncode

    with serving(tmp_path, *options) as url:
        assert url.startswith(f"{scheme}://")
        assert status(f"{url}/healthz") == 0
        assert status(f"{url}/nothing") != 0
    assert status(f"{url}/healthz") != 0


def test_what_docker_ignores_is_all_but_what_is_copied() -> None:
    lines = (DEPLOY / "Dockerfile.dockerignore").read_text().split()
    assert lines[0] == "*"
    assert {line[1:] for line in lines if line.startswith("!")} == set(copied())


def test_the_copied_files_are_enough_to_install_the_server(tmp_path: Path) -> None:
    """Into a fresh environment, without what it depends on."""
    for source in copied():
        path = ROOT / source
        if path.is_dir():
            ignored = shutil.ignore_patterns("__pycache__")
            shutil.copytree(path, tmp_path / "source" / source, ignore=ignored)
        else:
            (tmp_path / "source").mkdir(exist_ok=True)
            shutil.copy(path, tmp_path / "source" / source)
    subprocess.run([sys.executable, "-m", "venv", tmp_path / "venv"], check=True)
    lines = [rest for name, rest in instructions() if name == "RUN" and "pip install" in rest]
    assert len(lines) == 1
    words = [str(tmp_path / "venv/bin/pip"), *lines[0].split()[1:], "--no-deps"]
    done = subprocess.run(words, cwd=tmp_path / "source", capture_output=True, text=True)
    if "Could not find a version that satisfies the requirement hatchling" in done.stderr:
        pytest.skip("no package index can be reached")
    assert done.returncode == 0, done.stderr[-2000:]
    assert (tmp_path / "venv/bin/swings-serve").exists()
    packages = next((tmp_path / "venv/lib").glob("python*/site-packages"))
    for needed in ("codec/FORMAT.md", "server/app.py", "player/web/watch.html"):
        assert (packages / needed).exists(), needed
