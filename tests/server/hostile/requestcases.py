"""Requests that no honest client sends, and their allowed responses, as one table.

`statuses` are the allowed statuses; if there are several, HTTP leaves the choice open. Nothing here
depends on the implementation of the server.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

OBJECT = "/v1/streams/walk/segments/0/0"
STATUS = "/v1/streams/walk/play/nobody"
POISON = b"GET /poison HTTP/1.1\r\nHost: h\r\n\r\n"
"""A request hidden in another one; a server that answers it was fooled."""

BAD = (400,)
REFUSED = (400, 404)
TOO_LONG = (431,)


@dataclass(frozen=True, slots=True)
class Case:
    name: str
    sent: bytes
    """Bytes to send; ETAG stands for the object's tag."""
    statuses: tuple[int, ...]
    """Allowed statuses of every response."""
    least: int = 1
    """Minimum number of responses."""
    most: int = 1
    closes: bool = False
    """Whether the server must close the connection, because it cannot find the next request."""
    shut: bool = False
    """Whether the client closes its sending half."""


def get(target: str, *lines: str, close: bool = True) -> bytes:
    """A GET with some header lines besides Host."""
    head = [f"GET {target} HTTP/1.1", "Host: h", *lines]
    head += ["Connection: close"] if close else []
    return "\r\n".join([*head, "", ""]).encode("latin-1")


def post(*lines: str, body: bytes = b"") -> bytes:
    head = "\r\n".join([f"POST {STATUS} HTTP/1.1", "Host: h", *lines, "", ""])
    return head.encode("latin-1") + body


def smuggling() -> Iterator[Case]:
    """Bodies whose end two readers could place differently."""
    chunked = b"0\r\n\r\n" + POISON
    length = f"Content-Length: {len(chunked)}"
    refuse = (400, 404, 411, 413, 501)
    for name, lines in {
        "a length and chunks": (length, "Transfer-Encoding: chunked"),
        "chunks and a length": ("Transfer-Encoding: chunked", length),
        "two lengths": (length, "Content-Length: 5"),
        "two lengths in one line": ("Content-Length: 5, 6",),
        "a coding nobody knows": (length, "Transfer-Encoding: xchunked"),
        "chunks behind another coding": (length, "Transfer-Encoding: gzip, chunked"),
        "chunks before another coding": (length, "Transfer-Encoding: chunked, identity"),
        "chunks twice": (length, "Transfer-Encoding: chunked, chunked"),
        "two lines of codings": (
            length,
            "Transfer-Encoding: chunked",
            "Transfer-Encoding: identity",
        ),
        "a space before the colon": (length, "Transfer-Encoding : chunked"),
        "a tab before the colon": (length, "Transfer-Encoding\t: chunked"),
        "a vertical tab before chunked": (length, "Transfer-Encoding: \x0bchunked"),
        "a quoted chunked": (length, 'Transfer-Encoding: "chunked"'),
        "a folded coding": (length, "Transfer-Encoding:", " chunked"),
        "a coding in the fold of another header": (length, "X: y", " Transfer-Encoding: chunked"),
        "a coding behind a bare line feed": (length, "X: y\nTransfer-Encoding: chunked"),
        "a coding behind a bare carriage return": (length, "X: y\rTransfer-Encoding: chunked"),
    }.items():
        yield Case(f"smuggling: {name}", post(*lines, body=chunked), refuse, closes=True)
    for value in ("+5", "-1", "5x", "0x5", "1 1", "5,", "", "9" * 30, "\u00b2"):
        sent = post(f"Content-Length: {value}", body=POISON)
        yield Case(f"smuggling: a length of {value!a}", sent, refuse, closes=True)
    old = post("Transfer-Encoding: chunked", body=chunked).replace(b"HTTP/1.1", b"HTTP/1.0", 1)
    yield Case("smuggling: chunks in HTTP/1.0", old, refuse, closes=True)
    for name, body in {
        "a chunk of 0x5": b"0x5\r\nhello\r\n",
        "a chunk of +5": b"+5\r\nhello\r\n",
        "a chunk of -5": b"-5\r\nhello\r\n",
        "a chunk of more than 64 bits": b"F" * 17 + b"\r\nhello\r\n",
        "a chunk without a size": b"\r\nhello\r\n",
        "a chunk that is longer than it says": b"3\r\nhello\r\n",
        "a chunk size with a bare line feed": b"5\nhello\r\n",
        "a chunk extension with a bare line feed": b"5;a\nb\r\nhello\r\n",
        "a chunk extension of 100 kB": b"5;" + b"a" * 100_000 + b"\r\nhello\r\n",
    }.items():
        sent = post("Transfer-Encoding: chunked", body=body + b"0\r\n\r\n" + POISON)
        yield Case(f"smuggling: {name}", sent, refuse, least=0, closes=True)
    lines = (f"Content-Length: {len(POISON)}",)
    yield Case(
        "smuggling: a GET with a body",
        get("/healthz", *lines, close=False) + POISON,
        (200, 400, 413),
    )


def hosts() -> Iterator[Case]:
    """Host headers; some of them are valid and may be accepted."""
    hostile = "[", "a:b:c", "a:99999", "@", "", "a b", "a/b", "a?b", "a#b", "a\\b", "<b>", "[::1"
    for value in (*hostile, "[::1]x", "[::g]", "a:-1", "a:0x50", "a,b", "u@h", "\xe4", "a\x01b"):
        sent = f"GET / HTTP/1.1\r\nHost: {value}\r\nConnection: close\r\n\r\n".encode("latin-1")
        yield Case(f"host: {value!a}", sent, BAD)
        sent = sent.replace(b"GET / ", b"GET /watch/walk ")
        yield Case(f"host: {value!a} of the player's page", sent, BAD)
    for value in ("a:", "%61", "a.b.", "1.2.3.4:80", "[::1]:80", "a" * 255):
        sent = f"GET / HTTP/1.1\r\nHost: {value}\r\nConnection: close\r\n\r\n".encode()
        yield Case(f"host: {value[:20]!a}", sent, (200, 400))
    yield Case("host: none", b"GET / HTTP/1.1\r\nConnection: close\r\n\r\n", BAD)
    yield Case("host: none in HTTP/1.0", b"GET / HTTP/1.0\r\n\r\n", (200, 400))
    yield Case("host: twice", get("/", "Host: h"), BAD)
    yield Case("host: two of them", get("/", "Host: other"), BAD)


def request_lines() -> Iterator[Case]:
    """Odd targets and versions."""
    end = b"Host: h\r\nConnection: close\r\n\r\n"
    odd = (400, 404, 405, 501)
    strange = ["2.0", "3", "0.9", "1.10", "11", "+1.1"]
    for line, statuses in {
        "GET http://h/healthz HTTP/1.1": (200, 400),
        "GET http://evil.example/healthz HTTP/1.1": (200, 400),
        "GET http://u@h/healthz HTTP/1.1": (200, 400),
        "GET http://[/ HTTP/1.1": odd,
        "GET http:///healthz HTTP/1.1": (200, *odd),
        "GET ftp://h/healthz HTTP/1.1": (200, *odd),
        "GET file:///etc/passwd HTTP/1.1": odd,
        "GET h:80 HTTP/1.1": odd,
        "CONNECT h:80 HTTP/1.1": odd,
        "CONNECT /healthz HTTP/1.1": odd,
        "GET * HTTP/1.1": odd,
        "OPTIONS * HTTP/1.1": (200, 204, *odd),
        "GET healthz HTTP/1.1": odd,
        "GET  /healthz HTTP/1.1": (200, 400),
        "GET /healthz  HTTP/1.1": (200, 400),
        "GET /healthz HTTP/1.1 ": BAD,
        " GET /healthz HTTP/1.1": BAD,
        "GET\t/healthz\tHTTP/1.1": BAD,
        "GET /heal thz HTTP/1.1": BAD,
        "GET /healthz#x HTTP/1.1": (200, 400, 404),
        "GET /healthz\x00 HTTP/1.1": REFUSED,
        "GET /\xe4 HTTP/1.1": REFUSED,
        "GET /healthz HTTP/1.2": (200, 400, 505),
        **dict.fromkeys((f"GET /healthz HTTP/{version}" for version in strange), (400, 505)),
        "GET /healthz HTTP/1.1\x0b": BAD,
        "GET /healthz http/1.1": (400, 505),
        "GET /healthz ICY/1.1": (400, 505),
        "GET /healthz": (400, 505),
        "GET": BAD,
        "\x00\x00\x00\x00": BAD,
        "get /healthz HTTP/1.1": odd,
        "FOO /healthz HTTP/1.1": odd,
        "G\x80T /healthz HTTP/1.1": odd,
        "TRACE /healthz HTTP/1.1": odd,
        f"{'X' * 1000} /healthz HTTP/1.1": (*odd, 414, 431),
    }.items():
        sent = line.encode("latin-1") + b"\r\n" + end
        yield Case(f"line: {line[:60]!a}", sent, statuses)
    for method in ("PUT", "DELETE", "PATCH", "POST"):
        sent = get(OBJECT).replace(b"GET", method.encode(), 1)
        yield Case(f"line: {method} of an object", sent, (400, 405, 411, 501))
    preface = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes(9)
    yield Case("line: the preface of HTTP/2", preface, (400, 505), least=0, closes=True)
    yield Case("line: HTTP/0.9", b"GET /healthz\r\n", (400, 505), least=0, closes=True, shut=True)
    hello = bytes.fromhex("1603010200010001fc0303") + bytes(range(256)) * 2
    yield Case("line: the hello of TLS", hello, BAD, least=0, closes=True, shut=True)
    yield Case("line: 10 kB of zeros", bytes(10_000), BAD, least=0, closes=True)
    yield Case("line: another protocol", b"SSH-2.0-x\r\n" * 9, BAD, least=0, closes=True, shut=True)
    yield Case("line: an empty line first", b"\r\n" + get("/healthz"), (200, 400))
    blank = b"\r\n" * 50_000 + get("/healthz")
    yield Case("line: many empty lines first", blank, (200, 400, 431), least=0)


def headers() -> Iterator[Case]:
    """Odd header lines, and too many bytes of them."""
    for name, lines in {
        "a fold": ("X: y", " z"),
        "a fold of the first": ("\tX: y",),
        "no colon": ("nonsense",),
        "no name": (": y",),
        "a space in the name": ("X Y: z",),
        "a space before the colon": ("X : y",),
        "a zero in the value": ("X: a\x00b",),
        "a zero in the name": ("X\x00: ab",),
        "a control character in the value": ("X: a\x01b",),
        "a bare carriage return": ("X: a\rY: b",),
        "a name that is not ASCII": ("\xe4: y",),
        "a name with brackets": ("X(y): z",),
    }.items():
        yield Case(f"header: {name}", get("/healthz", *lines), BAD, closes=True)
    # A reader may accept a bare line feed as the end of a line, or wait for a CRLF.
    feeds = get("/healthz").replace(b"\r\n", b"\n")
    yield Case("header: only bare line feeds", feeds, (200, 400, 408), least=0)
    yield Case("header: a value that is not ASCII", get("/healthz", "X: \xe4"), (200, 400))
    yield Case("header: 100 lines", get("/healthz", *(f"X{n}: y" for n in range(98))), (200,))
    yield Case("header: 129 lines", get("/healthz", *(f"X{n}: y" for n in range(127))), TOO_LONG)
    many = get("/healthz", *(f"X{n}: y" for n in range(5000)))
    yield Case("header: 5000 lines", many, TOO_LONG, least=0, closes=True)
    long = "y" * 70_000
    yield Case("header: 70 kB", get("/healthz", f"X: {long}"), TOO_LONG, least=0, closes=True)
    named = get("/healthz", f"{long}: x")
    yield Case("header: a name of 70 kB", named, TOO_LONG, least=0, closes=True)
    yield Case("header: a target of 70 kB", get(f"/{long}"), (414, 431), least=0, closes=True)
    yield Case("header: a target of 9 kB", get(f"/{long[:9000]}"), (414,))
    endless = b"GET /healthz HTTP/1.1\r\nX: " + b"y" * 500_000
    yield Case("header: a line without an end", endless, TOO_LONG, least=0, closes=True)
    for value in ("websocket", "h2c"):
        lines = f"Upgrade: {value}", "Connection: Upgrade", "HTTP2-Settings: AAMAAABk"
        sent = get("/healthz", *lines, close=False)
        yield Case(f"header: an upgrade to {value}", sent, (200, 400, 426))
    yield Case("header: many encodings", get("/healthz", f"Accept-Encoding: {'a,' * 2000}"), (200,))


def conditions() -> Iterator[Case]:
    """Ranges and conditions; the bytes of all responses with 200 or 206 are checked."""
    for value in (
        "bytes=0-0,2-3",
        "bytes=" + ",".join(["0-"] * 1000),
        "bytes=0-9,5-14,5-14",
        "bytes=--5",
        "bytes=5-2",
        "bytes=+0-5",
        "bytes=0x0-5",
        "bytes=0-5;q=1",
        "bytes=",
        "bytes",
        "bytes=-",
        "lines=0-5",
        "bytes=\xb2-5",
    ):
        yield Case(f"range: {value[:30]!a}", get(OBJECT, f"Range: {value}"), (200, 206, 400, 416))
    for value, statuses in {
        "bytes=0-99999999999999999999999999": (200, 206),
        "bytes=-99999999999": (200, 206),
        "BYTES=0-5": (200, 206),
        "bytes= 0-5": (200, 206),
        "bytes=99999999999999999999-": (200, 416),
        "bytes=-0": (416,),
        "bytes=9999999-": (416,),
        "bytes=3-7": (206,),
        "bytes=-7": (206,),
    }.items():
        yield Case(f"range: {value!a}", get(OBJECT, f"Range: {value}"), statuses)
    two = get(OBJECT, "Range: bytes=0-1", "Range: bytes=3-4")
    yield Case("range: two lines", two, (200, 206, 400))
    weak = get(OBJECT, "Range: bytes=0-1", "If-Range: W/ETAG")
    yield Case("range: if a weak tag", weak, (200,))
    other = get(OBJECT, "Range: bytes=0-1", "If-Range: Tue, 01 Jan 2030 00:00:00 GMT")
    yield Case("range: if a date", other, (200,))
    for name, lines, expected in (
        ("two lines of tags", ('If-None-Match: "x"', "If-None-Match: ETAG"), (304,)),
        ("a thousand tags", ("If-None-Match: " + '"x", ' * 1000 + "ETAG",), (304,)),
        ("any tag", ("If-None-Match: *",), (304,)),
        ("a tag without an end", ('If-None-Match: "x',), (200, 400)),
        ("a tag without quotes", ("If-None-Match: x",), (200, 400)),
        ("a comma in a tag", ('If-None-Match: "a,b"',), (200,)),
        ("must be another", ('If-Match: "x"',), (412,)),
        ("must be a weak one", ("If-Match: W/ETAG",), (412,)),
        ("must be this one", ("If-Match: ETAG",), (200,)),
        ("must be one of two lines", ('If-Match: "x"', "If-Match: ETAG"), (200,)),
        ("must be any", ("If-Match: *",), (200,)),
        ("must be this one, of which a range", ("If-Match: ETAG", "Range: bytes=0-3"), (206,)),
    ):
        yield Case(f"tag: {name}", get(OBJECT, *lines), expected)


def paths() -> Iterator[Case]:
    """Paths that lead out of a stream."""
    stream = "/v1/streams/walk"
    for path in (
        f"{stream}%2Fsegments/0/0",
        f"{stream}/segments%2F0%2F0",
        f"{stream}/../../secret.png",
        f"{stream}/..%2f..%2fsecret.png",
        f"{stream}/../secret.png",
        f"{stream}/%2e%2e/secret.png",
        f"{stream}/..%5csecret.png",
        f"{stream}/..%252fsecret.png",
        f"{stream}/%c0%ae%c0%ae/secret.png",
        f"{stream}/..;/secret.png",
        f"{stream}/./secret.png",
        f"{stream}/secret.png",
        f"{stream}/manifest.json%00.png",
        f"{stream}/segments/0/0%00",
        f"{stream}/segments/0/0/",
        f"{stream}/segments/0/../0/0x",
        f"{stream}/segments/0/-1",
        f"{stream}/segments/00/0",
        f"{stream}/segments/0/\xb2",
        f"{stream}/segments/{'9' * 4000}/0",
        "/v1/streams/../secret.png",
        "/v1/streams/..%2fsecret.png",
        "/v1/streams/%2e%2e/secret.png",
        "/v1/streams/.hidden/manifest.json",
        "/v1/streams/.%2fwalk/manifest.json",
        "/v1/streams//walk/manifest.json",
        "//etc/passwd",
        "/etc/passwd",
        "/../../etc/passwd",
        "/web/../../secret.png",
        "/web/%2e%2e/%2e%2e/server/app.py",
        "/web/..%2fapp.py",
        "/web//etc/passwd",
        "/watch/..%2fsecret.png",
        "/%zz",
        "/%",
        "/%u0041",
    ):
        yield Case(f"path: {path[:60]!a}", get(path), REFUSED)
    for query in (
        "from=-1",
        "from=1e3",
        "from=99999999999999999999",
        "from=0&from=1",
        "from=%00",
        "from=%zz",
        "layers=0",
        "layers=999",
        "layers=",
        "until=0",
        "unknown=1",
        "paused=2",
        f"from={'0' * 5000}",
        "&" * 5000,
    ):
        sent = get(f"{stream}/play?{query}")
        statuses = (200, 400) if query.startswith("&") else (400,)
        yield Case(f"query: {query[:30]!a}", sent, statuses)


def bodies() -> Iterator[Case]:
    """Status reports with wrong lengths, and many requests at once."""
    status = b'{"frame": 1}'
    close = "Connection: close"
    rest = post(f"Content-Length: {len(status) - 4}", body=status)
    yield Case("body: more than its length", rest, (400, 404), most=2)
    less = post(f"Content-Length: {len(status) + 9}", body=status)
    yield Case("body: less than its length", less, (400, 404, 408), least=0, shut=True)
    yield Case("body: no length", post(close, body=status), (400, 404, 411))
    big = post("Content-Length: 1000000000", body=status)
    yield Case("body: a gigabyte is announced", big, (400, 404, 413))
    long = post("Content-Length: 300000", close, body=bytes(300_000))
    yield Case("body: 300 kB come", long, (400, 404, 413), least=0)
    ask = post(f"Content-Length: {len(status)}", "Expect: 100-continue", close, body=status)
    yield Case("body: the client wants to be asked", ask, (100, 400, 404, 417), most=2)
    odd = post(f"Content-Length: {len(status)}", "Expect: the-unexpected", close, body=status)
    yield Case("body: the client expects what nobody knows", odd, (400, 404, 417))
    chunks = post("Transfer-Encoding: chunked", close, body=b"c\r\n" + status + b"\r\n0\r\n\r\n")
    yield Case("body: in chunks", chunks, (404, 411, 501))
    trailer = post("Transfer-Encoding: chunked", body=b"0\r\nContent-Length: 5\r\n\r\n" + POISON)
    yield Case("body: a length behind the chunks", trailer, (400, 404, 411, 501), most=2)
    one = get("/healthz", close=False)
    fifty = one * 49 + get("/healthz")
    yield Case("pipeline: 50 of health", fifty, (200,), least=50, most=50)
    mixed = (get(OBJECT, close=False) + get("/nope", close=False)) * 25
    yield Case("pipeline: 25 objects, 25 not there", mixed, (200, 404), least=50, most=50)
    stop = one * 3 + b"nonsense\r\n\r\n" + one * 3
    # Requests from the same read may stay unanswered.
    yield Case("pipeline: nonsense after three", stop, (200, 400), least=1, most=4, closes=True)
    yield Case("half: a whole request", one, (200,), least=0, closes=True, shut=True)
    yield Case("half: half a request", one[:20], (400, 408), least=0, closes=True, shut=True)
    yield Case("half: nothing", b"", (), least=0, most=0, closes=True, shut=True)


CASES = [
    case
    for cases in (smuggling, hosts, request_lines, headers, conditions, paths, bodies)
    for case in cases()
]
