"""Writes requests for fuzz/http.py into a folder: `python -m fuzz.httpseed FOLDER`."""

from __future__ import annotations

import sys
from pathlib import Path

from tests.server.hostile.requestcases import CASES

MAX_BYTES = 4096
"""Longest seed: longer ones slow the fuzzer down and show it nothing new."""


def requests() -> list[bytes]:
    """Requests of clients, hostile and not, without the first byte, which gives the cuts."""
    honest = [
        b"GET /v1/streams/walk/play?%s HTTP/1.1\r\nHost: h\r\nAccept-Encoding: zstd, gzip\r\n\r\n"
        % query
        for query in (b"", b"plain=1", b"from=3&until=5&layers=1", b"paused=1", b"from=live")
    ]
    for path in (b"/", b"/watch/walk", b"/v1/streams", b"/metrics", b"/readyz", b"/web/player.js"):
        honest.append(b"GET %s HTTP/1.1\r\nHost: h\r\n\r\n" % path)
    for name in (b"manifest.json", b"index.bin?after=10&wait=1", b"segments/0/1"):
        honest.append(b"HEAD /v1/streams/walk/%s HTTP/1.1\r\nHost: h\r\n\r\n" % name)
        honest.append(b"GET /v1/streams/walk/%s HTTP/1.0\r\n\r\n" % name)
    return [*honest, *(case.sent for case in CASES if len(case.sent) <= MAX_BYTES)]


def main() -> None:
    folder = Path(sys.argv[1])
    folder.mkdir(exist_ok=True)
    for number, sent in enumerate(requests()):
        (folder / str(number)).write_bytes(bytes([number % 4]) + sent)


if __name__ == "__main__":
    main()
