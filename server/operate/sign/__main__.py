"""swings-sign: URLs that show one stream for a while."""

from __future__ import annotations

import re
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro

from codec.console import run_command
from codec.errors import InvalidError

from .signing import ALL, Signer, add_key, nginx_secrets, read_keys, sign_for_nginx

MAX_HOURS = 10 * 366 * 24


@dataclass(frozen=True, slots=True)
class SignCommand:
    """Sign the URLs of a stream with the keys that swings-serve verifies."""

    keys: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="KEYS")]]
    """Key file; other users must not be able to read it."""
    stream: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="NAME")]] = ""
    """Name of the stream, which is not looked up; "*" for all streams and the list of them."""
    hours: float = 24.0
    """Hours for which the URLs are valid."""
    url: str = "http://127.0.0.1:8080"
    """URL of the server for its clients."""
    new_key: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Add a new key at the top of the key file; a missing file is created. Make the server reload
    the file (SIGHUP) before you use URLs signed with the new key. To revoke a key, delete its
    line."""
    nginx: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Sign so that deploy/nginx.conf verifies URLs of objects itself and sends them from disk."""
    nginx_secrets: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print the secrets that nginx needs for --nginx, for a file that only root can read."""

    def __post_init__(self) -> None:
        if self.nginx_secrets and (self.stream or self.new_key or self.nginx):
            raise InvalidError("--nginx-secrets signs nothing and adds no key; give it alone")
        if not (self.stream or self.new_key or self.nginx_secrets):
            raise InvalidError("name a stream to sign for, or give --new-key or --nginx-secrets")
        if not 0 < self.hours <= MAX_HOURS:
            raise InvalidError(f"hours is {self.hours}; give over 0, at most {MAX_HOURS}")
        if not re.fullmatch(r"https?://[!-~]+", self.url):
            raise InvalidError(f"url {self.url!a} is not of the form https://HOST")


def run(command: SignCommand) -> None:
    if command.new_key:
        print(f"new key   {add_key(command.keys)}")
    if command.nginx_secrets:
        for kid, secret in nginx_secrets(read_keys(command.keys)).items():
            print(f"key={kid} {secret};")
    if command.stream:
        keys = read_keys(command.keys)
        expiry_s = int(time.time() + command.hours * 3600)
        sign = partial(sign_for_nginx, keys) if command.nginx else Signer(keys).sign
        base = command.url.rstrip("/") + sign(command.stream, expiry_s)
        if command.stream == ALL:
            print(f"page      {base}/")
            print(f"streams   {base}/v1/streams")
        else:
            print(f"page      {base}/watch/{command.stream}")
            print(f"manifest  {base}/v1/streams/{command.stream}/manifest.json")


def main() -> None:
    run_command(SignCommand, run, "swings-sign", "Signs the URLs of a stream.")


if __name__ == "__main__":
    main()
