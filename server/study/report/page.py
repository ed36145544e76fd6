"""The report as one page that needs nothing but itself."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape

from server.study.cases import LOAD_WINDOW
from server.study.plays import Outcome, Rules

from .figures import draw_differences, draw_distributions, draw_time_lines
from .summary import OWN, LoadSummary
from .svgtext import to_svg
from .tables import HEAD, ORACLE, rows
from .timecourse import TimeLine

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #222; background: #fff;
       max-width: 1180px; margin: 2em auto; padding: 0 1em }
h1 { font-size: 1.6em } h2 { font-size: 1.2em; margin-top: 2em }
table { border-collapse: collapse; font-variant-numeric: tabular-nums }
.wide { overflow-x: auto }
td, th { padding: .2em .7em; text-align: right; white-space: nowrap }
td:nth-child(2), th:nth-child(2) { text-align: left }
th { border-bottom: 2px solid #222; vertical-align: bottom; white-space: normal; font-weight: 600 }
tr.first td { border-top: 1px solid #bbb }
tr.own { font-weight: 600; background: #fbeeeb }
tr.oracle { color: #666; font-style: italic }
svg { max-width: 100%; height: auto; display: block; margin: 1em 0 }
dt { font-weight: 600; margin-top: .5em } dd { margin-left: 1.5em }
ul.names { columns: 3; font-size: .85em; overflow-wrap: anywhere }
"""


def make_page(
    facts: Sequence[tuple[str, str]],
    outcomes: Sequence[Outcome],
    summaries: Sequence[LoadSummary],
    lines: Sequence[TimeLine],
    rules: Rules,
) -> str:
    """facts: what was played, as names and texts. lines: of one case, at least one."""
    title = "swings-abr: policies over throughput traces"
    differences = draw_differences(summaries)
    parts = [
        "<!doctype html>",
        '<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{title}</title><style>{_STYLE}</style></head><body>",
        f"<h1>{title}</h1>",
        "<dl>",
        *(f"<dt>{escape(name)}</dt><dd>{escape(text)}</dd>" for name, text in facts),
        "</dl>",
        "<h2>Means over the traces</h2>",
        *_table(summaries),
        "<h2>Columns</h2>",
        *_columns(rules),
    ]
    if differences is not None:
        parts += [
            "<h2>Lead of our policy</h2>",
            f"<p>QoE of {OWN} minus the QoE of another policy on the same trace at the same load: "
            "the mean and its 95 % confidence interval (bootstrap over the traces).</p>",
            to_svg(differences, "d", "paired differences of QoE with their intervals"),
        ]
    names = list(dict.fromkeys(outcome.trace for outcome in outcomes))
    parts += [
        "<h2>Distributions over the plays</h2>",
        "<p>Share of the plays with at most this value. For QoE and PSNR, a line farther to the "
        "right is better; for rebuffering, a line farther to the left. The axes omit the few "
        "plays that lie far from all others.</p>",
        to_svg(draw_distributions(outcomes), "c", "distributions of QoE, PSNR and rebuffering"),
        "<h2>One play over time</h2>",
        "<p>Red: the player has nothing to show.</p>",
        to_svg(draw_time_lines(lines), "t", "link, estimate, layers and buffer over time"),
        f"<h2>The {len(names)} traces</h2>",
        '<ul class="names">',
        *(f"<li>{escape(name)}</li>" for name in names),
        "</ul></body></html>\n",
    ]
    return "\n".join(parts)


def _table(summaries: Sequence[LoadSummary]) -> Iterator[str]:
    yield '<div class="wide"><table><thead><tr>'
    yield "".join(f"<th>{escape(name)}</th>" for name in HEAD)
    yield "</tr></thead><tbody>"
    before = ""
    for row in rows(summaries):
        kinds = ["first"] if row[0] != before else []
        kinds += ["own"] if row[1] == OWN else ["oracle"] if row[1] == ORACLE else []
        before = row[0]
        cells = "".join(f"<td>{escape(cell)}</td>" for cell in row)
        yield f'<tr class="{" ".join(kinds)}">{cells}</tr>'
    yield "</tbody></table></div>"


def _columns(rules: Rules) -> Iterator[str]:
    qoe = rules.qoe
    explained = {
        "load": "Ratio of the link's rate to the rate of the stream with all layers. Each trace is "
        f"scaled so that its mean rate over the first {LOAD_WINDOW:g} play lengths has this ratio.",
        "QoE": f"Mean PSNR, minus {qoe.stall_db:g} dB times the seconds of waiting (start and "
        f"stalls) per second shown, minus {qoe.switch_db:g} times the mean step between "
        f"stretches of {qoe.stretch_s:g} s, of what the missing layers cost.",
        "oracle": "Upper bound of QoE: no play reaches more, even if it knows the link beforehand. "
        "Its PSNR is that of the same solution. Its rebuffering and start-up are those of layer 0 "
        "alone, which has the least total waiting.",
        "normalised": "Position of the mean QoE between that of layer 0 alone (0) and the "
        "oracle's (1). It is a ratio of means, not a mean of ratios.",
        "5th percentile": "5th percentile of the PSNR of a play's frames.",
        "rebuffering": "Seconds of stalls per second shown, without the start-up.",
        "step": "Mean difference between stretches of the PSNR lost against all layers: it shows "
        "how much a policy switches.",
        "layers": "Mean number of layers shown per frame; a part of a layer counts as a fraction.",
        "wasted": "Share of the received bytes that no frame showed: they came too late, without "
        "the layers below, or twice.",
    }
    yield "<dl>"
    for name, text in explained.items():
        yield f"<dt>{escape(name)}</dt><dd>{escape(text)}</dd>"
    yield "</dl>"
