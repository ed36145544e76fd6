"""The same immutable objects from swings-serve, nginx and aiohttp's FileResponse.

Each row is an object and a kind of request; in every round each server answers it for some seconds,
one after the other, so that a machine that gets slower does so for all. A figure is the median of
its rounds. wrk asks over 32 connections that are kept, from a core that the server is not on.

CPU seconds are user and system time of the server's processes over what wrk read, heads included.
`to nginx` is bytes per CPU second as a share of nginx's; for 304, requests per CPU second. Of
ranges compare that, and not the rate: with tcp_nopush, which Debian sets, nginx keeps the end of a
range that does not begin with a page for 40 ms.
"""

from __future__ import annotations

import http.client
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from rich.console import Console
from rich.table import Table

from codec.errors import SwingsError

from .material import write_objects
from .processes import cpu_s, pinned, running, serving

TRIES = 4
"""Most times that wrk asks in one round."""
LAST = "aiohttp"
"""The last of the servers in a table: aiohttp's FileResponse."""
SCRIPT = """
done = function(summary)
  local e = summary.errors
  local bad = e.connect + e.read + e.write + e.status + e.timeout
  io.write(string.format("SUM %d %d %d %d\\n", summary.requests, summary.bytes,
    summary.duration, bad))
end
"""
NGINX = """
{user}daemon off;
worker_processes 1;
pid {folder}/nginx.pid;
error_log {folder}/error.log;
events {{ worker_connections 768; }}
http {{
  sendfile on;
  tcp_nopush on;
  types_hash_max_size 2048;
  default_type application/octet-stream;
  access_log {folder}/access.log;
  gzip on;
  client_body_temp_path {folder}/body;
  proxy_temp_path {folder}/proxy;
  fastcgi_temp_path {folder}/fastcgi;
  uwsgi_temp_path {folder}/uwsgi;
  scgi_temp_path {folder}/scgi;
  server {{
    listen 127.0.0.1:{port};
    location /v1/streams/ {{ alias {root}/; }}
  }}
}}
"""
"""Debian's nginx.conf in all that matters here, but for one worker."""


@dataclass(frozen=True, slots=True)
class Case:
    """A row: what is asked."""

    what: str
    path: str
    header: str = ""
    """`Name: value`; the value ETAG stands for the tag that the server gave."""
    status: int = 200


@dataclass(frozen=True, slots=True)
class Rate:
    """What a server did with a case: the medians of all rounds."""

    case: str
    server: str
    requests_per_s: float
    bytes_per_s: float
    cpu_s_per_gb: float
    cpu_us_per_request: float
    to_nginx: float
    """Bytes per CPU second as a share of nginx's; NaN without one."""


@dataclass(frozen=True, slots=True)
class _Round:
    requests: int
    num_bytes: int
    seconds: float
    cpu_s: float


def cases_of(sizes_kb: tuple[int, ...]) -> list[Case]:
    """A row for each size, and of one object a range and an answer that it has not changed."""
    path = "/v1/streams/kb{}/segments/1/2"
    rows = [Case(f"{size} KB", path.format(size)) for size in sizes_kb]
    middle = sizes_kb[len(sizes_kb) // 2]
    first = 1000
    last = min(100_000, middle * 500) + first - 1
    of = path.format(middle)
    wanted = f"Range: bytes={first}-{last}"
    rows.append(Case(f"{(last - first + 1) // 1000} of {middle} KB", of, wanted, 206))
    return [*rows, Case(f"304 of {middle} KB", of, "If-None-Match: ETAG", 304)]


def need(program: str, package: str) -> str:
    """Where `program` is. Raises SwingsError that says what to install."""
    for folder in (*os.environ.get("PATH", "").split(os.pathsep), "/usr/sbin"):
        if found := shutil.which(program, path=folder):
            return found
    raise SwingsError(f"there is no {program}; on Debian: apt-get install {package}")


@contextmanager
def nginx(root: Path, folder: Path, core: int) -> Iterator[tuple[int, int]]:
    """An nginx of the objects below `root`: its process id and port."""
    port = free_port()
    config = folder / "nginx.conf"
    user = "user root;\n" if os.getuid() == 0 else ""  # its worker must read a temporary folder
    config.write_text(NGINX.format(user=user, folder=folder, port=port, root=root))
    command = [*pinned(core), need("nginx", "nginx"), "-c", config, "-e", folder / "error.log"]
    with running(command) as process:
        for _ in range(500):
            try:
                socket.create_connection(("127.0.0.1", port)).close()
                break
            except OSError:
                time.sleep(0.01)
        else:
            raise SwingsError("nginx did not start")
        yield process.pid, port


@contextmanager
def file_response(root: Path, core: int) -> Iterator[tuple[int, int]]:
    """aiohttp's FileResponse: its process id and port."""
    command = [*pinned(core), sys.executable, Path(__file__).with_name("fileresponse.py"), root]
    with running(command, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        yield process.pid, int(process.stdout.readline())


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as sock:
        return int(sock.getsockname()[1])


def header_of(case: Case, port: int) -> str:
    """The header for this server. Raises SwingsError unless it answers as the case expects."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    header = case.header
    try:
        if "ETAG" in header:
            connection.request("GET", case.path)
            response = connection.getresponse()
            response.read()
            header = header.replace("ETAG", response.headers["ETag"] or "")
        name, _, value = header.partition(": ")
        connection.request("GET", case.path, headers={name: value} if name else {})
        response = connection.getresponse()
        response.read()
    finally:
        connection.close()
    if response.status != case.status:
        raise SwingsError(f"{case.what}: answered {response.status}, not {case.status}")
    return header


def ask(
    pid: int, port: int, case: Case, header: str, seconds: float, core: int, script: Path
) -> _Round:
    """wrk asks for `seconds`, and again for twice as long while a busy machine lets nothing be
    answered. Raises SwingsError if anything went wrong in it."""
    for longer in range(TRIES):
        one = _asked(pid, port, case, header, seconds * 2**longer, core, script)
        if one.requests:
            return one
    raise SwingsError(f"{case.what}: no request was answered in {seconds * 2 ** (TRIES - 1):.0f} s")


def _asked(
    pid: int, port: int, case: Case, header: str, seconds: float, core: int, script: Path
) -> _Round:
    command = [*pinned(core), need("wrk", "wrk"), "-t1", "-c32", f"-d{max(1, round(seconds))}s"]
    command += ["-s", str(script), *(["-H", header] if header else [])]
    before_s = cpu_s(pid)
    done = subprocess.run(
        [*command, f"http://127.0.0.1:{port}{case.path}"], capture_output=True, text=True
    )
    used_s = cpu_s(pid) - before_s
    found = [line.split()[1:] for line in done.stdout.splitlines() if line.startswith("SUM ")]
    if done.returncode or not found:
        raise SwingsError(f"wrk failed: {(done.stderr or done.stdout).strip()[-300:]}")
    requests, num_bytes, took_us, bad = map(int, found[0])
    if bad:
        raise SwingsError(f"{case.what}: {bad} of {requests} requests failed")
    return _Round(requests, num_bytes, took_us / 1e6, used_s)


def measure_objects(
    sizes_kb: tuple[int, ...],
    rounds: int,
    seconds: float,
    cores: tuple[int, int],
    options: tuple[str, ...],
    around: Callable[[int], ExitStack],
) -> list[Rate]:
    """All rows. around: given the process id of swings-serve, what is to be open meanwhile."""
    need("nginx", "nginx"), need("wrk", "wrk")
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        root = folder / "streams"
        for size_kb in sizes_kb:
            write_objects(root / f"kb{size_kb}", size_kb * 1000)
        script = folder / "sum.lua"
        script.write_text(SCRIPT)
        own = serving(root, *options, prefix=pinned(cores[0]), log=folder / "serve.log")
        servers = {
            "swings": stack.enter_context(own),
            "nginx": stack.enter_context(nginx(root, folder, cores[0])),
            "aiohttp": stack.enter_context(file_response(root, cores[0])),
        }
        stack.enter_context(around(servers["swings"][0]))
        rates: list[Rate] = []
        for case in cases_of(sizes_kb):
            headers = {server: header_of(case, port) for server, (_, port) in servers.items()}
            taken: dict[str, list[_Round]] = {server: [] for server in servers}
            for _ in range(rounds):
                for server, (pid, port) in servers.items():
                    one = ask(pid, port, case, headers[server], seconds, cores[1], script)
                    taken[server].append(one)
            rates += rates_of(case, taken)
        return rates


def rates_of(case: Case, taken: dict[str, list[_Round]]) -> list[Rate]:
    """The medians of each server's rounds."""
    # No CPU time at all is less than one tick of the clock.
    costs = {
        server: median(
            max(one.cpu_s, 0.01) / (one.requests if case.status == 304 else one.num_bytes)
            for one in rounds
        )
        for server, rounds in taken.items()
    }
    return [
        Rate(
            case.what,
            server,
            median(one.requests / one.seconds for one in rounds),
            median(one.num_bytes / one.seconds for one in rounds),
            median(max(one.cpu_s, 0.01) / (one.num_bytes / 1e9) for one in rounds),
            median(max(one.cpu_s, 0.01) / one.requests * 1e6 for one in rounds),
            costs["nginx"] / costs[server] if "nginx" in costs else float("nan"),
        )
        for server, rounds in taken.items()
    ]


def show_objects(rates: list[Rate]) -> None:
    table = Table("object", "server", "requests/s", "MB/s", "CPU s/GB", "us each", "to nginx")
    for rate in rates:
        table.add_row(
            rate.case,
            rate.server,
            f"{rate.requests_per_s:,.0f}",
            f"{rate.bytes_per_s / 1e6:,.0f}",
            f"{rate.cpu_s_per_gb:.3f}" if "304" not in rate.case else "-",
            f"{rate.cpu_us_per_request:.1f}",
            f"{rate.to_nginx:.2f}",
            end_section=rate.server == LAST,
        )
    Console().print(table)
