"""URLs that carry their own permission, /t/{expiry}.{kid}.{signature}/v1/streams/NAME/..., and the
file of the keys that sign: one `kid:secret` a line, the secret in hex, the newest first.

The signature stands in the path, so that relative URLs keep it, and caches need no query string. It
covers the key's name, the expiry and one stream, or `*` for all and for the list of them.

Rule: a verifier has no clock and no files. Whatever path comes in, it gives a grant or a reason.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import re
import secrets
from base64 import urlsafe_b64encode
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from pathlib import Path

from codec.errors import InvalidError
from codec.files import opened_regular, replacing

ALL = "*"
"""Signed in place of a stream's name: every stream, and the list of them."""

KID = r"[A-Za-z0-9_-]{1,32}"
"""Regular expression of a key's name."""

_PREFIX = re.compile(rf"/t/([1-9][0-9]{{0,11}})\.({KID})\.([A-Za-z0-9_-]{{43}})(/.*)", re.ASCII)

_DOT = r"(?:\.|%2[eE])"

_TOKEN = re.compile(rf"[1-9][0-9]{{0,11}}{_DOT}{KID}{_DOT}[A-Za-z0-9_-]{{20,}}", re.ASCII)
"""A signature wherever it stands, as in the query of a page, whole or most of it."""

_SLASH = "(?:/|%2[fF])"

_EDGE_DIGEST = re.compile(rf"({_SLASH}n{_SLASH})(?:[A-Za-z0-9_-]|%(?!2[fF])){{16,}}", re.ASCII)
"""A digest that nginx verifies, wherever it stands: with the expiry it opens a stream's objects."""

_OF_STREAM = re.compile(r"/(?:v1/streams|watch)/([A-Za-z0-9._-]+)(?:/.*)?", re.ASCII)

_STREAM = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,79}", re.ASCII)

_OF_ALL = ("/", "/v1/streams")

OPEN = "/web/"
"""How the paths begin that need no signature, but may have one: the player's own program."""

_DOTS = re.compile(r"/(?:\.|%2[eE]){1,2}(?:/|$)")
"""A part that a proxy or a cache might resolve to another path."""


class Reason(StrEnum):
    """Why a path is refused, as it is reported to the client."""

    UNSIGNED = "the URL is not signed"
    """It has no signature, or what is in its place does not look like one."""
    KEY = "the key of the URL is not valid on this server"
    """The key is not known here, or no longer."""
    SIGNATURE = "the signature does not match the URL"
    """The URL was altered, or signed for another stream."""
    EXPIRED = "the URL has expired"


@dataclass(frozen=True, slots=True)
class Grant:
    """The access that a signature gives."""

    path: str
    """The path without the signature."""
    stream: str
    """The stream that it speaks of; ALL for the list of streams, empty for the player's program."""
    expiry_s: int
    """Unix time at which it ends."""


class Signer:
    """Signs with the first of its keys, verifies with all."""

    def __init__(self, keys: Mapping[str, bytes]) -> None:
        """keys: secrets by key name, at least one. Raises InvalidError for a name that is none."""
        if not keys:
            raise InvalidError("there is no key to sign with")
        for kid in keys:
            if not re.fullmatch(KID, kid):
                raise InvalidError(f"key name {kid[:40]!a} is not 1 to 32 letters, digits, _ or -")
        self._keys = dict(keys)
        self._first = next(iter(keys))

    def sign(self, stream: str, expiry_s: int) -> str:
        """The prefix, without a slash at its end, that allows `stream` until `expiry_s`.

        stream: a name, or ALL. Raises InvalidError for what is neither, or a time that is none.
        """
        if stream != ALL and not _STREAM.fullmatch(stream):
            raise InvalidError(
                f"{stream[:90]!a} is not the name of a stream, and not {ALL} for all"
            )
        if not 0 < expiry_s < 10**12:
            raise InvalidError(f"expiry {expiry_s} is not a time in Unix seconds")
        expiry = str(expiry_s)
        return f"/t/{expiry}.{self._first}.{self._signature(self._first, expiry, stream)}"

    def verify(self, path: str, now_s: float) -> Grant | Reason:
        """The access that `path` gives at `now_s`, or why it gives none.

        path: as the client sent it, nothing decoded, without a query. A caller that honours the
        grant must read Grant.path and nothing else.
        """
        match = _PREFIX.fullmatch(path)
        if match is None or _DOTS.search(path):
            return Reason.UNSIGNED
        expiry, kid, signature, inner = match.groups()
        if inner.startswith(OPEN):
            # Its signature names a stream that this path does not: there is nothing to check.
            return Grant(inner, "", int(expiry))
        found = _OF_STREAM.fullmatch(inner)
        if found is None and inner not in _OF_ALL:
            return Reason.SIGNATURE
        if kid not in self._keys:
            return Reason.KEY
        stream = ALL if found is None else found[1]
        # Texts are compared, not what they decode to: the last character has bits to spare.
        given = signature.encode()
        signed = any(
            hmac.compare_digest(self._signature(kid, expiry, scope).encode(), given)
            for scope in ({stream: None, ALL: None})
        )
        if not signed:
            return Reason.SIGNATURE
        if now_s >= int(expiry):
            return Reason.EXPIRED
        return Grant(inner, stream, int(expiry))

    def _signature(self, kid: str, expiry: str, scope: str) -> str:
        message = f"swings 1\n{kid}\n{expiry}\n{scope}".encode()
        digest = hmac.digest(self._keys[kid], message, "sha256")
        return urlsafe_b64encode(digest).rstrip(b"=").decode()


def without_signatures(text: str) -> str:
    """A path or a query for a log, whose readers must not be able to use the signatures in it."""
    if text.startswith("/t/"):
        # Whatever stands there: of a URL that was cut or mistyped, nearly all of it may hold.
        _, found, rest = text[3:].partition("/")
        text = f"/t/***{found}{rest}"
    return _EDGE_DIGEST.sub(r"\1***", _TOKEN.sub("***", text))


def needs_signature(path: str) -> bool:
    """Whether `path` shows a stream, or which there are: what signed URLs are there to guard."""
    return path in _OF_ALL or path.startswith(("/v1/", "/watch/"))


def nginx_secrets(keys: Mapping[str, bytes]) -> dict[str, str]:
    """The secret that nginx needs for each key, by key name. nginx never gets a key itself: with
    what is derived from it here, nobody can sign for swings-serve."""
    message = b"swings nginx secure_link"
    return {kid: hmac.digest(key, message, "sha256").hex() for kid, key in keys.items()}


def sign_for_nginx(keys: Mapping[str, bytes], stream: str, expiry_s: int) -> str:
    """The prefix /n/{digest}/t/{token}, without a slash at its end, that allows `stream` until
    `expiry_s`, signed with the first of `keys`.

    By the digest nginx verifies URLs of objects itself (its module secure_link) and sends them from
    disk. From all other requests it removes the digest, and swings-serve verifies them as usual.
    The module can compute the MD5 of a text and nothing else, so the text ends with a secret.

    Raises InvalidError for what is not the name of one stream, or a time that is none.
    """
    if stream == ALL:
        raise InvalidError(f"nginx verifies URLs of one stream; {ALL} cannot be signed for it")
    prefix = Signer(keys).sign(stream, expiry_s)
    kid, secret = next(iter(nginx_secrets(keys).items()))
    # As secure_link_md5 has it in deploy/nginx.conf.
    text = f"{expiry_s} {kid} /v1/streams/{stream} {secret}"
    digest = urlsafe_b64encode(hashlib.md5(text.encode()).digest()).rstrip(b"=").decode()
    return f"/n/{digest}{prefix}"


MAX_BYTES = 64 * 1024

SECRET_BYTES = 32

_LINE = re.compile(rf"({KID}):((?:[0-9A-Fa-f]{{2}}){{16,128}})", re.ASCII)


def read_keys(path: Path) -> dict[str, bytes]:
    """The secrets by key name, in the order of the file; the first is the one to sign with.

    Empty lines and those that begin with # count for nothing. Raises InvalidError for a file that
    others may read or that is not one of keys, CorruptError where it cannot be read.
    """
    keys: dict[str, bytes] = {}
    for number, line in enumerate(_read(path).splitlines(), start=1):
        if not line.strip() or line.startswith("#"):
            continue
        match = _LINE.fullmatch(line.strip())
        # The message does not quote the line: it may be a secret.
        if match is None:
            raise InvalidError(f"{path}: line {number} is not NAME:SECRET, 16 bytes or more in hex")
        if match[1] in keys:
            raise InvalidError(f"{path}: line {number} repeats the key name {match[1]}")
        keys[match[1]] = bytes.fromhex(match[2])
    if not keys:
        raise InvalidError(f"{path} holds no key; swings-sign --new-key adds one")
    return keys


def add_key(path: Path) -> str:
    """Puts a new key before those of `path`, which is made where there is none; gives its name.

    The file is replaced in one step. Raises as `read_keys` does.
    """
    keys, text = dict[str, bytes](), ""
    if path.exists():
        keys, text = read_keys(path), _read(path)
    kid = secrets.token_hex(4)
    while kid in keys:
        kid = secrets.token_hex(4)
    with (
        replacing(path) as draft,
        open(draft, "w", encoding="ascii", opener=partial(os.open, mode=0o600)) as file,
    ):
        file.write(f"{kid}:{secrets.token_hex(SECRET_BYTES)}\n{text}")
    return kid


def _read(path: Path) -> str:
    with opened_regular(path, if_missing=f"swings-sign {path} --new-key makes it") as file:
        if os.fstat(file.fileno()).st_mode & 0o077:
            raise InvalidError(
                f"{path} holds secrets and other users can read it; run chmod 600 {path}"
            )
        data = file.read(MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise InvalidError(f"{path} has more than {MAX_BYTES} bytes; it is not a key file")
    try:
        return data.decode("ascii")
    except UnicodeDecodeError as error:
        raise InvalidError(f"{path} is not a key file: it is not ASCII text") from error
