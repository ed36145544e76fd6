from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.support.web.browserformat import NODE, BrowserFormat, running_format


@pytest.fixture(scope="module")
def browser() -> Iterator[BrowserFormat]:
    """player/web/format in a process of Node."""
    if NODE is None:
        pytest.skip("needs Node.js: apt-get install nodejs")
    with running_format() as running:
        yield running
