from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.support.hosted_streams import ServerProcess, served, wait_for_stream
from tests.support.web.site import Site


@pytest.fixture(scope="session")
def server(site: Site) -> Iterator[ServerProcess]:
    """A swings server of the site's streams."""
    with served(site.folder / "trained") as running:
        for name in ("clip", "long", "whole"):
            wait_for_stream(running, name)
        yield running
