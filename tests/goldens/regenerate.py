"""Rewrites the conformance suite: `python -m tests.goldens.regenerate` in the root.

Only for an intended change of the format, described in FORMAT.md; the version then changes, too.
"""

from __future__ import annotations

from tests.goldens.rehearsed_stream import FOLDER as REHEARSED
from tests.goldens.rehearsed_stream import write_rehearsed
from tests.goldens.suite import FOLDER, write_suite


def main() -> None:
    write_suite(FOLDER)
    write_rehearsed(REHEARSED)


if __name__ == "__main__":
    main()
