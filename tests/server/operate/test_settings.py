"""Settings from flags, environment and defaults, in this order of precedence."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable
from pathlib import Path

import pytest
import tyro
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import InvalidError
from server.operate.admission import AdmissionConfig
from server.operate.log import LogStyle
from server.operate.overload import OverloadConfig
from server.operate.settings import settings_of, settings_parser, settings_text
from server.operate.workers import SupervisorConfig
from server.servecommand import ServeCommand
from server.state.config import ServerConfig, TimeoutConfig
from tests.support.hostile import refused


def read(*flags: str, **variables: str) -> ServeCommand:
    """The command for these flags and SWINGS_SERVE_* variables."""
    environment = {f"SWINGS_SERVE_{key}": value for key, value in variables.items()}
    parse = settings_parser("SWINGS_SERVE", environment | {"HOME": "/"})
    config = (tyro.conf.EnumChoicesFromValues,)
    command = parse(ServeCommand, args=flags, prog="x", config=config)
    assert isinstance(command, ServeCommand)
    return command


def test_each_source_goes_before_the_next() -> None:
    assert read("r").server.max_plays == ServerConfig().max_plays
    assert read("r", MAX_PLAYS="2").server.max_plays == 2
    assert read("r", "--max-plays", "3", MAX_PLAYS="2").server.max_plays == 3
    # Settings without flags come from the environment, the rest from the defaults.
    server = read("r", "--max-connections", "9", MAX_ADDRESS_PLAYS="2", MAX_PLAYS="2").server
    assert (server.admission.max_connections, server.admission.max_address_plays) == (9, 2)
    assert server.refresh_s == ServerConfig().refresh_s


def test_every_kind_of_setting_can_stand_everywhere() -> None:
    command = read(
        ROOT="streams", HOST="::", LOG="json", PUBLIC="true", KEYS="keys", REFRESH_S="3",
        SHED_FROM="0.5",
    )  # fmt: skip
    server = command.server
    assert (command.root, command.host) == ("streams", "::")
    assert (server.log, server.public, server.keys) == (LogStyle.JSON, True, Path("keys"))
    assert server.refresh_s == 3.0
    assert server.overload == OverloadConfig(shed_from=0.5)
    flags = "streams --host :: --log json --public --keys keys --refresh-s 3 --shed-from 0.5"
    assert read(*flags.split()) == command


@pytest.mark.parametrize(
    ("variable", "value", "message"),
    [
        ("MAX_PLAYZ", "5", "'SWINGS_SERVE_MAX_PLAYZ'; did you mean SWINGS_SERVE_MAX_PLAYS?"),
        ("CONFIG", "x", "unknown setting 'SWINGS_SERVE_CONFIG'; --help-all lists all settings"),
        ("CHECK_CONFIG", "1", "unknown setting 'SWINGS_SERVE_CHECK_CONFIG'"),
        ("QUEUE_S", "1", "unknown setting 'SWINGS_SERVE_QUEUE_S'"),  # a constant
        ("PUBLIC", "maybe", "SWINGS_SERVE_PUBLIC: 'maybe' is neither true nor false"),
    ],
)
def test_a_bad_setting_is_named(variable: str, value: str, message: str) -> None:
    raised = refused(InvalidError, "", read, "r", **{variable: value})
    assert message in str(raised)
    assert "\n" not in str(raised)


@pytest.mark.parametrize(
    ("variable", "value", "told"),
    [
        ("MAX_PLAYS", "many", "--max-plays"),
        ("MAX_PLAYS", "", "--max-plays"),
        ("REFRESH_S", "soon", "--refresh-s"),
        ("LOG", "xml", "--log"),
        ("MAX_PLAYS", "0", "max_plays is 0; it must be positive"),
        ("SHED_FROM", "0.99", "shed_from is 0.99"),
    ],
)
def test_tyro_says_what_a_value_must_be(
    variable: str, value: str, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert refused(SystemExit, "", read, "r", **{variable: value}).code == 2
    assert told in capsys.readouterr().err


def test_values_that_go_together_are_judged_together() -> None:
    """0.97 would be refused together with the default, but not together with 0.99."""
    overload = read("r", SHED_FROM="0.97", REFUSE_FROM="0.99").server.overload
    assert (overload.shed_from, overload.refuse_from) == (0.97, 0.99)


def test_settings_are_called_what_the_help_calls_them(capsys: pytest.CaptureFixture[str]) -> None:
    ended = refused(SystemExit, "", read, "--help-all", NONSENSE="1")
    assert ended.code == 0
    flags = set(re.findall(r"--([a-z][a-z0-9.-]+)", capsys.readouterr().out))
    flags = {flag.removeprefix("no-") for flag in flags}
    names = {name[2:].lower().replace("_", "-") for name in settings_of("X", ServeCommand())}
    assert flags - {"help", "verbose", "version", "check-config"} == names - {"root"}


def variables_of(text: str) -> dict[str, str]:
    """The variables that a shell reads from an environment file, without the prefix."""
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    assert all(line.startswith("SWINGS_SERVE_") for line in lines)
    pairs = [shlex.split(line)[0].removeprefix("SWINGS_SERVE_").split("=", 1) for line in lines]
    return dict(pairs)


def test_the_settings_printed_give_them_again() -> None:
    flags = ["r", "--host", "a\"\\'b $c", "--max-plays", "7", "--shed-from", "0.125"]
    given = {"LOG": "json", "CORS_ORIGIN": "", "PUBLIC": "1"}
    before = read(*flags, **given)
    printed = settings_text("SWINGS_SERVE", before)
    assert "SWINGS_SERVE_SHED_FROM=0.125\n" in printed
    assert "# SWINGS_SERVE_KEYS is not set\n" in printed
    assert "CHECK_CONFIG" not in printed
    assert before.server.cors_origin == ""
    assert read(**variables_of(printed)) == before


def test_printed_settings_need_quotes_only_where_a_value_is_not_plain() -> None:
    """`docker run --env-file` treats quotes as part of the value."""
    told = settings_text("SWINGS_SERVE", ServeCommand("s3://b/a-b", host="::"))
    assert not {"'", '"', "\\"} & set(told)
    assert "\n# SWINGS_SERVE_CORS_ORIGIN=*\n" in told  # a later version may have another default
    assert "SWINGS_SERVE_HOST='a b'\n" in settings_text(
        "SWINGS_SERVE", ServeCommand("r", host="a b")
    )


@given(st.text(st.characters()))
def test_any_text_is_printed_on_one_line_that_is_read_again_or_refused(text: str) -> None:
    command = ServeCommand("r", host=text)
    try:
        told = settings_text("SWINGS_SERVE", command)
    except InvalidError as error:
        assert not text.isprintable()
        assert str(error).startswith("SWINGS_SERVE_HOST: ")  # noqa: PT017
        return
    assert told.count("\n") == len(told.splitlines()) == len(settings_of("X", command))
    assert variables_of(told)["HOST"] == text


@pytest.mark.parametrize(
    ("config", "wrong"),
    [
        (AdmissionConfig, {"max_address_plays": 0}),
        (OverloadConfig, {"shed_from": 0.95}),
        (OverloadConfig, {"shed_from": 0.0}),
        (OverloadConfig, {"recover_margin": -0.1}),
        (OverloadConfig, {"recover_per_s": 0.0}),
        (OverloadConfig, {"smooth_s": float("inf")}),
        (OverloadConfig, {"max_late_s": float("nan")}),
        (OverloadConfig, {"max_egress_bps": -1.0}),
        (SupervisorConfig, {"workers": 0}),
        (SupervisorConfig, {"workers": 257}),
        (SupervisorConfig, {"shutdown_timeout_s": 0.0}),
        (SupervisorConfig, {"worker_timeout_s": 1}),
        (TimeoutConfig, {"keepalive_timeout_s": 0.0}),
        (TimeoutConfig, {"keepalive_timeout_s": float("nan")}),
        (TimeoutConfig, {"write_timeout_s": 86401.0}),
    ],
)
def test_configs_that_make_no_sense_are_refused(
    config: Callable[..., object], wrong: dict[str, float]
) -> None:
    refused(InvalidError, next(iter(wrong)), config, **wrong)
