"""What notebooks show of this package's objects: HTML of facts, tables, pictures and curves.

Nothing here needs another package, and every text of a caller, a file or a server is escaped by `escaped`. A picture is
a PNG or an SVG in an `img`, in which a browser runs no scripts.
"""

from __future__ import annotations

import base64
import html
import math
import struct
import zlib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from .errors import shortened

#: Longest text of a value: our choice, two lines of a notebook. A whole file's text may be an option.
_LONGEST = 160

#: Most rows of a table that are shown, the first half and the last half: our choice, a screen.
_ROWS = 20

#: Width and height of a curve, and the margins of its axes on the left and below [px]: our choice, half a notebook.
_WIDTH, _HEIGHT, _LEFT, _BELOW = 480, 240, 64, 40
#: Margin above and on the right [px].
_MARGIN = 12

#: Most points of a drawn curve: our choice, one on each pixel.
_POINTS = 480

_CELL = "white-space:nowrap;padding:.15em .6em;text-align:"


def escaped(text: object) -> str:
    """`text` as HTML, for contents and for attributes in quotes."""
    return html.escape(str(text), quote=True)


def shown(value: Any) -> str:
    """A value in words, not escaped: numbers with four digits, a mean with its interval, long texts cut off."""
    if isinstance(value, Mapping) and set(value) == {"mean", "low", "high"}:
        return f"{shown(value['mean'])} (95 % interval {shown(value['low'])} to {shown(value['high'])})"
    if isinstance(value, (float, np.floating)):
        return f"{value:.4g}"
    text = value if isinstance(value, str) else str(value.tolist() if isinstance(value, np.ndarray) else value)
    return shortened(" ".join(text.split()), _LONGEST)


def title(text: str) -> str:
    """A line in bold."""
    return f"<div><b>{escaped(text)}</b></div>"


def paragraph(text: str) -> str:
    """A line of text."""
    return f"<div>{escaped(text)}</div>"


def facts(pairs: Mapping[str, Any]) -> str:
    """Names and values, one pair in a row."""
    rows = (
        f"<tr><th style='{_CELL}left'>{escaped(name)}</th><td style='text-align:left'>{escaped(shown(value))}</td></tr>"
        for name, value in pairs.items()
    )
    return f"<table>{''.join(rows)}</table>"


def table(head: Sequence[str], columns: Sequence[npt.NDArray[Any]]) -> str:
    """A table with a heading for each column. Of many rows it has the first and the last, and a row of dots."""
    count = len(columns[0]) if columns else 0
    many = count > _ROWS
    places = [*range(_ROWS // 2), None, *range(count - _ROWS // 2, count)] if many else list(range(count))
    cells = "".join(f"<th style='{_CELL}right'>{escaped(name)}</th>" for name in head)
    rows = (
        "".join(
            f"<td style='{_CELL}right'>{'…' if place is None else escaped(shown(column[place]))}</td>"
            for column in columns
        )
        for place in places
    )
    below = paragraph(f"{count} rows, of which the first and the last {_ROWS // 2} are shown") if many else ""
    body = "".join(f"<tr>{row}</tr>" for row in rows)
    return f"<div style='overflow-x:auto'><table><tr>{cells}</tr>{body}</table></div>{below}"


def picture(pixels: npt.NDArray[np.uint8], words: str) -> str:
    """A picture u8 [height, width, 3]; `words` say what it shows."""
    return _image("png", _png(pixels), words)


def drawing(svg: str, words: str) -> str:
    """An SVG on white, because its lines are dark."""
    return _image("svg+xml", svg.encode(), words)


def _image(kind: str, content: bytes, words: str) -> str:
    data = base64.b64encode(content).decode()
    style = "background:#fff;max-width:100%"
    return f"<img style='{style}' alt='{escaped(words)}' src='data:image/{kind};base64,{data}'>"


def _png(pixels: npt.NDArray[np.uint8]) -> bytes:
    """PNG (ISO/IEC 15948): 8 bits of red, green and blue, rows without a filter."""
    height, width, _ = pixels.shape
    rows = np.zeros((height, 1 + 3 * width), np.uint8)  # the first byte of a row names its filter
    rows[:, 1:] = pixels.reshape(height, 3 * width)
    parts = (
        (b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)),
        (b"IDAT", zlib.compress(rows.tobytes())),
        (b"IEND", b""),
    )
    chunks = (struct.pack(">I", len(c)) + k + c + struct.pack(">I", zlib.crc32(k + c)) for k, c in parts)
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


def curve(x: npt.NDArray[Any], y: npt.NDArray[Any], across: str, up: str) -> str:
    """A curve as SVG in the notebook's own colour, with axes named `across` and `up`; points that are not finite are
    left out. Fewer than two points are said in words."""
    finite = np.isfinite(x) & np.isfinite(y)
    x, y = np.asarray(x, dtype=np.float64)[finite], np.asarray(y, dtype=np.float64)[finite]
    if len(x) < 2:
        return paragraph(f"No curve of {up} over {across}: it has {len(x)} points.")
    if len(x) > _POINTS:
        kept = np.linspace(0, len(x) - 1, _POINTS).round().astype(int)
        x, y = x[kept], y[kept]
    marks_x, marks_y = _marks(x), _marks(y)
    right, bottom = _WIDTH - _MARGIN, _HEIGHT - _BELOW
    at_x = np.interp(x, _ends(x, marks_x), (_LEFT, right))
    at_y = np.interp(y, _ends(y, marks_y), (bottom, _MARGIN))
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(at_x, at_y, strict=True))
    parts = [f"<path d='M{_LEFT} {_MARGIN}V{bottom}H{right}' fill='none' stroke='currentColor' opacity='.5'/>"]
    for mark in marks_x:
        place = float(np.interp(mark, _ends(x, marks_x), (_LEFT, right)))
        parts.append(_text(place, bottom + 15, "middle", f"{mark:.12g}"))
    for mark in marks_y:
        place = float(np.interp(mark, _ends(y, marks_y), (bottom, _MARGIN)))
        parts.append(_text(_LEFT - 6, place + 4, "end", f"{mark:.12g}"))
        parts.append(f"<path d='M{_LEFT} {place:.1f}H{right}' stroke='currentColor' opacity='.15'/>")
    parts.append(_text((_LEFT + right) / 2, _HEIGHT - 6, "middle", across))
    parts.append(f"<g transform='translate(13 {(_MARGIN + bottom) / 2}) rotate(-90)'>{_text(0, 0, 'middle', up)}</g>")
    parts.append(f"<polyline points='{points}' fill='none' stroke='#0072b2' stroke-width='2'/>")
    words = escaped(f"{up} over {across}")
    return (
        f"<svg xmlns='http://www.w3.org/2000/svg' width='{_WIDTH}' height='{_HEIGHT}' role='img' aria-label='{words}' "
        f"viewBox='0 0 {_WIDTH} {_HEIGHT}' font-family='sans-serif' font-size='12'>{''.join(parts)}</svg>"
    )


def _text(x: float, y: float, anchor: str, text: str) -> str:
    return f"<text x='{x:.1f}' y='{y:.1f}' text-anchor='{anchor}' fill='currentColor'>{escaped(text)}</text>"


def _marks(values: npt.NDArray[np.float64]) -> list[float]:
    """Round numbers between the ends of `values`, 1, 2 or 5 times a power of ten apart, five intervals at most."""
    low, high = float(values.min()), float(values.max())
    if not high > low:
        return [low]
    rough = (high - low) / 5
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(power * factor for factor in (1, 2, 5, 10) if power * factor >= rough * (1 - 1e-9))
    first, last = math.ceil(low / step), math.floor(high / step)
    return [float(f"{k * step:.12g}") for k in range(first, last + 1)]


def _ends(values: npt.NDArray[np.float64], marks: Iterable[float]) -> tuple[float, float]:
    """The ends of an axis; a constant gets an axis around it."""
    low, high = min(values.min(), *marks), max(values.max(), *marks)
    half = 0.0 if high > low else max(abs(low), 1.0)
    return float(low - half), float(high + half)


def differing(given: Mapping[str, Any], defaults: Mapping[str, Any]) -> dict[str, Any]:
    """The options of `given` that are not equal to their defaults."""
    return {name: value for name, value in given.items() if name not in defaults or not _same(value, defaults[name])}


def _same(value: Any, default: Any) -> bool:
    if isinstance(value, (list, tuple, np.ndarray)) and isinstance(default, (list, tuple)):
        return len(value) == len(default) and all(map(_same, value, default))
    return not isinstance(value, np.ndarray) and bool(value == default)
