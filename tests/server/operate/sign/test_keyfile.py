"""The file of keys, and the command that signs with it."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from codec.errors import CorruptError, InvalidError
from server.operate.sign.signing import (
    ALL,
    Grant,
    Signer,
    add_key,
    nginx_secrets,
    read_keys,
    sign_for_nginx,
)
from tests.support.commands import run, run_ok
from tests.support.hostile import refused

SECRET = "0123456789abcdef" * 2
INNER = ("/watch/walk", "/v1/streams/walk/manifest.json")
"""The paths that the command prints for a stream, without their prefix."""


def keys_of(path: Path, text: str, mode: int = 0o600) -> Path:
    path.write_text(text)
    path.chmod(mode)
    return path


def test_the_first_key_signs_and_all_verify(tmp_path: Path) -> None:
    path = keys_of(tmp_path / "keys", f"# mine\n\nb:{SECRET}\na:{SECRET[::-1]}\n")
    assert read_keys(path) == {"b": bytes.fromhex(SECRET), "a": bytes.fromhex(SECRET[::-1])}
    assert list(read_keys(path)) == ["b", "a"]


def test_a_new_key_comes_first_and_the_others_stay(tmp_path: Path) -> None:
    path = tmp_path / "keys"
    first = add_key(path)
    assert path.stat().st_mode & 0o777 == 0o600
    path.write_text("# kept\n" + path.read_text())
    second = add_key(path)
    assert list(read_keys(path)) == [second, first]
    assert "# kept\n" in path.read_text()
    assert os.listdir(tmp_path) == ["keys"]
    assert all(len(secret) == 32 for secret in read_keys(path).values())


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o666])
def test_a_file_that_others_may_read_is_refused(tmp_path: Path, mode: int) -> None:
    path = keys_of(tmp_path / "keys", f"a:{SECRET}\n", mode)
    refused(InvalidError, "chmod 600", read_keys, path)
    refused(InvalidError, "chmod 600", add_key, path)


def test_a_missing_file_is_named_with_what_makes_it(tmp_path: Path) -> None:
    with pytest.raises(CorruptError, match=r"keys is missing; swings-sign .*keys --new-key"):
        read_keys(tmp_path / "keys")


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("", "holds no key"),
        ("# nothing\n", "holds no key"),
        (f"a:{SECRET}\na:{SECRET}\n", "line 2 repeats the key name a"),
        (f"a:{SECRET}\nb {SECRET}\n", "line 2 is not"),
        ("a:0123\n", "line 1 is not"),
        (f"a:{SECRET}0\n", "line 1 is not"),
        (f"a.b:{SECRET}\n", "line 1 is not"),
        (f"a:{SECRET}\n" + "ä", "ASCII"),
        ("#" * 70_000, "more than"),
    ],
)
def test_what_is_not_a_file_of_keys_is_named_without_its_secrets(
    tmp_path: Path, text: str, word: str
) -> None:
    path = keys_of(tmp_path / "keys", text)
    raised = refused(InvalidError, word, read_keys, path)
    assert SECRET not in str(raised)


def test_a_fifo_does_not_hold_it_up(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "keys", 0o600)
    for path, reason in ((tmp_path / "keys", "regular file"), (tmp_path, "directory")):
        refused(CorruptError, reason, read_keys, path)


def test_the_command_prints_urls_that_the_server_grants(tmp_path: Path) -> None:
    path = tmp_path / "keys"
    options = "--new-key", "--hours", 2, "--url", "https://h.example/"
    out = run_ok("swings-sign", path, "walk", *options)
    lines = [line.split() for line in out.splitlines()]
    assert [line[0] for line in lines] == ["new", "page", "manifest"]
    signer = Signer(read_keys(path))
    for line, inner in zip(lines[1:], INNER, strict=True):
        assert line[1].startswith("https://h.example/t/")
        granted = signer.verify(line[1].removeprefix("https://h.example"), time.time())
        assert isinstance(granted, Grant)
        assert granted.path == inner
        assert abs(granted.expiry_s - time.time() - 7200) < 60
    out = run_ok("swings-sign", path, ALL)
    page = out.split()[1].removeprefix("http://127.0.0.1:8080")
    assert signer.verify(page, time.time()) == Grant("/", ALL, int(page[3:].split(".")[0]))


def test_the_command_signs_for_nginx_with_secrets_that_are_not_the_keys(tmp_path: Path) -> None:
    path = keys_of(tmp_path / "keys", f"b:{SECRET[::-1]}\na:{SECRET}\n")
    keys = read_keys(path)
    out = run_ok("swings-sign", path, "walk", "--nginx", "--url", "https://h.example")
    for line, inner in zip(out.splitlines(), INNER, strict=True):
        url = line.split()[1].removeprefix("https://h.example")
        digest, found, rest = url.removeprefix("/n/").partition("/t/")
        granted = Signer(keys).verify(found + rest, time.time())
        assert isinstance(granted, Grant)
        assert granted.path == inner
        prefix = sign_for_nginx(keys, "walk", granted.expiry_s)
        assert url == prefix + inner
        assert digest in prefix
    out = run_ok("swings-sign", path, "--nginx-secrets")
    assert out == "".join(f"key={kid} {nginx_secrets(keys)[kid]};\n" for kid in "ba")
    assert len({*nginx_secrets(keys).values(), *(key.hex() for key in keys.values())}) == 4
    refused(InvalidError, "one stream", sign_for_nginx, keys, ALL, 2_000_000_000)


@pytest.mark.parametrize(
    ("arguments", "code", "word"),
    [
        ("keys", 2, "--new-key"),
        ("keys --nginx", 2, "name a stream"),
        ("keys walk --nginx-secrets", 2, "give it alone"),
        ("keys * --nginx", 1, "cannot be signed"),
        ("keys a/b", 1, "name of a stream"),
        ("keys walk --hours 0", 2, "hours"),
        ("keys walk --hours nan", 2, "hours"),
        ("keys walk --url ftp://x", 2, "https://HOST"),
        ("absent walk", 1, "absent is missing"),
    ],
)
def test_mistakes_are_one_clear_line(tmp_path: Path, arguments: str, code: int, word: str) -> None:
    keys_of(tmp_path / "keys", f"a:{SECRET}\n")
    done = run("swings-sign", *arguments.split(), folder=tmp_path)
    assert (done.returncode, done.stdout) == (code, "")
    assert word in done.stderr
    assert "Traceback" not in done.stderr
    assert code == 2 or done.stderr.count("\n") == 1
