"""An adaptation as text and as one self-contained HTML page."""

from __future__ import annotations

import html

from ..command_line import html_page
from .loop import Adaptation

_STYLE = """\
table { border-collapse: collapse; } td, th { padding: .2rem .7rem; text-align: left; }
"""


def summary(adaptation: Adaptation) -> list[str]:
    """The result in lines; the last one is the verdict."""
    a = adaptation
    lines = [f"the log: {a.found.summary}"]
    if a.found.motors is not None:
        low, high = a.found.motors.interval
        lines.append(
            f"the motors give {a.found.motors.strength:.1%} of the torque that their servos demand (95 % interval "
            f"{low:.1%} to {high:.1%})"
        )
    if a.present is not None:
        lines.append(
            f"the present policy: mean error of nine commands {a.present[0]:.1%} in the training's world, "
            f"{a.present[1]:.1%} in the log's"
        )
    if a.gain is not None:
        low, high = a.gain.interval
        lines.append(
            f"over {len(a.gain.before)} worlds of the posterior the mean error goes from {_mean(a.gain.before):.1%} to "
            f"{_mean(a.gain.after):.1%}: predicted gain {a.gain.mean:.1%} (95 % interval {low:.1%} to {high:.1%})"
        )
    if a.adapted:
        lines.append(
            f"ADAPTED: the new policy is in {a.request.out / 'policy'}; certify it before it leaves the simulator"
        )
    elif a.gain is None:
        lines.append(f"NOTHING CHANGED: {a.reason}")
    else:
        lines.append(f"KEEP THE OLD POLICY: {a.reason}")
    return lines


def page(adaptation: Adaptation) -> str:
    """The page as HTML."""
    a = adaptation
    *said, verdict = (html.escape(line) for line in summary(a))
    parts = [f"<h1>{verdict}</h1>", *(f"<p>{line}.</p>" for line in said)]
    if a.found.causes:
        rows = "".join(
            f"<tr><td>{html.escape(c['id'])}</td><td>{c['value']:.3g}</td>"
            f"<td>{c['ci95'][0]:.3g} to {c['ci95'][1]:.3g}</td><td>{html.escape(str(c.get('unit', '')))}</td></tr>"
            for c in a.found.causes
        )
        head = "<tr><th>what was wrong</th><th>value</th><th>95 % interval</th><th>unit</th></tr>"
        parts.append(f"<h2>What was wrong</h2><table>{head}{rows}</table>")
    if a.gain is not None:
        pairs = zip(a.gain.before, a.gain.after, strict=True)
        rows = "".join(f"<tr><td>{k + 1}</td><td>{b:.1%}</td><td>{c:.1%}</td></tr>" for k, (b, c) in enumerate(pairs))
        head = "<tr><th>world</th><th>mean error before</th><th>after</th></tr>"
        parts.append(f"<h2>Predicted gain</h2><table>{head}{rows}</table>")
    if a.found.next:
        parts.append(f"<h2>What to log next</h2><p>{html.escape(a.found.next)}</p>")
    parts.append("<p><a href='diagnosis/report.html'>The diagnosis of the log</a></p>")
    return html_page(verdict.split(":")[0], 50, _STYLE, parts)


def _mean(values: tuple[float, ...]) -> float:
    return sum(values) / len(values)
