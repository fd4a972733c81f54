"""The certificate as one self-contained HTML page."""

from __future__ import annotations

import html

from ..command_line import html_page
from .certificate import Certificate, ranges
from .sheet import sheet, verdict
from .walk import FOLLOWS, Line, Outcome

_STYLE = """\
.no { color: #a00; } .yes { color: #060; }
table { border-collapse: collapse; margin: 1rem 0; } td, th { padding: .2rem .7rem; text-align: right; }
th { text-align: left; border-bottom: 1px solid #999; } td:first-child { text-align: left; }
.bar { display: inline-block; height: .8rem; background: #47a; vertical-align: middle; } .bad .bar { background: #c55; }
pre { background: #f5f5f5; padding: 1rem; overflow: auto; font-size: .8rem; }
"""

#: Length of the bar of an error of 100 % [rem].
_BAR = 12.0


def page(certificate: Certificate) -> str:
    """The page as HTML."""
    c = certificate
    said = [html.escape(line) for line in verdict(c)]
    kind = "yes" if c.deploy else "no"
    parts = [
        *([f"<p class='no'>Note: {html.escape(c.ground.note)}.</p>"] if c.ground.note else []),
        f"<h1 class='{kind}'>{said[-1]}</h1>",
        *(f"<p>{line}</p>" for line in said[:-1]),
        "<h2>Nine commands</h2>",
        *(_commands(c, ground, outcome) for ground, outcome in c.nominal.items()),
        "<h2>One thing at a time</h2>",
        f"<p>Mean error of three commands around the robot as stated; a case holds if no command's error is above "
        f"{FOLLOWS:.0%}, and without a fall. The verdict needs the cases in bold.</p>",
        _grid(c),
        "".join(f"<p>{html.escape(line)}</p>" for line in ranges(c)),
        "<h2>The whole sheet</h2>",
        f"<pre>{html.escape(sheet(c))}</pre>",
    ]
    title = html.escape(f"{c.policy.robot['name']}: {'deploy' if c.deploy else 'do not deploy'}")
    return html_page(title, 60, _STYLE, parts)


def _commands(c: Certificate, ground: str, outcome: Outcome) -> str:
    rows = []
    others: list[Line | None] = [*outcome.lines] or [None] * len(c.engine[ground])
    for own, other in zip(c.engine[ground], others, strict=True):
        command = ", ".join(f"{x:.2f}" for x in own.command)
        rows.append(
            f"<tr><td>{command}</td><td>{_error(own)}</td><td>{'–' if other is None else _error(other)}</td></tr>"
        )
    head = "<tr><th>forward, left [m/s], yaw [rad/s]</th><th>this simulator</th><th>MuJoCo</th></tr>"
    return f"<h3>{html.escape(ground)}</h3><table>{head}{''.join(rows)}</table>"


def _error(line: Line) -> str:
    return "falls" if line.fell else f"{100 * line.error:.0f} %"


def _grid(c: Certificate) -> str:
    rows = []
    for case, outcome in c.grid:
        name = html.escape(f"{case.what} {case.value}")
        length = _BAR * min(1.0, outcome.error if outcome.lines else 1.0)
        bar = f"<span class='bar' style='width:{length:.1f}rem'></span> {html.escape(outcome.words)}"
        label = f"<b>{name}</b>" if case.required else name
        rows.append(
            f"<tr class='{'' if outcome.holds else 'bad'}'><td>{label}</td><td style='text-align:left'>{bar}</td></tr>"
        )
    return f"<table>{''.join(rows)}</table>"
