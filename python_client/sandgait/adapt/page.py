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
    if len(a.found.members) > 1:
        lines.append(f"the log cannot tell these apart: {', '.join(m.words for m in a.found.members)}")
        if a.gain is not None:
            lines.append(
                f"so the policy was trained for each of {len(a.found.trained)} in proportion to its probability"
            )
    if a.found.untrained:
        lines.append(f"not trained for, because a simulated robot has no such error: {', '.join(a.found.untrained)}")
    if a.found.motors is not None:
        low, high = a.found.motors.interval
        lines.append(
            f"the motors give {a.found.motors.strength:.1%} of the torque that their servos demand (95 % interval "
            f"{low:.1%} to {high:.1%})"
        )
    if a.found.delay is not None:
        low, high = (1e3 * end for end in a.found.delay)
        lines.append(
            f"the motors follow a target {low:.0f} to {high:.0f} ms after the readings, later than in the training"
        )
    if a.present is not None:
        lines.append(
            f"the present policy: mean error of nine commands {a.present[0]:.1%} in the training's world, "
            f"{a.present[1]:.1%} in the log's"
        )
    if a.tracked is not None and a.found.tells:
        lines.append(
            f"the log's own commands: error {a.tracked[0]:.1%} on the robot, {a.tracked[1]:.1%} in the log's world"
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
    if a.found.members:
        rows = "".join(
            f"<tr><td>{html.escape(c.id)}</td><td>{c.value:.3g}</td>"
            f"<td>{c.interval[0]:.3g} to {c.interval[1]:.3g}</td><td>{html.escape(c.unit)}</td>"
            f"<td>{m.weight:.0%}</td></tr>"
            for m in a.found.members
            for c in m.causes
        )
        head = "<tr><th>cause</th><th>value</th><th>95 % interval</th><th>unit</th><th>probability</th></tr>"
        parts.append(f"<h2>What was wrong</h2><table>{head}{rows}</table>")
    if a.gain is not None:
        pairs = zip(a.gain.before, a.gain.after, strict=True)
        rows = "".join(f"<tr><td>{k + 1}</td><td>{b:.1%}</td><td>{c:.1%}</td></tr>" for k, (b, c) in enumerate(pairs))
        head = "<tr><th>world</th><th>mean error before</th><th>after</th></tr>"
        parts.append(f"<h2>Predicted gain</h2><table>{head}{rows}</table>")
    if a.found.next:
        parts.append(f"<h2>What to log next</h2><p>{html.escape(a.found.next)}</p>")
    if (a.request.out / "diagnosis").is_dir():
        parts.append("<p><a href='diagnosis/report.html'>The diagnosis of the log</a></p>")
    return html_page(verdict.split(":")[0], 50, _STYLE, parts)


def _mean(values: tuple[float, ...]) -> float:
    return sum(values) / len(values)
