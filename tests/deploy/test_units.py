"""The systemd unit and the settings of the container, without the programs that read them."""

from __future__ import annotations

import configparser
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml  # type: ignore[import-untyped]

from server.state.config import ServerConfig
from tests.deploy.dockerfile import DOCKERFILE, ROOT, instructions
from tests.deploy.proxied import DEPLOY
from tests.support.commands import serving
from tests.support.server.certificates import make_certificate

UNIT = DEPLOY / "swings-serve.service"


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
    # The arbiter replaces a worker that hangs before systemd would restart all of them.
    assert float(service["WatchdogSec"]) > ServerConfig().supervisor.worker_timeout_s + 5
    for name, value in {
        "DynamicUser": "yes",
        "ProtectSystem": "strict",
        "NoNewPrivileges": "yes",
        "Type": "notify",
        "Restart": "on-failure",
        "CapabilityBoundingSet": "",
        # Otherwise an optional system call of a library kills the server.
        "SystemCallErrorNumber": "EPERM",
    }.items():
        assert service[name] == value, name


def checked_settings(words: list[str], environment: dict[str, str]) -> dict[str, str]:
    """The variables of a server with these arguments, which it must accept."""
    done = subprocess.run(
        [sys.executable, "-m", "server", *words, "--check-config"],
        cwd=ROOT,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return dict(re.findall("SWINGS_SERVE_(.*?)=(.*)", done.stdout))  # comments are the defaults


def test_the_server_takes_the_settings_of_the_unit_and_can_reload() -> None:
    lines = UNIT.read_text().splitlines()
    values = [line.split("=", 1) for line in lines if re.match(r"\w+=", line)]
    command = next(value for name, value in values if name == "ExecStart").split()
    environment = dict(value.split("=", 1) for name, value in values if name == "Environment")
    settings = checked_settings(command[1:], environment)
    assert settings["HOST"] == "127.0.0.1"
    checked, renewed = (value for name, value in values if name == "ExecReload")
    assert checked == f"{' '.join(command[:2])} --check-config"  # broken keys stop the reload
    assert renewed == "/bin/kill -HUP $MAINPID"
    assert settings["WORKERS"] == "2"


def test_the_server_takes_the_settings_of_the_container() -> None:
    settings = checked_settings(json.loads(dict(instructions())["CMD"]), {})
    assert (settings["HOST"], settings["PUBLIC"]) == ("0.0.0.0", "true")


def test_the_composed_server_is_reached_by_its_proxy_alone() -> None:
    services = yaml.safe_load((DEPLOY / "compose.yaml").read_text())["services"]
    server = services["server"]
    settings = checked_settings(server["command"], server["environment"])
    assert (settings["HOST"], settings["PUBLIC"]) == ("127.0.0.1", "false")
    assert (server["network_mode"], "ports" in server) == ("service:proxy", False)
    assert f"reverse_proxy 127.0.0.1:{settings['PORT']} {{" in (DEPLOY / "Caddyfile").read_text()
    assert set(re.findall(r" -p (\S+)", DOCKERFILE.read_text())) == {"127.0.0.1:8080:8080"}


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
