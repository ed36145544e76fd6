"""Signed URLs that nginx verifies itself, by its module secure_link: /n/{digest}/t/{token}/...

The digest stands before the prefix that swings-serve verifies, and allows nginx to send the objects
of one stream from disk. From all other requests nginx removes it, and swings-serve verifies them as
usual. The module can compute the MD5 of a text and nothing else, so the text ends with a secret.

Rule: no clock and no files. nginx never gets a key itself: the secret derived from it
cannot sign for swings-serve.
"""

from __future__ import annotations

import hashlib
import hmac
from base64 import urlsafe_b64encode
from collections.abc import Mapping

from codec.errors import InvalidError

from .signing import ALL, Signer


def nginx_secrets(keys: Mapping[str, bytes]) -> dict[str, str]:
    """The secret that nginx needs for each key, by key name."""
    message = b"swings nginx secure_link"
    return {kid: hmac.digest(key, message, "sha256").hex() for kid, key in keys.items()}


def sign_for_nginx(keys: Mapping[str, bytes], stream: str, expiry_s: int) -> str:
    """The prefix, without a slash at its end, that allows `stream` until `expiry_s`, signed with
    the first of `keys`.

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
