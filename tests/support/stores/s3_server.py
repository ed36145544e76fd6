"""A real S3 server in this process (moto), and the environment that points to it."""

from __future__ import annotations

import logging
import os
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any

import pytest

from tests.support.ports import kept_port

BUCKET = "streams"


class S3Server:
    """A server on a port of this machine, which can be stopped and restarted."""

    def __init__(self) -> None:
        pytest.importorskip("obstore", reason="object stores need the extra s3")
        self._moto: Any = pytest.importorskip("moto.server", reason="moto is not installed")
        logging.getLogger("werkzeug").setLevel(logging.ERROR)
        self._port = kept_port()
        self.start()

    def start(self) -> None:
        self._server = self._moto.ThreadedMotoServer(port=self._port, verbose=False)
        self._server.start()

    def stop(self) -> None:
        self._server.stop()

    @property
    def environment(self) -> dict[str, str]:
        return {
            "AWS_ACCESS_KEY_ID": "id",
            "AWS_SECRET_ACCESS_KEY": "key",
            "AWS_REGION": "us-east-1",
            "AWS_ENDPOINT_URL": f"http://127.0.0.1:{self._port}",
        }

    def empty(self) -> None:
        """Deletes everything that this process has put into any such server."""
        url = f"{self.environment['AWS_ENDPOINT_URL']}/moto-api/reset"
        urllib.request.urlopen(urllib.request.Request(url, method="POST")).close()

    @cached_property
    def client(self) -> Any:
        """A client of boto3: the tests write with it, not with the tested code."""
        import boto3

        return boto3.client(
            "s3",
            endpoint_url=self.environment["AWS_ENDPOINT_URL"],
            aws_access_key_id="id",
            aws_secret_access_key="key",
            region_name="us-east-1",
        )

    def put(self, key: str, data: bytes) -> None:
        self.client.put_object(Bucket=BUCKET, Key=key, Body=data)

    def delete(self, key: str) -> None:
        """Deletes the object and everything below it."""
        client = self.client
        for page in client.get_paginator("list_objects_v2").paginate(Bucket=BUCKET, Prefix=key):
            for entry in page.get("Contents", ()):
                client.delete_object(Bucket=BUCKET, Key=entry["Key"])

    def files(self, key: str) -> dict[str, bytes]:
        """The objects below `key`, by relative name."""
        client, found = self.client, {}
        for page in client.get_paginator("list_objects_v2").paginate(
            Bucket=BUCKET, Prefix=f"{key}/"
        ):
            for entry in page.get("Contents", ()):
                got = client.get_object(Bucket=BUCKET, Key=entry["Key"])
                found[entry["Key"].removeprefix(f"{key}/")] = got["Body"].read()
        return found

    def upload(self, folder: Path, key: str) -> None:
        """Uploads the files of `folder` below `key`, the manifest last."""
        files = sorted(path for path in folder.rglob("*") if path.is_file())
        for path in sorted(files, key=lambda path: path.name == "manifest.json"):
            self.put(f"{key}/{path.relative_to(folder)}", path.read_bytes())


@contextmanager
def s3_server() -> Iterator[S3Server]:
    """Runs a server with an empty bucket; obstore finds it through the environment."""
    server = S3Server()
    names = (*server.environment, "AWS_ALLOW_HTTP")  # swings sets the last one
    before = {name: os.environ.pop(name, None) for name in names}
    os.environ.update(server.environment)
    try:
        server.empty()
        server.client.create_bucket(Bucket=BUCKET)
        yield server
    finally:
        for name, value in before.items():
            os.environ.pop(name, None)
            if value is not None:
                os.environ[name] = value
        server.stop()
