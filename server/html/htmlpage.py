"""The frame of the pages that the server writes itself, and the content security policies that name
what such a page has inline by its hash."""

from __future__ import annotations

from base64 import b64encode
from hashlib import sha256
from html import escape
from importlib.resources import files


def read_text(name: str) -> str:
    """A file that lies beside this module."""
    return (files(__package__) / name).read_text(encoding="utf-8").strip()


def hash_source(text: str) -> str:
    """The source expression of a policy that allows the inline script or style `text`."""
    return f"'sha256-{b64encode(sha256(text.encode()).digest()).decode()}'"


STYLE = read_text("page.css")
"""The styles of all pages."""

SECURITY = (
    f"default-src 'none'; style-src {hash_source(STYLE)}; img-src 'self' data:; "
    "base-uri 'none'; form-action 'none'"
)
"""The content security policy of a page without scripts and without a style of its own."""

_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1, viewport-fit=cover">
<meta name="color-scheme" content="dark">
<title>{title}</title>
<link rel="icon" href="data:,">
{head}<style>{style}</style>
</head>
<body>
{body}
</body>
</html>
"""


_MESSAGE = """<main class="message"><h1>{heading}</h1>
<p class="quiet">{text}</p></main>"""


def message_page(heading: str, text: str) -> str:
    """A page that says one thing. heading: plain text; text: HTML."""
    return page(heading, _MESSAGE.format(heading=escape(heading), text=text))


def page(title: str, body: str, head: str = "", style: str = STYLE) -> str:
    """A whole page. title: plain text; head, body: HTML, the first with a line end behind each
    element; style: CSS."""
    return _PAGE.format(title=escape(title), head=head, style=style, body=body)
