"""Diagnosis: finds where a simulation differs from measured data, why it differs, and the gain of an extended model."""

from __future__ import annotations

import html as markup
import json
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np

from . import notebook
from .errors import InvalidRequest
from .snapshots import FilePath
from .tables import Table, new_axes

#: Default number of conditions in a figure: those with the largest errors of the plain model. Our choice, because each
#: has a row of panels.
CONDITIONS = 4

#: What the colours of the report's panels mean (src/diagnose/page.rs).
_COLOURS = "measured (black), plain model (blue), extended model (orange), ± σ of a repetition (band)"


class Diagnosis:
    """Verdict, causes and the extended sand of a diagnosis; `report` is `report.json` as a dict."""

    def __init__(self, report_json: str, html: str, sand: str, hardware: str, curves: Table) -> None:
        self.report_json = report_json
        self.report: dict[str, Any] = json.loads(report_json)
        #: `report.html`: one self-contained page.
        self.html = html
        #: The extended model as `sand.toml`. If no mechanism reduces the error, this is the plain model.
        self.sand = sand
        #: What the diagnosis has found about motors, sensors and delays, as `hardware.toml`.
        self.hardware = hardware
        #: Measured and predicted loads, one row for each sample. Columns: trial, condition, shape, progress (angle
        #: [rad] or position along the path [m]). Each channel C has the columns C (measured), C_plain and C_extended
        #: (predicted) and C_sd (standard deviation of a repetition).
        self.curves = curves

    @property
    def verdict(self) -> str:
        """The verdict: noise_floor, recalibrated, named, ambiguous, described, none_of_these or insufficient_data."""
        return cast(str, self.report["verdict"])

    @property
    def headline(self) -> str:
        """What is wrong, how much and how sure, in at most 160 characters."""
        return cast(str, self.report["headline"])

    @property
    def action(self) -> str:
        """What to do."""
        return cast(str, self.report["action"])

    @property
    def summary(self) -> str:
        """The verdict as a sentence."""
        return cast(str, self.report["summary"])

    @property
    def causes(self) -> list[dict[str, Any]]:
        """Each cause with id, kind (sand, measurement or robot), value, unit and ci95.

        Empty unless the verdict is named or ambiguous.
        """
        return cast(list[dict[str, Any]], self.report["causes"])

    def __repr__(self) -> str:
        return f"<Diagnosis: {self.verdict}: {self.headline}>"

    def _repr_html_(self) -> str:
        """The headline, what to do, where the plain model's error differs most, and the panels of the condition that
        fits worst."""
        lines = notebook.title(f"{self.verdict}: {self.headline}") + notebook.paragraph(self.action)
        if split := self.report["split"]:
            said = ", ".join(f"{part['error']:+.0%} {part['name']}" for part in split["parts"])
            lines += notebook.paragraph(f"Measured against predicted forces of the plain model: {said}")
        panels = re.search(r"<h3>([^<]*)</h3><div class=panels>(.*?)</div>", self.html, flags=re.DOTALL)
        if panels is None:
            return lines + notebook.paragraph("No picture: the report has none.")
        condition = markup.unescape(panels[1])
        drawings = re.findall(r"<svg .*?</svg>", panels[2], flags=re.DOTALL)
        pictures = "".join(notebook.drawing(svg, f"forces, {condition}") for svg in drawings)
        return lines + notebook.paragraph(f"{condition}: {_COLOURS}") + pictures

    def save(self, out: FilePath) -> None:
        """Writes report.json, report.html, sand.toml and hardware.toml into the directory `out`, as the command line
        does."""
        directory = Path(out)
        directory.mkdir(parents=True, exist_ok=True)
        for name, text in (
            ("report.json", self.report_json),
            ("report.html", self.html),
            ("sand.toml", self.sand),
            ("hardware.toml", self.hardware),
        ):
            (directory / name).write_text(text, encoding="utf-8")

    def to_frame(self) -> Any:
        """The measured and predicted loads as a pandas DataFrame, see `curves`. Needs `sandgait[plot]`."""
        return self.curves.to_frame()

    def plot(self, conditions: list[str] | None = None, channels: tuple[str, ...] = ("Fx", "Fz")) -> Any:
        """Plots the measured loads (dots) and those of the plain and the extended model over the progress.

        The figure has one row for each condition and one column for each channel. `conditions`: names of conditions in
        the data; by default the 4 conditions with the largest errors of the plain model. Returns the matplotlib figure.
        Needs `sandgait[plot]`.
        """
        c = self.curves
        unknown = [name for name in channels if name not in c]
        if unknown:
            raise InvalidRequest(f"channels: {unknown[0]!r} was not measured")
        if conditions is None:
            conditions = self._worst(channels)
        axes = new_axes(None, len(conditions), len(channels), (4.2 * len(channels), 2.3 * len(conditions) + 0.6))
        grid = np.asarray(axes, dtype=object).reshape(len(conditions), len(channels))
        for row, condition in zip(grid, conditions, strict=True):
            chosen = c["condition"] == condition
            if not chosen.any():
                raise InvalidRequest(f"conditions: {condition!r} is not in the data")
            for ax, channel in zip(row, channels, strict=True):
                self._draw(ax, chosen, channel)
            row[0].set_title(f"{c['shape'][chosen][0]}, condition {condition}", loc="left", fontsize="medium")
        for ax in grid[-1]:
            ax.set_xlabel("angle [rad] or position along the path [m]")
        handles, labels = grid[0][0].get_legend_handles_labels()
        figure = grid[0][0].figure
        figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
        return figure

    def _worst(self, channels: tuple[str, ...]) -> list[str]:
        """Conditions with the largest errors of the plain model, relative to the standard deviation of a repetition."""
        c = self.curves
        off = sum(((c[n] - c[f"{n}_plain"]) / np.maximum(c[f"{n}_sd"], 1e-12)) ** 2 for n in channels)
        names, index = np.unique(c["condition"], return_inverse=True)
        means = np.bincount(index, weights=off) / np.bincount(index)
        return [str(name) for name in names[np.argsort(-means, kind="stable")][:CONDITIONS]]

    def _draw(self, ax: Any, chosen: Any, channel: str) -> None:
        c = self.curves
        x = c["progress"][chosen]
        ax.plot(x, c[channel][chosen], ".", color="0.35", markersize=2.5, label="measured")
        # Repetitions have the same motion, so the first trial's curve represents all.
        first = chosen & (c["trial"] == c["trial"][chosen][0])
        x = c["progress"][first]
        plain, extended, sd = (c[f"{channel}_{what}"][first] for what in ("plain", "extended", "sd"))
        ax.fill_between(
            x, extended - sd, extended + sd, color="C3", alpha=0.2, linewidth=0, label="± σ of a repetition"
        )
        ax.plot(x, plain, color="C0", linestyle="--", label="plain model")
        ax.plot(x, extended, color="C3", label="extended model")
        ax.set_ylabel(c.label(channel))
        ax.axhline(0.0, color="0.8", linewidth=0.8, zorder=0)


def tables_of(experiment: FilePath | Mapping[str, Any]) -> Mapping[str, Any]:
    """The tables of an experiment; none if its file cannot be read, which the study refuses with the line."""
    if isinstance(experiment, Mapping):
        return experiment
    try:
        return tomllib.loads(Path(experiment).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}


def content(data: Any, experiment: FilePath | Mapping[str, Any]) -> tuple[str, bytes] | None:
    """Name and bytes of measured data that are no CSV file: a frame, or a recording as a table. None: a CSV file."""
    from . import logs  # not above, so that `python -m sandgait.logs` loads it once

    if hasattr(data, "to_csv"):
        return "data", data.to_csv(index=False).encode()
    if logs.kind(data) is None:
        return None
    folder = Path() if isinstance(experiment, Mapping) else Path(experiment).parent
    return str(data), logs.for_experiment(data, tables_of(experiment), folder)
