"""A Ray cluster, as a client of it sees it."""

from __future__ import annotations

import io
import logging
import math
import os
import re
import secrets
import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from typing import Any

from rich.console import Console

from codec.errors import InvalidError
from trainer.run.config import LOCAL, TrainConfig

log = logging.getLogger(__name__)

CONNECT_S = 10.0
"""Timeout for the head of a cluster to answer, in seconds."""


@contextmanager
def open_cluster(address: str, least_cpus: float, console: Console) -> Iterator[Any]:
    """The cluster at `address`; one of this machine alone has `least_cpus` in any case. console:
    gets a line where a worker dies."""
    if address == LOCAL:
        # Ray listens on all interfaces, and runs what anyone sends. Versions before 2.52 ignore it.
        os.environ.setdefault("RAY_AUTH_MODE", "token")
        os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))
    try:
        import ray
    except ImportError as error:
        raise InvalidError(
            "--ray needs the package ray: pip install '.[ray]' in the folder of swings"
        ) from error
    # Without an address Ray would join a cluster that RAY_ADDRESS or a killed driver's files name.
    options: dict[str, Any] = {"address": address}
    if address == LOCAL:
        options["num_cpus"] = max(os.cpu_count() or 1, math.ceil(least_cpus))
    _check_listens(address)
    try:
        with keeping_signals():
            ray.init(log_to_driver=False, logging_level=logging.ERROR, **options)
    except Exception as error:  # where a node does not start in time, Ray raises no narrower one
        raise InvalidError(f"--ray {address}: {' '.join(str(error).split())}") from error
    with redirect_stdout(RayOutput(console)):
        try:
            yield ray
        finally:
            ray.shutdown()


LOSSES = {
    "memory pressure": "a node ran out of memory and ended a worker",
    "A worker died": "{worker} was killed or crashed (out of memory, a signal, or native code)",
    "User exception": "a task failed{error}",
    "marked dead": "a node of the cluster is gone",
}
"""Messages of Ray, and their meaning for a user."""

_DEAD_WORKER = re.compile(r"Worker IP address: (\S+) .*Worker PID: (\d+)")
_ERROR = re.compile(r"^(\w+: .+)$", re.MULTILINE)


class RayOutput(io.TextIOBase):
    """Stands in for standard output, where Ray prints paragraphs about each worker that dies and
    each task that fails: prints one line for each, and logs the rest at level debug."""

    def __init__(self, console: Console) -> None:
        self._console = console

    def write(self, text: str) -> int:
        if text.strip():
            log.debug("ray: %s", text.strip())
        for words, meaning in LOSSES.items():
            if words in text:
                worker, error = "a worker", ""
                if found := _DEAD_WORKER.search(text):
                    worker = f"worker process {found[2]} on node {found[1]}"
                if found := _ERROR.search(text.partition("System error:")[0]):
                    error = f" ({found[1]})"
                line = meaning.format(worker=worker, error=error)
                line += "; its task is run again (--verbose shows Ray's message)"
                self._console.print(line, highlight=False, markup=False, soft_wrap=True)
                break
        return len(text)


@contextmanager
def keeping_signals() -> Iterator[None]:
    """Ray would end the process by itself when it is asked to end, without a word."""
    handler = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        if handler is not None and threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, handler)


def look_for_room(ray: Any, config: TrainConfig, console: Console) -> None:
    """Says so where no node has what a worker claims: one may come, but until then all waits."""
    if not num_workers(ray, config):
        console.print(
            f"no node of the cluster has {config.worker_cpus:g} cores and {config.worker_gpus:g} "
            "GPUs for a worker (--worker-cpus, --worker-gpus): waiting for one",
            highlight=False, soft_wrap=True,
        )  # fmt: skip


def num_workers(ray: Any, config: TrainConfig) -> int:
    """Number of workers that fit on the nodes that are up now, if nothing else runs there."""
    claims = {"CPU": config.worker_cpus, "GPU": config.worker_gpus}
    return sum(
        min(int(node["Resources"].get(kind, 0) / much) for kind, much in claims.items() if much)
        for node in ray.nodes()
        if node["Alive"]
    )


def _check_listens(address: str) -> None:
    """Raises InvalidError if no process listens at HOST:PORT; Ray would try for minutes."""
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if not colon or not port.isdigit():
        return  # auto and local, and whatever else Ray knows
    try:
        socket.create_connection((host.strip("[]"), int(port)), CONNECT_S).close()
    except (OSError, OverflowError) as error:
        raise InvalidError(f"--ray {address}: no cluster answers: {error}") from error
