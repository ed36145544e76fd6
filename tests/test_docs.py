"""References of the documents exist: links, files in backticks, names of the code."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.support.commands import ROOT

PAGES = [
    ROOT / "README.md",
    ROOT / "SECURITY.md",
    ROOT / "codec" / "FORMAT.md",
    ROOT / "examples" / "README.md",
    *sorted((ROOT / "docs").glob("*.md")),
]
EXTENDING = (ROOT / "docs" / "EXTENDING.md").read_text(encoding="utf-8")
CODE = ("codec", "trainer", "server", "player")


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, generated like GitHub's."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    kept = (re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings)
    return {heading.replace(" ", "-") for heading in kept}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_lead_somewhere(page: Path) -> None:
    links = re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8"))
    for link in links:
        if re.match("https?:", link):
            continue
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        assert target.exists(), f"{page.name}: {link}"
        assert not anchor or anchor in anchors(target), f"{page.name}: {link}"


def test_extending_names_files_that_are_there() -> None:
    words = re.findall(r"`([^`]+)`", EXTENDING)
    paths = [w for w in words if re.fullmatch(r"[\w.]+(/[\w.]+)+/?", w)]
    assert len(paths) > 35
    new = [path for path in paths if re.search(r"/my(layout|format|bench)\.", path)]
    assert len(new) == 3
    missing = [path for path in paths if path not in new and not (ROOT / path).exists()]
    assert not missing


def test_extending_names_things_of_the_code() -> None:
    code = "\n".join(
        file.read_text(encoding="utf-8")
        for folder in (*CODE, "tests", "bench")
        for file in (ROOT / folder).rglob("*.py")
        if "node_modules" not in file.parts
    )
    words = re.findall(r"`([A-Za-z_]+)(?:\([^`]*)?`", EXTENDING)
    own = {"open_mylayout", "decode_myformat", "encode_myformat", "fuzz"}
    names = {w for w in words if w not in own and ("_" in w or w[0].isupper())}
    assert len(names) > 25
    missing = [
        name
        for name in sorted(names)
        if not re.search(rf"(\bdef |\bclass |^\s*){name}\b(\(|:| =)", code, re.MULTILINE)
    ]
    assert not missing
