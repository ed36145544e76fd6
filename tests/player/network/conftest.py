"""Files and certificates for the hosts of these tests."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.hosted_streams import write_stream
from tests.support.server.certificates import make_certificate

NUM_FRAMES = 6


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a stream, `s`."""
    path = tmp_path_factory.mktemp("host")
    write_stream(path / "s", NUM_FRAMES)
    return path


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A self-signed certificate for localhost, and its key."""
    return make_certificate(tmp_path_factory.mktemp("tls"))
