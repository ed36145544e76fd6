"""The figures that README.md claims are among the results of docs/RESULTS.md."""

from __future__ import annotations

import re

from tests.support.commands import ROOT

FIGURE = r"\d+(?:,\d{3})*(?:\.\d+)?"


def test_every_figure_that_the_readme_claims_was_measured() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    results = (ROOT / "docs" / "RESULTS.md").read_text(encoding="utf-8")
    claimed = re.findall(FIGURE, readme.partition("## Measured")[2].partition("\n## ")[0])
    assert len(claimed) > 20
    assert not set(claimed) - set(re.findall(rf"(?<![\d.]){FIGURE}(?!\d)", results))
