"""A figure as SVG to stand inside a page: the same text on any machine.

Rule: matplotlib names things by hashes of coordinates to their last digit, which are not the same
on every processor. So things are numbered here, and coordinates are rounded to what can be seen.
"""

from __future__ import annotations

import io
import re
from html import escape

import matplotlib
import matplotlib.figure

_NUMBER = re.compile(r"-?\d+\.\d+")
_ID = re.compile(r'\bid="([^"]+)"')
_REFERENCE = re.compile(r'(\bid="|url\(#|href="#)([^")]+)')
_QUIET = {"Creator": None, "Date": None, "Format": None, "Type": None}


def to_svg(figure: matplotlib.figure.Figure, prefix: str, title: str) -> str:
    """prefix: of all ids, its own for each figure of a page. title: for screen readers."""
    drawn = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": "swings", "svg.fonttype": "path"}):
        figure.savefig(drawn, format="svg", metadata=_QUIET)
    text = drawn.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<!--.*?-->\s*", "", text, flags=re.DOTALL)
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text, flags=re.DOTALL)
    numbers = {name: number for number, name in enumerate(dict.fromkeys(_ID.findall(text)))}

    def renamed(match: re.Match[str]) -> str:
        return f"{match[1]}{prefix}{numbers[match[2]]}" if match[2] in numbers else match[0]

    text = _REFERENCE.sub(renamed, text)
    text = _NUMBER.sub(lambda match: _rounded(float(match[0])), text)
    return text.replace("<svg ", f'<svg role="img" aria-label="{escape(title)}" ', 1)


def _rounded(value: float) -> str:
    """To hundredths of a pixel; what is small is a scale, and keeps its digits."""
    digits = 2 if abs(value) >= 1 else 6
    return f"{value:.{digits}f}".rstrip("0").rstrip(".")
