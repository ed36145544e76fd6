"""A small stream, and a server of it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.hosted_streams import ServerProcess, served, write_stream


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a stream, `one`, of 13 frames; some modules have another."""
    root = tmp_path_factory.mktemp("library")
    write_stream(root / "one", 13)
    return root


@pytest.fixture(scope="module")
def stream(library: Path) -> Path:
    return library / "one"


@pytest.fixture(scope="module")
def server(library: Path) -> Iterator[ServerProcess]:
    with served(library) as server:
        yield server
