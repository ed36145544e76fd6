"""The same immutable objects from swings-serve, nginx, deploy/nginx.conf at signed URLs, and
aiohttp's bare web.Response.

Each row is an object and a kind of request. In every round each server answers it for some seconds,
one after the other, so that a slowdown of the machine affects all servers. A figure is the median
of the rounds. wrk sends the requests over kept connections, from another core than the server's.

CPU seconds are user and system time of the server's processes, over what wrk read, heads included.
`to nginx` is bytes per CPU second relative to nginx; for 304, requests per CPU second. For ranges
compare this figure, not the rate: with tcp_nopush, which Debian sets, nginx holds back the end of a
range for 40 ms unless the range begins with a page.
"""

from __future__ import annotations

import http.client
import os
import re
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from statistics import median

from rich.console import Console
from rich.table import Table

from codec.errors import SwingsError
from server.operate.sign.signing import nginx_secrets, sign_for_nginx

from .material import write_objects
from .processes import ROOT, cpu_s, pinned, running, serving

TRIES = 4
"""Maximum runs of wrk in one round."""
BARE, SIGNED = "aiohttp", "nginx, signed"
"""Names in the table: aiohttp's bare web.Response, and nginx with deploy/nginx.conf."""
SHIPPED = {
    r"^user .*;": "{user}",
    r"^worker_processes auto;": "worker_processes 1; daemon off;",
    r"^pid .*;": "pid {folder}/nginx.pid;",
    r"/var/log/nginx": "{folder}",
    r"/var/cache/nginx/swings": "{folder}/cache",
    r"listen 80;": "listen unix:{folder}/plain.sock;",
    r"listen 443 ssl http2;": "listen 127.0.0.1:{port};",
    r"^ *ssl_.*;$": "",
    r"/etc/nginx/swings-secrets": "{folder}/swings-secrets",
    r"/srv/swings": "{root}",
    r"default_type .*;": "default_type application/octet-stream; proxy_temp_path {folder}/proxy;"
    " client_body_temp_path {folder}/body; fastcgi_temp_path {folder}/fastcgi;"
    " uwsgi_temp_path {folder}/uwsgi; scgi_temp_path {folder}/scgi;",
}
"""Changes to deploy/nginx.conf: names, ports, folders, one worker, and no TLS."""
KEYS = {"bench": bytes(32)}
SCRIPT = """
done = function(summary)
  local e = summary.errors
  local bad = e.connect + e.read + e.write + e.status + e.timeout
  io.write(string.format("SUM %d %d %d %d\\n", summary.requests, summary.bytes,
    summary.duration, bad))
end
"""
NGINX = """
{user} daemon off;
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
"""Debian's nginx.conf in everything relevant here, with one worker."""


@dataclass(frozen=True, slots=True)
class Case:
    """A row of the table: the object and the kind of request."""

    what: str
    path: str
    header: str = ""
    """`Name: value`; the value ETAG stands for the server's tag of the object."""
    status: int = 200


@dataclass(frozen=True, slots=True)
class Rate:
    """Figures of a server in a case: medians over all rounds."""

    case: str
    server: str
    requests_per_s: float
    bytes_per_s: float
    cpu_s_per_gb: float
    cpu_us_per_request: float
    to_nginx: float
    """Bytes per CPU second relative to nginx; NaN without nginx."""


@dataclass(frozen=True, slots=True)
class _Round:
    requests: int
    num_bytes: int
    seconds: float
    cpu_s: float


def cases_of(sizes_kb: tuple[int, ...]) -> list[Case]:
    """A row for each size, and for one object a range request and a conditional request (304)."""
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
    """Path of `program`. Raises SwingsError, which names the package to install."""
    for folder in (*os.environ.get("PATH", "").split(os.pathsep), "/usr/sbin"):
        if found := shutil.which(program, path=folder):
            return found
    raise SwingsError(f"there is no {program}; on Debian: apt-get install {package}")


@contextmanager
def nginx(root: Path, folder: Path, core: int, shipped: bool = False) -> Iterator[tuple[int, int]]:
    """Runs nginx for the objects below `root`; gives its process id and port. shipped: uses
    deploy/nginx.conf, which sends the objects from disk at URLs signed with KEYS."""
    folder.mkdir()
    port = free_port()
    config = folder / "nginx.conf"
    user = "user root;" if os.getuid() == 0 else ""  # its worker must read a temporary folder
    values = {"user": user, "folder": folder, "port": port, "root": root}
    if shipped:
        text = (ROOT / "deploy" / "nginx.conf").read_text()
        for pattern, new in SHIPPED.items():
            text, count = re.subn(pattern, new.format(**values), text, flags=re.MULTILINE)
            if not count:
                raise SwingsError(f"deploy/nginx.conf has no {pattern} any more; see {__name__}")
        config.write_text(text)
        secrets = [f"key={kid} {secret};\n" for kid, secret in nginx_secrets(KEYS).items()]
        (folder / "swings-secrets.map").write_text("".join(secrets))
    else:
        config.write_text(NGINX.format(**values))
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


def path_at(server: str, case: Case) -> str:
    """The path of a case on this server."""
    if server != SIGNED:
        return case.path
    stream = case.path.split("/")[3]
    return sign_for_nginx(KEYS, stream, int(time.time()) + 3600) + case.path


@contextmanager
def bare_response(root: Path, core: int) -> Iterator[tuple[int, int]]:
    """Runs aiohttp's bare web.Response; gives its process id and port."""
    command = [*pinned(core), sys.executable, Path(__file__).with_name("bareresponse.py"), root]
    with running(command, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        yield process.pid, int(process.stdout.readline())


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as sock:
        return int(sock.getsockname()[1])


def header_of(case: Case, port: int, path: str) -> str:
    """The header for this server. Raises SwingsError unless the server answers as expected."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    header = case.header
    try:
        if "ETAG" in header:
            connection.request("GET", path)
            response = connection.getresponse()
            response.read()
            header = header.replace("ETAG", response.headers["ETag"] or "")
        name, _, value = header.partition(": ")
        connection.request("GET", path, headers={name: value} if name else {})
        response = connection.getresponse()
        response.read()
    finally:
        connection.close()
    if response.status != case.status:
        raise SwingsError(f"{case.what}: answered {response.status}, not {case.status}")
    return header


def ask(
    pid: int, url: str, wanted: tuple[str, ...], seconds: float, core: int, script: Path
) -> _Round:
    """Runs wrk for `seconds`, and again for twice as long each time if a busy machine answered no
    request. wanted: further options of wrk. Raises SwingsError if wrk or a request fails."""
    for longer in range(TRIES):
        one = _asked(pid, url, wanted, seconds * 2**longer, core, script)
        if one.requests:
            return one
    raise SwingsError(f"{url}: no request was answered in {seconds * 2 ** (TRIES - 1):.0f} s")


def _asked(
    pid: int, url: str, wanted: tuple[str, ...], seconds: float, core: int, script: Path
) -> _Round:
    command = [*pinned(core), need("wrk", "wrk"), "-t1", f"-d{max(1, round(seconds))}s"]
    command += ["-s", str(script), *wanted, url]
    before_s = cpu_s(pid)
    done = subprocess.run(command, capture_output=True, text=True)
    used_s = cpu_s(pid) - before_s
    found = [line.split()[1:] for line in done.stdout.splitlines() if line.startswith("SUM ")]
    if done.returncode or not found:
        raise SwingsError(f"wrk failed: {(done.stderr or done.stdout).strip()[-300:]}")
    requests, num_bytes, took_us, bad = map(int, found[0])
    if bad:
        raise SwingsError(f"{url}: {bad} of {requests} requests failed")
    return _Round(requests, num_bytes, took_us / 1e6, used_s)


def measure_objects(
    sizes_kb: tuple[int, ...],
    rounds: int,
    seconds: float,
    connections: int,
    cores: tuple[int, int],
    options: tuple[str, ...],
    around: Callable[[int], ExitStack],
) -> list[Rate]:
    """All rows. around: opens what is needed meanwhile, given the process id of swings-serve."""
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
            "nginx": stack.enter_context(nginx(root, folder / "plain", cores[0])),
            SIGNED: stack.enter_context(nginx(root, folder / "signed", cores[0], shipped=True)),
            BARE: stack.enter_context(bare_response(root, cores[0])),
        }
        stack.enter_context(around(servers["swings"][0]))
        rates: list[Rate] = []
        for case in cases_of(sizes_kb):
            # The bare response supports neither ranges nor conditions.
            asked = {name: at for name, at in servers.items() if name != BARE or case.status == 200}
            paths = {server: path_at(server, case) for server in asked}
            headers = {
                server: header_of(case, port, paths[server]) for server, (_, port) in asked.items()
            }
            taken: dict[str, list[_Round]] = {server: [] for server in asked}
            for _ in range(rounds):
                for server, (pid, port) in asked.items():
                    at = f"http://127.0.0.1:{port}{paths[server]}"
                    wanted = (
                        f"-c{connections}",
                        *(("-H", headers[server]) if headers[server] else ()),
                    )
                    one = ask(pid, at, wanted, seconds, cores[1], script)
                    taken[server].append(one)
            rates += rates_of(case, taken)
        return rates


def rates_of(case: Case, taken: dict[str, list[_Round]]) -> list[Rate]:
    """The medians of each server's rounds."""
    # A measured CPU time of zero is less than one tick of the clock.
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
    for rate, following in zip_longest(rates, rates[1:]):
        table.add_row(
            rate.case,
            rate.server,
            f"{rate.requests_per_s:,.0f}",
            f"{rate.bytes_per_s / 1e6:,.0f}",
            f"{rate.cpu_s_per_gb:.3f}" if "304" not in rate.case else "-",
            f"{rate.cpu_us_per_request:.1f}",
            f"{rate.to_nginx:.2f}",
            end_section=following is None or following.case != rate.case,
        )
    Console().print(table)
