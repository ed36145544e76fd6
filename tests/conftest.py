"""Settings of the suite; the first ones must precede all compiling and rendering."""

from __future__ import annotations

import gc
import os
import signal
import sys
import warnings

import pytest
from _pytest.runner import runtestprotocol
from hypothesis import settings

from tests.support.suite.starved import Watch

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

# A busy machine is not a failure. CI uses the same examples each time; the desk finds new ones.
settings.register_profile("desk", deadline=None)
settings.register_profile("ci", deadline=None, derandomize=True)
settings.load_profile("ci" if os.environ.get("CI") else "desk")


@pytest.fixture(scope="session")
def anyio_backend() -> str:
    """The event loop that the plugin of anyio runs coroutine tests on."""
    return "asyncio"


REALTIME = "realtime"
"""The marker of tests that measure time, and the name of the group that they run in."""

REALTIME_TRIES = 4
"""Maximum runs of a test that measures time while the machine is too busy for it."""


def pytest_itemcollected(item: pytest.Item) -> None:
    """Distributes the tests among processes. Tests of a file share one, which makes its fixtures
    once; tests of the browser share one, which has the only Chromium; and tests that measure time
    share one, so that they do not disturb each other."""
    item.add_marker(pytest.mark.xdist_group(_group(item)))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Runs the longest tests first."""
    slow_files = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: (_group(item) not in GROUPS_FIRST, item.path not in slow_files))


def pytest_collection_finish(session: pytest.Session) -> None:
    """Asserts that pytest-xdist added the groups to the names; not every pytest version lets it."""
    if getattr(session.config.option, "loadgroup", False):
        assert all("@" in item.nodeid for item in session.items), "the tests are in no groups"


def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """Repeats a test that measures time, or waits for a browser's pictures, only if it failed while
    the machine had no CPU time to spare."""
    if item.get_closest_marker(REALTIME) is None and _group(item) != "web":
        return None
    hooks = item.ihook
    hooks.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    for left in reversed(range(REALTIME_TRIES)):
        with Watch() as watch:
            reports = runtestprotocol(item, log=False, nextitem=nextitem)
        failed = any(report.failed for report in reports)
        if not (failed and left and (watch.starved or watch.busy)):
            break
        _release(reports)
    for report in reports:
        hooks.pytest_runtest_logreport(report=report)
    hooks.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def _release(reports: list[pytest.TestReport]) -> None:
    """Frees the sockets and files in the traceback of a failed run. Otherwise the collector would
    find them unclosed in the middle of another test, which would fail."""
    reports.clear()
    for name in ("last_type", "last_value", "last_traceback"):
        if hasattr(sys, name):
            delattr(sys, name)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)
        gc.collect()


GROUPS_FIRST = (REALTIME, "web")


def _group(item: pytest.Item) -> str:
    if "page" in getattr(item, "fixturenames", ()):
        return "web"
    if item.get_closest_marker(REALTIME):
        return REALTIME
    return item.nodeid.partition("::")[0]


def pytest_make_parametrize_id(config: pytest.Config, val: object, argname: str) -> str | None:
    """Puts the number of bytes into the name of a case instead of the bytes, because gzip data
    contain the time, so that the names would differ between workers."""
    return f"{len(val)}-bytes" if isinstance(val, bytes) else None
