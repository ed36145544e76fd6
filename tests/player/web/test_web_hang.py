"""A browser that hangs fails only the test that uses it."""

from __future__ import annotations

import pytest

from tests.support.web import nodeprocess
from tests.support.web.chromium import Page

FOREVER = "await new Promise(() => {});"


def test_the_next_question_goes_to_a_new_browser(
    page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    page.open("about:blank")
    with monkeypatch.context() as patched:
        patched.setattr(nodeprocess, "ANSWER_S", 0.5)
        with pytest.raises(AssertionError, match="did not answer"):
            page.run(FOREVER)
    page.open("about:blank")
    assert page.run("return 3") == 3
