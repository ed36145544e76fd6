"""The frame of the pages that the server writes itself: dark and quiet, and nothing to load."""

from __future__ import annotations

from html import escape

SECURITY = (
    "default-src 'none'; style-src 'unsafe-inline'; img-src 'self' data:; "
    "base-uri 'none'; form-action 'none'"
)
"""The content security policy of these pages."""

UNFRAMED = f"{SECURITY}; frame-ancestors 'none'"
"""The policy of those that no other page may show in a frame."""

_STYLE = """
:root { color-scheme: dark; }
* { box-sizing: border-box; }
body {
  margin: 0 auto; padding: 2rem clamp(1rem, 4vw, 3rem); max-width: 90rem; min-height: 100dvh;
  background: #101114; color: #e8e8ea; font: 16px/1.5 system-ui, sans-serif;
}
h1 { margin: 0 0 1.5rem; font-size: 1.25rem; font-weight: 600; }
a { color: #8ab4ff; }
code { font-size: 0.9em; color: #c9cbd1; overflow-wrap: anywhere; }
footer, .quiet { color: #9a9ca3; font-size: 0.875rem; }
footer { margin-top: 2.5rem; }
.streams {
  display: grid; gap: 1.5rem 1.25rem; margin: 0; padding: 0; list-style: none;
  grid-template-columns: repeat(auto-fill, minmax(min(100%, 17rem), 1fr));
}
.card { display: block; color: inherit; text-decoration: none; }
.card:focus-visible { outline: 2px solid #8ab4ff; outline-offset: 4px; border-radius: 10px; }
.picture {
  position: relative; display: block; aspect-ratio: 16 / 9; border-radius: 10px; overflow: hidden;
  background: linear-gradient(135deg, #24262d, #17181c);
}
.picture img {
  width: 100%; height: 100%; object-fit: cover; display: block; transition: scale 0.3s;
}
.card:hover img { scale: 1.03; }
.tag {
  position: absolute; right: 8px; bottom: 8px; padding: 1px 6px; border-radius: 4px;
  background: rgb(0 0 0 / 0.7); font-size: 0.75rem; font-variant-numeric: tabular-nums;
}
.live { left: 8px; right: auto; top: 8px; bottom: auto; background: #d33; font-weight: 600; }
.title { display: block; margin-top: 0.5rem; font-weight: 550; overflow-wrap: anywhere; }
@media (prefers-reduced-motion: reduce) { .picture img { transition: none; } }
"""

_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<link rel="icon" href="data:,">
<style>{style}</style>
</head>
<body>
{body}
</body>
</html>
"""


def page(title: str, body: str) -> str:
    """A whole page. title: plain text; body: HTML."""
    return _PAGE.format(title=escape(title), style=_STYLE, body=body)
