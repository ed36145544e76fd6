"""Settings of the suite; the first ones must precede all compiling and rendering."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator

import pytest
from hypothesis import settings

from tests.support.stores.s3_server import S3Server, s3_server

# Idle threads sleep instead of spinning: tests share few cores with the processes they start.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

# Hosts of the tests are on this machine, so a proxy for other hosts must not be used for them.
for _name in ("no_proxy", "NO_PROXY"):
    os.environ[_name] = ",".join([os.environ.get(_name, ""), "localhost,127.0.0.1,::1"]).strip(",")

# A background job ignores Ctrl-C, and one started by nohup ignores SIGHUP; so would every process
# that a test starts.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
    signal.signal(signal.SIGHUP, signal.SIG_DFL)

# A busy machine is not a failure. The gate tries the same examples each time: what is red there was
# broken by the last change. `scripts/test --deep` looks for new ones.
settings.register_profile("same", deadline=None, derandomize=True)
settings.register_profile("new", deadline=None)


def pytest_configure(config: pytest.Config) -> None:
    is_gate = "not deep" in config.getoption("markexpr")
    settings.load_profile("same" if is_gate else "new")


@pytest.fixture(scope="session")
def anyio_backend() -> str:
    """The event loop that the plugin of anyio runs coroutine tests on."""
    return "asyncio"


@pytest.fixture(scope="module")
def s3() -> Iterator[S3Server]:
    """A real S3 server with an empty bucket."""
    with s3_server() as server:
        yield server


def pytest_make_parametrize_id(config: pytest.Config, val: object, argname: str) -> str | None:
    """Puts the number of bytes into the name of a case instead of the bytes, because gzip data
    contain the time, so that the names would differ between workers."""
    return f"{len(val)}-bytes" if isinstance(val, bytes) else None
