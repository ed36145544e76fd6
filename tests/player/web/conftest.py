from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.support.web.browsercode import NODE, BrowserCode, running_code


@pytest.fixture(scope="module")
def browser() -> Iterator[BrowserCode]:
    """The code of player/web in a process of Node."""
    if NODE is None:
        pytest.skip("needs Node.js: apt-get install nodejs")
    with running_code() as running:
        yield running
