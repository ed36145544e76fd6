"""Object stores: a real S3 server, and one clear line for each possible failure."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from codec.errors import CodecError, InvalidError, UnreadableError
from codec.storage import objectstore
from codec.storage.objectstore import RetryPolicy
from codec.storage.openstorage import open_storage
from tests.support.commands import run, run_ok
from tests.support.hostile import refused
from tests.support.stores.s3_server import BUCKET, S3Server, s3_server
from tests.support.tiny_stream import write_tiny

pytest.importorskip("obstore", reason="object stores need the extra s3")


@pytest.fixture(scope="module")
def server() -> Iterator[S3Server]:
    with s3_server() as server:
        yield server


def test_the_commands_take_urls(server: S3Server, tmp_path: Path) -> None:
    write_tiny(tmp_path / "s", 4)
    server.upload(tmp_path / "s", "deep/er/s")
    url = f"s3://{BUCKET}/deep/er/s"
    told = json.loads(run_ok("swings-stream", "info", f"{url}/", "--json"))
    assert told == json.loads(run_ok("swings-stream", "info", tmp_path / "s", "--json"))
    done = run("swings-stream", "verify", f"s3://{BUCKET}/nothing")
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert f"s3://{BUCKET}/nothing/manifest.json is missing" in done.stderr


def test_what_a_store_refuses_is_one_line(
    server: S3Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(objectstore, "BRIEF", RetryPolicy(10.0, 0.001, 0.001, max_retries=1))
    storage = open_storage("s3://no-such-bucket/x")
    error = refused(UnreadableError, "", storage.check)
    assert str(error).startswith("s3://no-such-bucket/x/ cannot be read: ")
    assert "NoSuchBucket" in str(error)
    held = open_storage(f"s3://{BUCKET}/x")
    server.stop()
    try:
        for ask in (held.check, lambda: held.read("m", 10), lambda: held.stamp("m")):
            error = refused(UnreadableError, "", ask)
            assert "\n" not in str(error)
            assert len(str(error)) < 400
    finally:
        server.start()
    assert held.stamp("m") is None


@pytest.mark.parametrize(
    ("changes", "advice"),
    [
        ({"AWS_ALLOW_HTTP": "false"}, "which AWS_ALLOW_HTTP forbids; set it to true"),
        (dict.fromkeys(("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY")), "or AWS_SKIP_SIGNATURE"),
    ],
)
def test_the_variable_to_set_is_named(
    server: S3Server, changes: dict[str, str | None], advice: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in changes.items():
        if value is None:
            monkeypatch.delenv(name)
        else:
            monkeypatch.setenv(name, value)
    storage = open_storage(f"s3://{BUCKET}/x")
    for ask in (storage.check, lambda: storage.read("m", 10)):
        error = refused(UnreadableError, advice, ask)
        assert "169.254" not in str(error)
        assert "builder" not in str(error)


@pytest.mark.parametrize("name", ["AWS_ENDPOINT_URL", "AWS_ENDPOINT", "AWS_ENDPOINT_URL_S3"])
def test_an_endpoint_needs_no_other_variable_and_must_be_a_url(
    server: S3Server, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    endpoint = os.environ["AWS_ENDPOINT_URL"]
    monkeypatch.delenv("AWS_ENDPOINT_URL")
    monkeypatch.setenv(name, endpoint)
    monkeypatch.delenv("AWS_ALLOW_HTTP", raising=False)
    server.put("x/m", b"data")
    assert open_storage(f"s3://{BUCKET}/x").read("m", 10) == b"data"
    for wrong in ("localhost:9000", "127.0.0.1", "", "minio"):
        monkeypatch.setenv(name, wrong)
        refused(InvalidError, rf"^{name} is '{wrong}'; set it to a URL", open_storage, "s3://b/x")


def test_a_path_that_no_store_takes_is_an_error_of_ours(server: S3Server) -> None:
    for path in ("../x", "a//b", "", "a/./b"):
        with pytest.raises(CodecError):
            open_storage(f"s3://{BUCKET}/x").read(path, 10)


def test_a_read_is_bounded(server: S3Server) -> None:
    server.put("x/big", bytes(3 << 20))
    storage = open_storage(f"s3://{BUCKET}/x")
    assert len(storage.read("big", 3 << 20)) == 3 << 20
    refused(CodecError, f"s3://{BUCKET}/x/big is longer than 1000 bytes", storage.read, "big", 1000)
    refused(CodecError, "is longer than 1000 bytes", storage.read, "big", 1000, (3 << 20) - 1001)
    assert storage.read("big", 1000, (3 << 20) - 1000) == bytes(1000)


@pytest.mark.parametrize("url", ["s3://", "S3:///x", "s3://[", "file:///etc", "ftp://x/y", "x://"])
def test_a_url_that_names_no_store_is_refused(url: str) -> None:
    refused(InvalidError, r"does not name an object store|choose a folder", open_storage, url)


def test_without_obstore_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "obstore", None)
    monkeypatch.setitem(sys.modules, "obstore.exceptions", None)
    expected = r"^s3://b/x: .* pip install '\.\[s3\]' in the folder of swings$"
    refused(InvalidError, expected, open_storage, "s3://name:password@b/x")
