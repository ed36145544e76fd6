"""The pages that the server writes itself: their templates, and the content security policies that
name what such a page has inline by its hash."""

from __future__ import annotations

from base64 import b64encode
from hashlib import sha256
from importlib.resources import files

from jinja2 import Environment, PackageLoader, StrictUndefined

_TEMPLATES = Environment(
    loader=PackageLoader(__package__),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    auto_reload=False,
)


def rendered(template: str, **values: object) -> str:
    """The template with its values, which are text and not HTML, but for what is Markup."""
    return _TEMPLATES.get_template(template).render(values)


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


def message_page(heading: str, text: str) -> str:
    """A page that says one thing. text: with links if it is Markup."""
    return rendered("message.html", title=heading, text=text, style=STYLE)
